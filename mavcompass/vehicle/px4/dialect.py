"""PX4's dialect: CAL_MAGn_*, in gauss, subtracted, in the sensor's own axes, integers bit for bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from mavcompass.compass_parameters import px4_correction, px4_name, px4_rotation
from mavcompass.correction import FieldCorrection
from mavcompass.errors import NoReply, Refused
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.script import Context, Script
from mavcompass.vehicle.parameters import protocol as wire
from mavcompass.vehicle.parameters.rules import ParameterRules, parameter_rules
from mavcompass.vehicle.parameters.transaction import Transaction
from mavcompass.vehicle.parameters.values import Encoding, Parameter
from mavcompass.vehicle.px4.plan import plan_corrections, plan_values

COMPASSES = (1, 2, 3, 4)


class PX4Dialect:
    """Speak PX4's compass parameters; implements `procedure.dialect.Dialect`."""

    encoding: Encoding = "bytewise"

    def __init__(self, source: str = "SOURCE") -> None:
        """Take the vehicle's address, which error messages repeat in the command that restores."""
        self.source = source

    @property
    def autopilot(self) -> Literal["ardupilot", "px4"]:
        """Return "px4"."""
        return "px4"

    @property
    def rules(self) -> ParameterRules:
        """Return the limits and write rules of `params/px4.toml`."""
        return parameter_rules("px4")

    def read_typed(self, context: Context, names: Sequence[str]) -> Script[dict[str, Parameter]]:
        """Read parameters with their types; a name that the vehicle does not know is left out."""
        return (yield from wire.read(context, names, self.encoding))

    def read_parameters(self, context: Context, names: Sequence[str]) -> Script[dict[str, float]]:
        """Read parameters by name; a name that the vehicle does not know is left out."""
        held = yield from self.read_typed(context, names)
        return {name: parameter.value for name, parameter in held.items()}

    def compass_parameters(self, context: Context) -> Script[dict[str, float]]:
        """Read everything about all compasses. Raises NoReply where the vehicle answers nothing."""
        held = yield from self.compass_parameters_typed(context)
        return {name: parameter.value for name, parameter in held.items()}

    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses, with types; unused slots are not asked for further."""
        names = [
            *self.rules.general,
            *self.rules.vehicle,
            *(px4_name("ID", instance) for instance in COMPASSES),
        ]
        held = yield from self.read_typed(context, names)
        if not held:
            raise NoReply(
                "The vehicle is alive but answered no question about its compass parameters.",
                "Check that the link carries both ways and that the firmware has a compass.",
            )
        present = self.instances({name: p.value for name, p in held.items()})
        rest = [px4_name(quantity, i) for i in present for quantity in self.rules.per_compass]
        return held | (yield from self.read_typed(context, [name for name in rest if name not in held]))

    def instances(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the compasses that the vehicle has, from 1: those whose slot holds a device id."""
        return tuple(i for i in COMPASSES if parameters.get(px4_name("ID", i), 0.0) != 0.0)

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes. Raises Refused for a custom mounting angle."""
        try:
            return px4_correction(parameters, instance)
        except KeyError:
            raise Refused(
                f"Compass {instance} is mounted at a custom angle, which this program cannot turn its"
                f" offsets by ({px4_name('ROT', instance)}, or SENS_BOARD_ROT for an internal one).",
                "Mount it at a multiple of 45 degrees, or calibrate it with PX4's own routine.",
            ) from None

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return how the sensor is mounted: SCALED_IMU carries its readings as they are."""
        return px4_rotation(parameters, instance)

    def plan(
        self, parameters: Mapping[str, float], corrections: Mapping[int, FieldCorrection]
    ) -> ParameterPlan:
        """Plan the write of new corrections over the parameters in force."""
        return plan_corrections(parameters, corrections, self.instances(parameters), self.rules)

    def plan_values(
        self, parameters: Mapping[str, float], wanted: Mapping[str, float], checked: bool = True
    ) -> ParameterPlan:
        """Plan the write of single parameters; unchecked, what is out of range is only remarked on."""
        return plan_values(parameters, wanted, self.instances(parameters), self.rules, checked)

    def write(self, context: Context, plan: ParameterPlan, save_undo: SaveUndo) -> Script[WriteOutcome]:
        """Write a plan as a transaction; see `vehicle.parameters.transaction`."""
        return (yield from Transaction(self.encoding, self.source).run(context, plan, save_undo))
