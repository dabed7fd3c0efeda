"""PX4's dialect: CAL_MAGn_*, in gauss, subtracted, in the sensor's own axes, integers bit for bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.compass_parameters import px4_correction, px4_name, px4_sensor_to_body
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.steering import PX4_COMPASSES
from mavcompass.vehicle.parameters.dialect import CompassDialect, no_answer
from mavcompass.vehicle.parameters.values import Encoding, Parameter
from mavcompass.vehicle.px4.arming import exemption
from mavcompass.vehicle.px4.loading import RECEIVERS, load
from mavcompass.vehicle.px4.onboard import calibrate_itself
from mavcompass.vehicle.px4.plan import PX4Planner


class PX4Dialect(CompassDialect):
    """Speak PX4's compass parameters."""

    autopilot: Literal["px4"] = "px4"
    prefix = ("CAL_MAG",)
    encoding: Encoding = "bytewise"
    planner_kind = PX4Planner
    loads_disarmed = True

    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses, with types; unused slots are not asked for further."""
        names = [
            *self.rules.general,
            *self.rules.vehicle,
            *(px4_name("ID", instance) for instance in PX4_COMPASSES),
        ]
        held = yield from self.read_typed(context, names)
        if not held:
            raise no_answer()
        present = self.instances({name: p.value for name, p in held.items()})
        rest = [px4_name(quantity, i) for i in present for quantity in self.rules.per_compass]
        return held | (yield from self.read_typed(context, [name for name in rest if name not in held]))

    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""
        return tuple(int(parameters.get(px4_name("ID", instance), 0.0)) for instance in PX4_COMPASSES)

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes."""
        return px4_correction(parameters, instance)

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return how the sensor is mounted: SCALED_IMU carries its readings as they are."""
        return px4_sensor_to_body(parameters, instance)

    def arming_exemption(self, context: Context, said: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return what leaves the compass out of the arming checks; see `vehicle.px4.arming`."""
        return (yield from nothing(exemption(said)))

    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List all that it holds of compasses: it calibrates every one, and stores it at once."""
        return tuple(name for name in parameters if name.startswith(self.prefix))

    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have it calibrate, and read what it stored; see `vehicle.px4.onboard`."""
        why = yield from calibrate_itself(context)
        if why:
            return {instance: OwnFinding(why_not=why) for instance in instances}
        stored = yield from self.read_parameters(context, self.changed_by_own(parameters))
        found = {}
        for i in instances:
            turned = px4_name("ROT", i)
            found[i] = OwnFinding(px4_correction({**parameters, **stored}, i))
            if stored.get(turned) != parameters.get(turned):
                why = f"PX4 finds it mounted as {turned} {stored[turned]:g}: set that and calibrate again."
                found[i] = OwnFinding(why_not=why)
        return found

    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return at what EKF2 follows its compass on the ground; see `vehicle.px4.loading`."""
        return {} if flying or not parameters.get(RECEIVERS) else {RECEIVERS: 0.0}

    def load_written(self, context: Context, written: Mapping[str, float]) -> Script[str]:
        """Have PX4 load its calibration, which resets the heading; see `vehicle.px4.loading`."""
        return (yield from load(context, written))
