"""Is a calibration judged alike through every door? Situations by doors, one test body, judged by the truth.

    python scripts/campaigns/doors.py [--only WORD]... [--free 20] [--json FILE]

A situation (`door_situations.py`) is a simulated vehicle and what is right of it. Live, the vehicle turns
itself, or a person turns it. What it said up to the first write is a .tlog: for the command, Python, the
fleet, and as a .csv for the command again. From two minutes of being turned about a service learns. The
table has a line for each situation and door: the verdict, the claimed sigma, the true heading error (rms over
the circle, level), the greatest ratio of the two, the first reason or the remark that belongs to it, and what
the door cannot carry. (Whether claimed sigmas cover is asked by `vehicles.py`.) Contradictions come below it:

- a verdict or a reason that is not the one of this situation, where the door carries the evidence for it,
- an accepted result, or a compass called right, beyond four of the sigmas that it claims (that the mounting
  cannot be seen through a door counts where this door says so),
- values written that were right, and values not written that were to be.

Exit code 1 where there is one.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from campaign import Several, ended, options
from campaign import folder as new_folder
from door_situations import OTHERS, PARAMETERS, UNSEEN, Situation, Wire, situations

from mavcompass import messages as mav
from mavcompass.api import calibrate, read_track
from mavcompass.calibration import calibrate_compasses
from mavcompass.cli.main import main as command
from mavcompass.correction import FieldCorrection
from mavcompass.errors import BadRecording, MavCompassError
from mavcompass.fleet.examine import Job, examine
from mavcompass.logs import write_track_csv
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.script import Context, Machine, Script, pause
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run

SIGMAS = 4.0
QUARTERS = [HandMove(0.0, 0.5, 6.0), *[HandMove(math.radians(90.0), 3.0, 5.0)] * 4]
ABOUT_MOVES = [HandMove(math.radians(90.0 + 7.0 * (k % 5 - 2)), 3.0, 2.0) for k in range(24)]


@dataclass(frozen=True)
class Cell:
    """Hold what one door said of one situation."""

    family: str
    door: str
    verdict: str
    shown: str = ""
    sigma_deg: float = math.nan
    error_deg: float = math.nan
    lacks: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()


# --- doors --------------------------------------------------------------------------------------------

Entry = Mapping[str, Any]  # a compass's, as in the calibration JSON


def by_command(path: Path, *options: str) -> Entry:
    """Ask the command; return the compass's entry of its JSON."""
    out, said = path.with_suffix(".json"), io.StringIO()
    out.unlink(missing_ok=True)
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        command(["calibrate", str(path), *options, "--json", str(out)])
    if not out.exists():
        raise BadRecording(said.getvalue().strip(), "")
    entry: Entry = json.loads(out.read_text())["compasses"][0]
    return entry


def by_python(path: Path) -> Entry:
    """Ask the Python function."""
    return calibrate(read_track(path)).to_json()


def by_fleet(path: Path) -> Entry:
    """Ask the fleet; return its row as an entry."""
    (row,) = examine(Job("calibrate"), str(path))
    if row["status"] == "error":
        raise BadRecording(row["error"], "")
    correction = {
        "offsets_mgauss": [row[f"offset_{a}_mgauss"] for a in "xyz"],
        "diagonals": [row[f"diagonal_{a}"] for a in "xyz"],
        "off_diagonals": [row[f"off_diagonal_{a}"] for a in ("xy", "xz", "yz")],
        "scale": row["scale"],
        "motor_mgauss": [row[f"motor_{a}_mgauss"] for a in "xyz"],
        "motor_source": row["motor_source"],
    }
    texts = {"reasons": [row["reasons"]], "warnings": [row["warnings"]]}
    return row | texts | {"correction": correction, "parameters": {}}


def by_table(path: Path) -> Entry:
    """Ask the command about the recording as a table."""
    table = path.with_suffix(".csv")
    write_track_csv(read_track(path), table)
    return by_command(table)


def learnt(path: Path) -> Entry:
    """Ask what a service learns of a vehicle that is turned about."""
    entry: Entry = calibrate_compasses(read_track(path), "running")[1].to_json()
    return entry


