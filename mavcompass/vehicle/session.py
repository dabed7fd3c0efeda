"""Compass parameters of a vehicle on a link, as a person works with them: hold, compare, plan, write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from mavcompass.errors import BadRecording, Refused, UsageError
from mavcompass.messages import Incoming
from mavcompass.procedure.dialect import Overrides, ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.script import Ask, Context, Script, ask
from mavcompass.procedure.vehicle_state import VehicleState, find_vehicle
from mavcompass.vehicle.dialects import DIALECTS, CompassDialect, make_dialect
from mavcompass.vehicle.parameters.undo import KeptValues
from mavcompass.vehicle.parameters.values import Parameter, same_value


@dataclass(frozen=True, slots=True)
class HeldParameters:
    """Hold what a vehicle's compasses are set to.

    Attributes:
        system: its MAVLink system id, 0 for a recording.
        armed: None where that is not known.
        reporting: the compasses, from 1, that readings came of.
        vehicle: who it says it is; None for a recording.
    """

    dialect: CompassDialect
    system: int
    armed: bool | None
    typed: Mapping[str, Parameter]
    reporting: tuple[int, ...] = ()
    vehicle: Nameplate | None = None

    @property
    def values(self) -> dict[str, float]:
        """Return all values by name."""
        return {name: parameter.value for name, parameter in self.typed.items()}

    @property
    def compass_typed(self) -> dict[str, Parameter]:
        """Return the compass parameters alone, without what else was read of the vehicle."""
        return {name: p for name, p in self.typed.items() if name.startswith(self.dialect.prefix)}

    @property
    def compass_values(self) -> dict[str, float]:
        """Return the values of `compass_typed`."""
        return {name: parameter.value for name, parameter in self.compass_typed.items()}

    @property
    def compasses(self) -> tuple[int, ...]:
        """List the compasses that the vehicle has, from 1."""
        return self.dialect.instances(self.values, self.reporting)

    def instance_of(self, name: str) -> int | None:
        """Tell which compass a parameter belongs to; None for one of all compasses."""
        return self.dialect.instance_of(name)


@dataclass(frozen=True, slots=True)
class WriteReport:
    """Say what a write was to do and what became of it.

    Attributes:
        outcome: None where there was nothing to change, or no consent.
        loaded: how an autopilot that loads a calibration on the ground was made to; "" where it was not.
    """

    held: HeldParameters
    plan: ParameterPlan
    outcome: WriteOutcome | None
    loaded: str = ""


def read_vehicle(context: Context, source: str, system: int | None = None) -> Script[HeldParameters]:
    """Find the vehicle, read its compass parameters, and ask who it is, which two that share an id answer.

    Raises NoVehicle where none is heard, NoReply where it does not answer, Refused where two answer.
    """
    states: dict[tuple[int, int], VehicleState] = {}

    def note(incoming: Incoming) -> None:
        states.setdefault((incoming.system, incoming.component), VehicleState()).hear(incoming)

    context.listeners.append(note)
    try:
        found = yield from find_vehicle(context, system)
        dialect = make_dialect(found.autopilot, source)
        typed = yield from dialect.compass_parameters_typed(context)
        values = {name: parameter.value for name, parameter in typed.items()}
        vehicle = yield from dialect.nameplate(context, values)
    finally:
        context.listeners.remove(note)
    state = states.get((found.system, found.component), VehicleState())
    armed = state.armed if state.heartbeat else None
    return HeldParameters(dialect, found.system, armed, typed, tuple(state.reporting), vehicle)


def recorded_parameters(
    parameters: Mapping[str, float], source: str, reporting: tuple[int, ...] = ()
) -> HeldParameters:
    """Take the parameters of a recording; raises BadRecording where none is of its compasses."""
    for kind in DIALECTS.values():
        if any(name.startswith(kind.prefix) for name in parameters):
            typed = {name: Parameter(value) for name, value in sorted(parameters.items())}
            return HeldParameters(kind(source), 0, None, typed, reporting)
    raise BadRecording(
        f"{source} does not hold a vehicle's compass parameters.",
        "Give a recording that begins at power-up (.BIN), or one in which parameters were read (.tlog).",
    )


def compass_part(kept: KeptValues, held: HeldParameters) -> dict[str, float]:
    """Pick the compass parameters that may be written out of all that a file holds; all of an undo file.

    Raises UsageError where there are none, and Refused where the file's device ids are another
    sensor's: its calibration is worth nothing on this one.
    """
    prefix, rules, file = held.dialect.prefix, held.dialect.rules, kept.path
    # What was set aside for a calibration is in its undo file, too.
    own = {name: v for name, v in kept.values.items() if file.suffix == ".json" or name.startswith(prefix)}
    if not own:
        raise UsageError(
            f"{file} holds no compass parameter ({prefix[0]}...) of this vehicle's autopilot.",
            "Check that file and vehicle belong together.",
        )
    for name, value in own.items():
        instance, now = held.instance_of(name), held.values.get(name)
        if instance in held.compasses and name.endswith(("_ID", f"_ID{instance}")) and now is not None:
            if not same_value(value, now):
                raise Refused(
                    f"{file} was made for another sensor: its {name} is {value:.0f}, the vehicle's is"
                    f" {now:.0f}.",
                    "Calibrate this compass instead, or take that compass's lines out of the file.",
                )
    return {name: value for name, value in own.items() if not rules.is_protected(name)}


def write_values(
    context: Context,
    source: str,
    wanted: Callable[[HeldParameters, Nameplate], Mapping[str, float]],
    save_undo: SaveUndo,
    *,
    checked: bool,
    consent: Callable[[HeldParameters, ParameterPlan], str | None],
    system: int | None = None,
) -> Script[WriteReport]:
    """Read the vehicle and hold it, plan the write of single values, have the person's consent, write.

    `checked` refuses what is out of range; unchecked (putting back what was there) it is a remark.
    `consent` sees the plan and returns the question to ask, "" to write without asking, or None to
    write nothing. An autopilot that loads a calibration on the ground only is made to, also where it holds
    these values already: it may not go by them.
    Raises Refused where the plan must not be written, another program works on the vehicle, or the person
    says no.
    """
    held = yield from read_vehicle(context, source, system)
    vehicle = yield from held.dialect.claim(context, held.values)
    values = wanted(held, vehicle)
    others = yield from held.dialect.read_typed(context, [name for name in values if name not in held.typed])
    held = replace(held, typed={**held.typed, **others})
    plan = held.dialect.plan_values(held.values, values, checked, held.reporting)
    loads = held.dialect.loads_disarmed and held.armed is False
    question = consent(held, plan)
    if question is None or not (plan.changes or plan.refusals or loads):
        return WriteReport(held, plan, None)
    if plan.refusals:
        raise Refused(" ".join(plan.refusals), "Nothing was written.")
    if question and not (yield from ask(context, Ask(question))):
        raise Refused("Cancelled. Nothing written.", "Run it again to be asked again.")
    outcome = (yield from held.dialect.write(context, plan, save_undo)) if plan.changes else None
    if not loads:
        return WriteReport(held, plan, outcome)
    overrides = Overrides(held.dialect, save_undo)
    if outcome is None:  # else its record leads back from what is changed to have it loaded, too
        yield from overrides.keep(context, tuple(values))
    return WriteReport(held, plan, outcome, (yield from overrides.load(context, held.values, values)))
