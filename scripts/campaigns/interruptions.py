"""What if somebody steps in? Calibrations of simulated vehicles, interrupted at random moments.

    python scripts/campaigns/interruptions.py [--runs 50] [--vehicle rover].. [--event stick].. [--json FILE]

Events: the pilot moves a stick, switches the mode or disarms; the battery fails; the program gets a stop
signal; the link falls silent, breaks for good, or is away for two seconds. Judged by the simulator's truth:
when the turning ended, when the last command to move arrived, whether parameters, mode and message rates
are what they were, and what the person is told. Runs that were over, or as good as over, before the event
are left out.
"""

from __future__ import annotations

import math
import random
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from campaign import Several, ended, folder, options, tried
from fault_cells.scene import Scene
from fault_cells.works import AT_ONCE

from mavcompass.errors import MavCompassError, WriteFailed
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.stopping import StopRequest

EVENTS = ("stick", "mode", "disarm", "battery", "signal", "silence", "broken", "two-seconds")
OTHER_MODE = {
    "rover": "HOLD",
    "boat": "HOLD",
    "ackermann-rover": "HOLD",
    "copter": "LOITER",
    "sub": "POSHOLD",
    "px4-copter": "POSCTL",
}
LONGEST_S, LOOKS_ON_S = 40.0, 5.0
# What happens this shortly before the end of a run may go unnoticed: nothing moves any more.
TOO_LATE_S = 1.0
State = tuple[dict[str, float], int, dict[int, int]]  # parameters, mode, rates


@dataclass
class Outcome:
    """Hold how one interrupted run went; times in seconds after the event."""

    vehicle: str
    event: str
    seed: int
    at_s: float
    told: str = ""
    exit_code: int = 0
    turning_s: float = 0.0
    command_s: float = 0.0
    wrong: list[str] = field(default_factory=list)


def state_of(vehicle: SimulatedAutopilot) -> State:
    """Read parameters, mode and rates straight off the vehicle."""
    streams = vehicle.firmware.telemetry.streams(0)
    rates = {number: streams.interval_us(number) for number in vehicle.firmware.telemetry.available}
    return dict(vehicle.firmware.store.values), vehicle.firmware.reports.heartbeat().custom_mode, rates


def happening(event: str, kind: str, scene: Scene, stop: StopRequest) -> Callable[[], None]:
    """Return what happens."""
    vehicle = scene.vehicle
    happenings: dict[str, Callable[[], None]] = {
        "stick": lambda: vehicle.pilot_moves_stick(4 if kind in ("copter", "sub") else 1),
        "mode": lambda: vehicle.pilot_switches_mode(OTHER_MODE[kind]),
        "disarm": vehicle.disarm,
        "battery": vehicle.battery_failsafe,
        "signal": lambda: setattr(stop, "reason", "Stopped by the system (SIGTERM)."),
        "silence": lambda: setattr(scene, "silent_until_s", math.inf),
        "broken": lambda: setattr(scene, "closed", True),
        "two-seconds": lambda: setattr(scene, "silent_until_s", vehicle.time_s + 2.0),
    }
    return happenings[event]


def interrupt(
    kind: str, event: str, seed: int, duration_s: float, settings: CalibrateSettings = AT_ONCE
) -> Outcome | None:
    """Run one calibration and interrupt it; None where it was over before."""
    at_s = random.Random(f"{kind} {event} {seed}").uniform(0.5, duration_s)
    with folder() as place:
        scene, stop = Scene(SimulatedAutopilot(kind, seed=seed), place), StopRequest()
        scene.at(at_s, happening(event, kind, scene, stop))
        before = state_of(scene.vehicle)
        error: MavCompassError | None = None
        try:
            with scene.link() as link:
                calibrate_on(link, f"sim:{kind}", settings, stop=stop, undo_directory=scene.undo_folder)
        except MavCompassError as caught:
            error = caught
        if scene.agenda or (error is None and scene.vehicle.time_s - at_s < TOO_LATE_S):
            return None
        scene.look_on(LOOKS_ON_S)
    told, code = (str(error), error.exit_code) if error else ("done", 0)
    turning_s, command_s = (
        round(max(last_s - at_s, 0.0), 2) for last_s in (scene.turning_s, scene.commanded_s)
    )
    outcome = Outcome(kind, event, seed, round(at_s, 2), told, code, turning_s, command_s)
    judge(outcome, before, state_of(scene.vehicle), error)
    return outcome


