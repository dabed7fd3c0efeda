"""Write a plan to a vehicle as a transaction: all of it, proven, or nothing, or the way back.

1. Read what is to be changed: it must still be what the plan saw.
2. Put the undo record on disk.
3. Write; a value counts when the vehicle has been heard with it.
4. Read everything back once more.

Whatever goes wrong after 2 (a refused value, a silent link, a stop by the pilot) puts the old values
back and proves that as well. Where even this fails, `WriteFailed` carries the command that does it.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from mavcompass.errors import MavCompassError, Refused, WriteFailed
from mavcompass.installation.invocation import consent, program
from mavcompass.printable import counted, named
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.undo import remove_record, written_file
from mavcompass.vehicle.parameters.values import Encoding, Parameter, holds, is_single

# After a stop a script has `script.CLEAN_UP_S` to put things back; a silent vehicle is given up before.
_UNDO_SILENCE_S = 5.0
# So many parameters at most are called by their names.
_FEW = 3

Commit = Callable[[Context, ParameterPlan], Script[tuple[str, ...]]]


@dataclass(frozen=True, slots=True)
class Transaction:
    """Write plans to one vehicle.

    Attributes:
        encoding: how the autopilot puts integers into PARAM_VALUE.
        source: the vehicle's address as the person gave it, for the command that restores.
        claim: finds out which vehicle this is and holds it against other programs.
        commit: what must be done beside the parameters after they are written; its remarks go into
            the outcome.
    """

    encoding: Encoding
    source: str
    claim: Callable[[Context], Script[Nameplate]]
    commit: Commit = lambda context, plan: nothing(())

    def run(self, context: Context, plan: ParameterPlan, save_undo: SaveUndo) -> Script[WriteOutcome]:
        """Write `plan`; a plan that changes nothing sends nothing.

        Raises Refused where the plan says so or a stop came (all is as before then), and WriteFailed
        where it could not be completed.
        """
        refuse_unwritable(plan)
        if not plan.changes:
            return WriteOutcome(verified=True, undo_file=None, values={})
        vehicle = yield from self.claim(context)
        old = yield from self._read_before(context, plan)
        new = {c.name: Parameter(c.new, old[c.name].type) for c in plan.changes}
        undo_file = save_undo(plan, {name: p.value for name, p in old.items()}, vehicle)
        way_back = WayBack(self.encoding, self.source, old, undo_file)
        command = restore_command(self.source, undo_file, context.system)
        count = _called(new)
        doing = f"Setting {count} for a while; if they stay" if plan.for_now else f"Writing {count}; to undo"
        if all(change.old == change.new for change in plan.changes):
            doing = f"Noting {count}, which the autopilot is about to change; to undo"
        context.show("write", f"{doing}: {command}")
        try:
            echoes_s = yield from protocol.write(context, new, self.encoding)
            remarks = yield from self.commit(context, plan)
            yield from protocol.prove(context, new, self.encoding, echoes_s)
        except GeneratorExit:
            raise way_back.left(context, "the procedure was ended") from None
        except Exception as why:
            yield from way_back.take(context, why)
            if isinstance(why, MavCompassError) and not isinstance(why, Refused):
                raise WriteFailed(
                    f"{why.what} What was written was put back, and {_called(old)} read back as before.",
                    why.remedy,
                    undo_file,
                ) from why
            raise

        values = {name: p.value for name, p in new.items()}
        again = again_command(self.source, undo_file, context.system)
        return WriteOutcome(True, undo_file, values, remarks, command, again, way_back)

    def _read_before(self, context: Context, plan: ParameterPlan) -> Script[dict[str, Parameter]]:
        """Read the parameters that will change; nothing is written where they are not as planned."""
        old = yield from protocol.read(context, [c.name for c in plan.changes], self.encoding, exist=True)
        for change in plan.changes:
            held = old.get(change.name)
            if held is None:
                raise WriteFailed(
                    f"The vehicle does not answer for {change.name}; nothing was written.",
                    "Check that its firmware has this parameter, then run again.",
                )
            if not holds(held, change.old, self.encoding):
                raise WriteFailed(
                    f"{change.name} is {held.value:g} now and was {change.old:g} when the write was planned;"
                    " nothing was written.",
                    "Somebody else is changing parameters: close other ground stations and run again.",
                )
        return old


@dataclass(frozen=True, slots=True)
class WayBack:
    """Hold what leads back from a write: the old values, and the record of them on the disk.

    Attributes:
        encoding, source: as of the transaction. old: by name, in the order of writing.
    """

    encoding: Encoding
    source: str
    old: Mapping[str, Parameter]
    undo_file: Path

    def __call__(self, context: Context, why: str) -> Script[None]:
        """Go it, because of a sentence, and remove the record: all is as before. Raises as `take` does.

        A stop that came meanwhile is raised at the end.
        """
        stop = yield from self.take(context, Refused(why))
        remove_record(self.undo_file)
        if stop is not None:
            raise stop

    def take(self, context: Context, why: Exception) -> Script[Refused | None]:
        """Write the old values, last change first, and prove them; return the stop that came meanwhile.

        Raises WriteFailed where that fails.
        """
        stopped: Refused | None = None
        context.show("undo", f"{_sentence(why)} Putting {_called(self.old)} back.")
        back = {name: self.old[name] for name in reversed(list(self.old))}
        while True:
            try:
                echoes_s = yield from protocol.write(context, back, self.encoding, _UNDO_SILENCE_S)
                yield from protocol.prove(context, back, self.encoding, echoes_s, _UNDO_SILENCE_S)
            except Refused as stop:  # which comes once: the vehicle is still, half a calibration is worse
                stopped = stop
                continue
            except GeneratorExit:
                raise self.left(context, _sentence(why)) from None
            except MavCompassError as trouble:
                left = self.left(context, f"{_sentence(why)} Then: {trouble.what}")
                context.show("undo", str(left))  # whatever becomes of the error on its way out
                raise left from trouble
            context.show("undo", f"{_called(self.old)} read back as before.")
            return stopped

    def left(self, context: Context, why: str) -> WriteFailed:
        """Say that it could not be gone, and the command that does it; the first is the worst."""
        command = restore_command(self.source, self.undo_file, context.system)
        left = WriteFailed(
            f"Writing was cut short and could not be undone ({why.rstrip('.')}): the vehicle may hold some"
            " new and some old values.",
            f"Bring the link back, then put the old values back with: {command}",
            self.undo_file,
            command,
        )
        context.left = context.left or left
        return left


def refuse_unwritable(plan: ParameterPlan) -> None:
    """Raise Refused where a plan must not be written, before anything is sent or put on disk."""
    reasons = list(plan.refusals)
    for change in plan.changes:
        for value in (change.old, change.new):
            if not is_single(value):
                reasons.append(f"{change.name} {change.old:g} -> {change.new:g} is not a number to write.")
                break
    if reasons:
        raise Refused(" ".join(reasons), "Nothing was written.")


def restore_command(source: str, undo_file: Path, system: int) -> str:
    """Spell the command that puts back what an undo file holds."""
    return _spelt("restore", source, undo_file, system)


def again_command(source: str, undo_file: Path, system: int) -> str:
    """Spell the command that writes the new values once more."""
    return _spelt("write", source, written_file(undo_file), system)


def _spelt(verb: str, source: str, file: Path, system: int) -> str:
    what = f"{shlex.quote(source)} {shlex.quote(str(file))} --system {system}{consent()}"
    return f"{program()} params {verb} {what}"


def _called(parameters: Collection[str]) -> str:
    """Name a few parameters, count many."""
    few = len(parameters) <= _FEW
    return named(list(parameters)) if few else counted(len(parameters), "parameter")


def _sentence(error: Exception) -> str:
    return error.what if isinstance(error, MavCompassError) else f"{type(error).__name__}: {error}"
