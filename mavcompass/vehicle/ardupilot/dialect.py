"""ArduPilot's dialect: its compass parameters, in both spellings, read and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from mavcompass.compass_parameters import (
    ArduPilotNaming,
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_name,
    ardupilot_naming,
)
from mavcompass.correction import FieldCorrection
from mavcompass.errors import NoReply
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.script import Context, Script
from mavcompass.vehicle.ardupilot.commit import commit_device_ids
from mavcompass.vehicle.ardupilot.plan import plan_corrections, plan_values
from mavcompass.vehicle.parameters import protocol as wire
from mavcompass.vehicle.parameters.rules import ParameterRules, parameter_rules
from mavcompass.vehicle.parameters.transaction import Transaction
from mavcompass.vehicle.parameters.values import Encoding, Parameter

COMPASSES = (1, 2, 3)
_SPELLING_PROBES = ("COMPASS_OFS_X", "COMPASS1_OFS_X")


class ArduPilotDialect:
    """Speak ArduPilot's compass parameters; implements `procedure.dialect.Dialect`."""

    encoding: Encoding = "cast"

    def __init__(self, source: str = "SOURCE") -> None:
        """Take the vehicle's address, which error messages repeat in the command that restores."""
        self.source = source

    @property
    def autopilot(self) -> Literal["ardupilot", "px4"]:
        """Return "ardupilot"."""
        return "ardupilot"

    @property
    def rules(self) -> ParameterRules:
        """Return the limits and write rules of `params/ardupilot.toml`."""
        return parameter_rules("ardupilot")

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
        """Read everything about all compasses and what `rules.vehicle` adds, with types.

        The spelling of the names is found by two questions.
        """
        probes = yield from wire.read(context, _SPELLING_PROBES, self.encoding, enough=bool)
        if not probes:
            raise NoReply(
                "The vehicle is alive but answered no question about its compass parameters.",
                "Check that the link carries both ways and that the firmware has a compass.",
            )
        naming = ardupilot_naming({name: p.value for name, p in probes.items()})
        names = [*self.rules.general, *self.rules.vehicle]
        for instance in COMPASSES:
            names += self.instance_names(instance, naming)
        return (yield from self.read_typed(context, names))

    def instance_names(self, instance: int, naming: ArduPilotNaming) -> tuple[str, ...]:
        """List all parameters of one compass."""
        own = [ardupilot_name(quantity, instance, naming) for quantity in self.rules.per_compass]
        return (*ardupilot_correction_names(instance, naming), *own)

    def instances(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the compasses that the vehicle has, from 1: those whose device id is not 0."""
        naming = ardupilot_naming(parameters)
        return tuple(
            instance
            for instance in COMPASSES
            if ardupilot_name("OFS_X", instance, naming) in parameters
            # Firmware that does not tell a device id has the compass that it has offsets for.
            and parameters.get(ardupilot_name("DEV_ID", instance, naming), 1.0) != 0.0
        )

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force."""
        return ardupilot_correction(parameters, instance)

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return None: RAW_IMU and SCALED_IMU carry the corrected field in body axes."""
        return None

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

        def commit(context: Context) -> Script[tuple[str, ...]]:
            return (yield from commit_device_ids(context, plan))

        return (yield from Transaction(self.encoding, self.source, commit).run(context, plan, save_undo))
