"""What if somebody steps in? Calibrations of simulated vehicles, interrupted at random moments.

    python scripts/campaigns/interruptions.py [--runs 50] [--vehicle rover].. [--event stick].. [--json FILE]

Events: the pilot moves a stick, switches the mode or disarms; the battery fails; the program gets a stop
signal; the link falls silent, breaks for good, or is away for two seconds. Judged by the simulator's truth:
how long it was commanded on, and turned by that; whether parameters, mode and message rates are what they
were; and what the person is told. What the autopilot does by itself is not judged: it is told apart by what
was sent to it and by the mode that the event put it in. Left out are runs that were over before the event,
and those that went well where it came before the first turn. One that ends as if nothing had happened is
right where it commands no motion any more.
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
from mavcompass.procedure.turning.profiles import vehicle_profiles
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.stopping import StopRequest

EVENTS = ("stick", "mode", "disarm", "battery", "signal", "silence", "broken", "two-seconds")
OTHER_MODE = dict.fromkeys(("rover", "boat", "ackermann-rover"), "HOLD")
OTHER_MODE |= {"copter": "LOITER", "sub": "POSHOLD", "px4-copter": "POSCTL"}
LONGEST_S, LOOKS_ON_S = 40.0, 5.0
State = tuple[dict[str, float], int, dict[int, int]]  # parameters, mode, rates


@dataclass
class Outcome:
    """Hold how one interrupted run went.

    Attributes:
        turning_s: until when it turned as it had been told, seconds after the event; ends_s: as its profile
            has it, at the most. command_s: until when it was commanded, after event and link's return.
    """

    vehicle: str
    event: str
    seed: int
    at_s: float
    told: str = ""
    exit_code: int = 0
    turning_s: float = 0.0
    command_s: float = 0.0
    ends_s: float = 0.0
    wrong: list[str] = field(default_factory=list)


def state_of(vehicle: SimulatedAutopilot) -> State:
    """Read parameters, mode and rates straight off the vehicle."""
    streams = vehicle.firmware.telemetry.streams(0)
    rates = {number: streams.interval_us(number) for number in vehicle.firmware.telemetry.available}
    return dict(vehicle.firmware.store.values), vehicle.firmware.reports.heartbeat().custom_mode, rates


def happening(event: str, kind: str, scene: Scene, stop: StopRequest) -> Callable[[], None]:
    """Return what happens."""
    vehicle = scene.vehicle
    return {
        "stick": lambda: vehicle.pilot_moves_stick(4 if kind in ("copter", "sub") else 1),
        "mode": lambda: vehicle.pilot_switches_mode(OTHER_MODE[kind]),
        "disarm": vehicle.disarm,
        "battery": vehicle.battery_failsafe,
        "signal": lambda: setattr(stop, "reason", "Stopped by the system (SIGTERM)."),
        "silence": lambda: setattr(scene, "silent_until_s", math.inf),
        "broken": lambda: scene.__dict__.update(closed=True, silent_until_s=math.inf),
        "two-seconds": lambda: setattr(scene, "silent_until_s", vehicle.time_s + 2.0),
    }[event]


def interrupt(
    kind: str, event: str, seed: int, duration_s: float, settings: CalibrateSettings = AT_ONCE
) -> Outcome | None:
    """Run one calibration and interrupt it; None where it was over before."""
    at_s = random.Random(f"{kind} {event} {seed}").uniform(0.5, duration_s)
    way = next(profile.ways[0] for profile in vehicle_profiles() if profile.name == kind)
    with folder() as place:
        scene, stop = Scene(SimulatedAutopilot(kind, seed=seed), place), StopRequest()
        vehicle, happens = scene.vehicle, happening(event, kind, scene, stop)
        (values, mode, rates), shown, began = state_of(vehicle), set[str](), False

        def happen() -> None:
            nonlocal mode, began
            was, began = state_of(vehicle)[1], "turn" in shown
            happens()
            if (now := state_of(vehicle)[1]) != was:
                mode = now  # and that is not ours to change

        scene.at(at_s, happen)
        error: MavCompassError | None = None
        try:
            with scene.link() as link:
                told_of = partial(calibrate_on, on_show=lambda show: shown.add(show.step), stop=stop)
                told_of(link, f"sim:{kind}", settings, undo_directory=scene.undo_folder)
        except MavCompassError as caught:
            error = caught
        if scene.agenda or (error is None and not began):
            return None
        scene.look_on(LOOKS_ON_S)
    told, code = (str(error), error.exit_code) if error else ("done", 0)
    heard_s = max(at_s, scene.silent_until_s)  # nobody is commanded before the link is back
    ends_s = way.round_ends_within_s if settings.continuous else way.ends_within_s
    lasted = (scene.turning_s - at_s, scene.commanded_s - heard_s, ends_s)
    outcome = Outcome(kind, event, seed, round(at_s, 2), told, code, *(round(max(s, 0.0), 2) for s in lasted))
    judge(outcome, (values, mode, rates), scene, error)
    return outcome


def judge(outcome: Outcome, wanted: State, scene: Scene, error: MavCompassError | None) -> None:
    """Say what was wrong with a run."""
    wrong, after = outcome.wrong, state_of(scene.vehicle)
    lost, lives = scene.silent_until_s > -math.inf, scene.silent_until_s < math.inf
    if outcome.command_s > 1.0:
        wrong.append("commanded motion more than 1 s after")
    if outcome.turning_s > outcome.ends_s:
        wrong.append("turned for longer than its profile says")
    if lives and wanted[1] != after[1]:
        wrong.append("left another mode")
    if lives and wanted[2] != after[2]:
        wrong.append("left other rates")
    if error is None:
        return
    ours = {name for name in scene.wrote if wanted[0].get(name) != after[0].get(name)}
    compass = {name for name in ours if name.startswith(("COMPASS_", "CAL_"))}
    if compass and not (isinstance(error, WriteFailed) and error.undo_file and error.restore_command):
        wrong.append("left new parameters without an undo file")
    if lives and compass:
        wrong.append("left new parameters although the link lives")
    if outcome.exit_code not in ({3, 6} if not lives else {3, 6, 7} if lost else {7}):
        wrong.append(f"exit code {outcome.exit_code}")


def main() -> int:
    """Run the campaign and print the table."""
    wanted = options(
        __doc__, runs=50, vehicle=Several(OTHER_MODE), event=Several(EVENTS), first_seed=0, workers=1
    )
    outcomes: list[Outcome] = []
    print("vehicle         event         runs  right  turning max s  command max s  exit codes")
    for kind in wanted.vehicle or OTHER_MODE:
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
