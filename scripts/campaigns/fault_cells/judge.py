"""Judge what a cell left behind: by the vehicle's storage, the disk, and what the person was told."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from pathlib import Path

from fault_cells.scene import Hung, Killed, Scene
from fault_cells.works import Ending, Work, write_file
from mavcompass.errors import MavCompassError, Refused, UsageError
from mavcompass.vehicle.parameters.undo import UndoRecord, load_record
from mavcompass.vehicle.parameters.values import same_value

STANDS_WITHIN_S = 1.0
_LOOKS_ON_S = 3.0
CALIBRATIONS = ("calibrate", "round")
_COMMAND = re.compile(r"(\S+) params restore (\S+) (\S+\.json)")
# What these change after the last reading, no program can know.
UNSEEN = ("second client", "rebooted, old", "disarmed")


def judge_end(scene: Scene, work: Work, ending: Ending, ended_s: float, known: frozenset[Path]) -> list[str]:
    """List what is wrong at the end of a run; `known` are the undo files from before it."""
    error = ending.error
    wrong = list(scene.tracebacks)
    if isinstance(error, Hung):
        wrong.append(f"hangs: {error}")
    elif error is not None and not isinstance(error, (MavCompassError, Killed)):
        wrong.append(f"traceback: {type(error).__name__}: {error}")
    elif isinstance(error, MavCompassError) and re.match(r"\w+Error: ", error.what):
        wrong.append(f"traceback, told as {error.what}")
    stepped_in = scene.fault is not None and scene.fault.steps_in
    # What is over before it turns, or is no reason to stop, need not end it.
    goes_on = work.goes_on or (stepped_in and error is None and not scene.began)
    wrong += _what_was_told(scene, ending, known) + _motion(scene, work, ended_s, goes_on)
    if stepped_in and work.name in CALIBRATIONS:
        wrong += _stepped_in(scene, error)
    return wrong


def _motion(scene: Scene, work: Work, ended_s: float, goes_on: bool) -> list[str]:
    """Look on for a while: the vehicle stands, and did so in time."""
    scene.look_on(_LOOKS_ON_S)
    longer_s = scene.turning_s - ended_s
    if scene.fault is not None and scene.fault.ends_it:
        # The service goes on after a fault, and may turn the vehicle again when it is asked to.
        last_s = scene.stood_s if goes_on else scene.turning_s
        longer_s = max(longer_s, last_s - scene.at_s)
    late = work.moves and longer_s > STANDS_WITHIN_S + work.flies_on_s
    return [f"turned {longer_s:.2f} s longer"] if late else []


def _stepped_in(scene: Scene, error: BaseException | None) -> list[str]:
    """Judge a calibration that somebody ended: no order after it, all put back, told as a refusal.

    One that ends as if nothing had happened is right where it commands no motion any more.
    """
    mode, rates = scene.mode_and_rates()
    now = scene.compass_values()
    new = scene.wrote & now.keys() - scene.foreign.keys()
    left = sorted(name for name in new if not same_value(now[name], scene.before[name]))
    wrong = {
        f"left {', '.join(left)} written": bool(left and error),
        "commanded motion more than a second after": scene.began
        and scene.commanded_s > scene.at_s + STANDS_WITHIN_S,
        "left another mode": mode != scene.mode,
        "left other rates": rates != scene.rates,
        f"ended with {error!r}": error is not None and not isinstance(error, Refused),
    }
    return [sentence for sentence, is_so in wrong.items() if is_so]


def _what_was_told(scene: Scene, ending: Ending, known: frozenset[Path]) -> list[str]:
    """Compare what was told with what the vehicle holds now."""
    records = _records(scene, known)
    if not ending.written:
        return []
    if scene.foreign and scene.fault is not None and scene.fault.name in UNSEEN:
        if not all(scene.read_s.get(n, -1e9) > scene.foreign_s + 0.1 for n in scene.foreign):
            return []  # nobody can know
    now = scene.compass_values()
    planned = dict(records[-1][1].planned) if records else {}
    torn = [name for name, value in planned.items() if not same_value(now[name], value)]
    return [f"told written, and {', '.join(torn) or 'nothing'} is not"] if torn or not planned else []


def judge_way_back(scene: Scene, known: frozenset[Path]) -> list[str]:
    """Where the vehicle does not hold the old set, follow the sentence that restores it."""
    now, before = scene.compass_values(), scene.before
    changed = {name for name in before if not same_value(now[name], before[name])}
    foreign = {name for name, value in scene.foreign.items() if same_value(now[name], value)}
    if not changed - foreign:
        return []
    records = _records(scene, known)
    if not records:
        return [f"changed {', '.join(sorted(changed - foreign))} without an undo file"]
    # A run that was killed between its undo file and the sentence had changed nothing.
    named = _named(scene)
    told = [(p, r) for p, r in records if p in named] or records
    path, record = next(((p, r) for p, r in told if changed - foreign <= set(r.before)), told[0])
    wrong = []
    if uncovered := changed - foreign - set(record.before):
        wrong.append(f"the undo file lacks {', '.join(sorted(uncovered))}")
    own = {name: value for name, value in record.before.items() if name not in scene.foreign}
    if false := [name for name, value in own.items() if not same_value(value, before[name])]:
        wrong.append(f"the undo file holds another old value of {', '.join(false)}")
    return wrong + _way_back(scene, path, record)


def _records(scene: Scene, known: frozenset[Path]) -> list[tuple[Path, UndoRecord]]:
    """Read the undo files of the run, in the order of their making; half ones are none."""
    found, new = [], set(scene.undo_folder.glob("*.json")) - known
    for path in sorted(new, key=lambda p: (p.stat().st_ctime_ns, p)):
        try:
            found.append((path, load_record(path)))
        except UsageError:
            continue
    return found


def _named(scene: Scene) -> set[Path]:
    """List the undo files whose command was told."""
    return {Path(shlex.split(said[3])[0]) for text in scene.told for said in _COMMAND.finditer(text)}


def _way_back(scene: Scene, path: Path, record: UndoRecord) -> list[str]:
    """Find the sentence that restores, and do what it says."""
    if path not in _named(scene):
        return [f"nobody was told how to restore {path.name}"]
    said = list(scene.told)
    try:
        write_file(scene, path, checked=False)
    except (Exception, Killed, Hung) as error:
        return [f"the way back does not work: {type(error).__name__}: {error}"]
    finally:
        scene.told = said
    return _not_back(scene, record.before)


def _not_back(scene: Scene, wanted: Mapping[str, float]) -> list[str]:
    now = scene.compass_values()
    left = [name for name, value in wanted.items() if not same_value(now[name], value)]
    return [f"the way back leaves {', '.join(left)}"] if left else []
