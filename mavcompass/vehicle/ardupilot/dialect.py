"""ArduPilot's dialect: its compass parameters, in both spellings, read and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.compass_parameters import (
    ArduPilotNaming,
    ardupilot_angle_names,
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_name,
    ardupilot_naming,
)
from mavcompass.correction import FieldCorrection
from mavcompass.procedure.script import Context, Script
from mavcompass.steering import ARDUPILOT_COMPASSES
from mavcompass.vehicle.ardupilot.arming import exemption
from mavcompass.vehicle.ardupilot.commit import commit_device_ids
from mavcompass.vehicle.ardupilot.onboard import calibrate_itself
from mavcompass.vehicle.ardupilot.plan import ArduPilotPlanner
from mavcompass.vehicle.ardupilot.yaw import prompt_estimator, take_compass_yaw
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.dialect import CompassDialect, no_answer
from mavcompass.vehicle.parameters.values import Encoding, Parameter

_SPELLING_PROBES = ("COMPASS_OFS_X", "COMPASS1_OFS_X")


class ArduPilotDialect(CompassDialect):
    """Speak ArduPilot's compass parameters."""

    autopilot: Literal["ardupilot"] = "ardupilot"
    prefix = ("COMPASS", "CUST_ROT")
    encoding: Encoding = "cast"
    commit = staticmethod(commit_device_ids)
    planner_kind = ArduPilotPlanner
    restart_wanted_by_own = True

    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses and what `rules.vehicle` adds, with types.

        The spelling of the names is found by two questions.
        """
        probes = yield from protocol.read(context, _SPELLING_PROBES, self.encoding, enough=bool)
        if not probes:
            raise no_answer()
        naming = ardupilot_naming({name: p.value for name, p in probes.items()})
        names = [*self.rules.general, *self.rules.vehicle]
        for instance in ARDUPILOT_COMPASSES:
            names += self.instance_names(instance, naming)
        held = yield from self.read_typed(context, names)
        angles = ardupilot_angle_names({name: p.value for name, p in held.items()})
        return held | (yield from self.read_typed(context, angles))

    def instance_names(self, instance: int, naming: ArduPilotNaming) -> tuple[str, ...]:
        """List all parameters of one compass."""
        own = [ardupilot_name(quantity, instance, naming) for quantity in self.rules.per_compass]
        return (*ardupilot_correction_names(instance, naming), *own)

    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""
        naming = ardupilot_naming(parameters)
        names = (ardupilot_name("DEV_ID", instance, naming) for instance in ARDUPILOT_COMPASSES)
        return tuple(int(parameters.get(name, 0.0)) for name in names)

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force."""
        return ardupilot_correction(parameters, instance)

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> None:
        """Return None: RAW_IMU and SCALED_IMU carry the corrected field in body axes."""
        return None

    def arming_exemption(self, context: Context, said: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return what leaves the compass out of the arming checks; see `vehicle.ardupilot.arming`."""
        return (yield from exemption(said, lambda names: self.read_parameters(context, names)))

    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List the one that it sets: learning ends with a calibration."""
        return tuple(name for name in ("COMPASS_LEARN",) if parameters.get(name))

    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have it calibrate without saving; see `vehicle.ardupilot.onboard`."""
        return (yield from calibrate_itself(context, instances))

    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return at what EKF3 follows its compass in flight; see `vehicle.ardupilot.yaw`."""
        return prompt_estimator(parameters) if flying else {}

    def take_compass_yaw(
        self, context: Context, parameters: Mapping[str, float], flying: bool
    ) -> Script[str]:
        """Have EKF3 take its compass's yaw over; see `vehicle.ardupilot.yaw`."""
        return (yield from take_compass_yaw(context, parameters, flying))