ITSELF, BY_HAND, ABOUT = "turns itself", "by hand", "turned about"
DOORS: Mapping[str, Mapping[str, Callable[..., Entry]]] = {
    ITSELF: {"its .tlog": by_command, "Python": by_python, "fleet": by_fleet, "its .csv": by_table},
    BY_HAND: {"hand's .tlog": by_command},
    ABOUT: {"learnt": learnt},
}
MENDING = ("its .tlog", "hand's .tlog")
LACKS = {"its .csv": frozenset({OTHERS, PARAMETERS})}


def listened(context: Context, seconds: float) -> Script[None]:
    """Listen to a vehicle."""
    desk = yield from Desk.open(context, lambda autopilot: make_dialect(autopilot, "sim"), None)
    rates = desk.imu_rates(desk.instances, 10.0) | dict.fromkeys((mav.GpsRawInt, mav.SysStatus), 4.0)
    rates |= {mav.Attitude: 10.0, mav.GlobalPositionInt: 2.0, mav.SystemTime: 1.0}
    yield from MessageRates().ask(context, rates)
    yield from pause(context, seconds)


def run_live(wire: Wire, how: str, orientation: bool, undo: Path) -> tuple[Entry, bool]:
    """Have a vehicle calibrated, or listened to; return the compass's entry and whether it was written."""
    link = wire.link()
    if how == ABOUT:
        wire.vehicles[0].turn_by_hand(ABOUT_MOVES)
        run(Machine(lambda context: listened(context, 5.0 * len(ABOUT_MOVES))), link)
        return {}, False
    if how == BY_HAND:
        wire.vehicles[0].turn_by_hand(QUARTERS)
    motion: Any = "hand" if how == BY_HAND else "vehicle"
    settings = CalibrateSettings(writing="yes", motion=motion, orientation=orientation)
    report = calibrate_on(link, "sim:vehicle", settings, undo_directory=undo)
    return report.results[0].to_json(), report.written


# --- judgement ----------------------------------------------------------------------------------------


def judged(entry: Entry, one: SimulatedAutopilot, before: Mapping[str, float]) -> tuple[str, float, float]:
    """Return the verdict, the sigma that it claims, and the true heading error with what it gives."""
    sigma = math.nan if entry["heading_sigma_deg"] is None else float(entry["heading_sigma_deg"])
    if not entry["accepted"]:
        return "refused", sigma, math.nan
    right, store = bool(entry["already_right"]), one.firmware.parameters.store
    now, given = dict(store.values), {} if right else dict(entry["parameters"])
    spelled = right or any(name in now for name in given)
    for name, value in {**before, **given}.items():
        store.set(name, value)
    one.firmware.compasses.parameters_changed()
    error = heading_error_rms_deg(one, 1, None if spelled else FieldCorrection(**entry["correction"]))
    for name, value in now.items():
        store.set(name, value)
    one.firmware.compasses.parameters_changed()
    if right:
        return "right", max(sigma, float(entry["heading_change_deg"])), error
    return "accepted", sigma, error


def cell(
    of: Situation,
    door: str,
    ask: Callable[[], tuple[Entry, bool | None]],
    *,
    wire: Wire,
    before: Mapping[str, float],
    mends: bool,
) -> Cell:
    """Ask at one door, and judge what it says."""
    lacks = tuple(sorted(LACKS.get(door, frozenset()) & of.needs))
    verdict, says = of.blind if lacks else ("accepted", "") if mends else (of.verdict, of.says)
    sigma = error = math.nan
    written: bool | None = None
    try:
        entry, written = ask()
        found, sigma, error = judged(entry, wire.vehicles[0], before)
        said = tuple(entry["reasons"] if found == "refused" else entry["warnings"])
    except MavCompassError as why:
        found, said = "error", (str(why),)
    wrong = []
    if found not in verdict.split(" or "):
        wrong.append(f"{found} instead of {verdict}: {said[0] if said else ''}")
    elif (
        says
        and (found in verdict.split(" or ")[:1] or not lacks)
        and not any(says in sentence for sentence in (said[:1] if found in ("refused", "error") else said))
    ):
        wrong.append(f'does not say "{says}", but: {said[0] if said else ""}')
    if error > SIGMAS * sigma and not (lacks and any(UNSEEN in sentence for sentence in said)):
        wrong.append(f"{error:.2f} deg off at a claimed {sigma:.2f}")
    if written is not None and written is not (found == "accepted"):
        wrong.append("written" if written else "not written")
    shown = next((one for one in said if says and says in one), said[0] if said else "")
    shown = shown[shown.rfind(". ", 0, max(shown.find(says), 0)) + 1 :].strip()
    return Cell(of.family, door, found, shown, sigma, error, lacks, tuple(wrong))