def judge(
    outcome: Outcome,
    before: State,
    after: State,
    error: MavCompassError | None,
) -> None:
    """Say what was wrong with a run."""
    wrong = outcome.wrong
    link_lives = outcome.event not in ("silence", "broken")
    if error is None:
        # A link that dies while rates are put back comes too late to spoil anything.
        if outcome.event not in ("two-seconds", "battery", "silence", "broken"):
            wrong.append("was not noticed")
        return
    if outcome.command_s > 1.0:
        wrong.append("commanded motion more than 1 s after")
    if outcome.turning_s > 1.0:
        wrong.append("turned more than 1 s after")
    changed = {name for name in before[0] if before[0][name] != after[0].get(name)}
    compass = {name for name in changed if name.startswith(("COMPASS_", "CAL_"))}
    if compass and not (isinstance(error, WriteFailed) and error.undo_file and error.restore_command):
        wrong.append("left new parameters without an undo file")
    if link_lives and compass:
        wrong.append("left new parameters although the link lives")
    pilot_flies = outcome.event == "stick" and outcome.vehicle == "px4-copter"  # PX4 hands over by itself
    kept = outcome.event in ("stick", "signal", "two-seconds") and not pilot_flies
    if link_lives and kept and before[1] != after[1]:
        wrong.append("left another mode")
    if link_lives and before[2] != after[2]:
        wrong.append("left other rates")
    expected = {3, 6} if outcome.event in ("silence", "broken") else {7}
    if outcome.exit_code not in expected and outcome.event != "two-seconds":
        wrong.append(f"exit code {outcome.exit_code}")


def main() -> int:
    """Run the campaign and print the table."""
    wanted = options(
        __doc__, runs=50, vehicle=Several([*OTHER_MODE]), event=Several(EVENTS), first_seed=0, workers=1
    )
    outcomes: list[Outcome] = []
    print("vehicle         event         runs  right  turning max s  command max s  exit codes")
    for kind in wanted.vehicle or ("rover", "copter"):
        for event in wanted.event or EVENTS:
            seeds = range(wanted.first_seed, wanted.first_seed + wanted.runs)
            one = partial(interrupt, kind, event, duration_s=LONGEST_S)
            found = [o for o in tried(one, seeds, workers=wanted.workers) if o is not None]
            outcomes += found
            row(kind, event, found)
    return ended(wanted.json, outcomes, any(outcome.wrong for outcome in outcomes))


def row(kind: str, event: str, found: list[Outcome]) -> None:
    """Print one line, and below it what went wrong."""
    right = sum(not outcome.wrong for outcome in found)
    turning = max((outcome.turning_s for outcome in found), default=0.0)
    command = max((outcome.command_s for outcome in found), default=0.0)
    codes = ", ".join(f"{code}: {n}" for code, n in sorted(Counter(o.exit_code for o in found).items()))
    print(
        f"{kind:15} {event:12} {len(found):5} {right:6} {turning:14.2f} {command:14.2f}  {codes}", flush=True
    )
    for reason, count in Counter(reason for outcome in found for reason in outcome.wrong).most_common():
        example = next(outcome for outcome in found if reason in outcome.wrong)
        print(f"    {count} x {reason}, such as seed {example.seed} at {example.at_s} s: {example.told}")


if __name__ == "__main__":
    sys.exit(main())