def cells(of: Situation, folder: Path) -> Iterator[Cell]:
    """Try every door of a situation."""
    for how, mends in itertools.product(DOORS, (False, True) if of.mends else (False,)):
        if mends and how == ABOUT:
            continue
        option = ("--orientation",) if mends else ()
        vehicles = [of.make(how == ITSELF) for _ in range(of.vehicles)]
        for other in vehicles[1:]:
            other.board.boot_us -= 500_000_000
        before = dict(vehicles[0].firmware.parameters.store.values)
        tlog = folder / f"{len(list(folder.iterdir()))}.tlog"
        wire = Wire(vehicles, of.edit, tlog)
        judge = partial(cell, of, wire=wire, before=before, mends=mends)
        live = partial(run_live, wire, how, mends, folder / "undo")
        if how != ABOUT:
            yield judge(" ".join((how, *option)), live)
        else:
            with contextlib.suppress(MavCompassError):
                live()
        wire.close()
        for door, ask in DOORS[how].items():
            if not mends or door in MENDING:
                yield judge(" ".join((door, *option)), partial(recorded, ask, tlog, *option))


def recorded(ask: Callable[..., Entry], path: Path, *options: str) -> tuple[Entry, None]:
    """Ask about a recording: nothing is written."""
    return ask(path, *options), None


# --- the table ----------------------------------------------------------------------------------------


def lines(found: Sequence[Cell]) -> Iterator[str]:
    """Yield the table, a line for each family and door."""
    table: dict[tuple[str, str], list[Cell]] = {}
    for one in found:
        table.setdefault((one.family, one.door), []).append(one)
    titles = f"{'n':>3} {'verdict':12} {'claims deg':>11} {'off':>6} {'sigmas':>6}"
    yield f"{'situation':36} {'door':27} {titles}  said"
    for (family, door), group in table.items():
        claims = [(c.error_deg, c.sigma_deg) for c in group if not math.isnan(c.error_deg)]
        numbers = f"{'':25}"
        if claims:
            errors, sigmas = zip(*claims, strict=True)
            ratio = max(error / sigma for error, sigma in claims)
            numbers = f"{min(sigmas):.2f} - {max(sigmas):.2f} {max(errors):6.2f} {ratio:6.1f}"
        verdicts = ", ".join(dict.fromkeys(c.verdict for c in group))
        told = f"cannot carry: {', '.join(group[0].lacks)}. " if group[0].lacks else ""
        told += group[0].shown[:110] + (" <<<" if any(c.wrong for c in group) else "")
        yield f"{family:36} {door:27} {len(group):3} {verdicts:12} {numbers}  {told}"


def contradictions(found: Sequence[Cell]) -> list[str]:
    """List what is wrong."""
    return [f"{one.family} / {one.door}: {wrong}" for one in found for wrong in one.wrong]


def tried(chosen: Sequence[Situation]) -> list[Cell]:
    """Try situations."""
    with new_folder() as folder:
        return [one for of in chosen for one in cells(of, folder)]


def main() -> int:
    """Print the table."""
    wanted = options(
        __doc__,
        only=(Several(), "situations with this in their name"),
        free=(20, "free mountings of each autopilot"),
    )
    chosen = [
        s for s in situations(wanted.free) if not wanted.only or any(word in s.family for word in wanted.only)
    ]
    found = tried(chosen)
    print("\n".join(lines(found)))
    wrong = contradictions(found)
    print(f"\n{len(chosen)} situations, {len(found)} cells, {len(wrong)} contradictions")
    print("".join(f"  {line}\n" for line in wrong), end="")
    return ended(wanted.json, found, wrong)


if __name__ == "__main__":
    sys.exit(main())
