"""What if somebody steps in? Calibrations of simulated vehicles, interrupted at random moments.

    python scripts/campaigns/interruptions.py [--runs 50] [--vehicle rover].. [--event stick].. [--json FILE]

Events: the pilot moves a stick, switches the mode or disarms; the battery fails; the program gets a stop
signal; the link falls silent, breaks for good, or is away for two seconds. Judged by the simulator's truth:
when the turning ended, when the last command to move arrived, whether parameters, mode and message rates
are what they were, and what the person is told. Runs that were over, or as good as over, before the event
are left out.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from mavcompass.errors import MavCompassError, WriteFailed
from mavcompass.messages import CommandLong, Message, SetAttitudeTarget, SetPositionTargetLocalNed
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.autopilot import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.stopping import StopRequest

EVENTS = ("stick", "mode", "disarm", "battery", "signal", "silence", "broken", "two-seconds")
LINK_EVENTS = {"silence": math.inf, "broken": math.inf, "two-seconds": 2.0}
OTHER_MODE = {
    "rover": "HOLD",
    "boat": "HOLD",
    "ackermann-rover": "HOLD",
    "copter": "LOITER",
    "sub": "POSHOLD",
    "px4-copter": "POSCTL",
}
TURNING_RADPS = math.radians(5.0)
LONGEST_S = 40.0
# What happens this shortly before the end of a run may go unnoticed: nothing moves any more.
TOO_LATE_S = 1.0


class Witness:
    """Stand before a vehicle: make the event happen, and see what the vehicle hears and does after it."""

    def __init__(self, vehicle: SimulatedAutopilot, event_s: float, happen: Callable[[], None]) -> None:
        self.vehicle = vehicle
        self.event_s = event_s
        self._happen = happen
        self.happened = False
        self.last_turning_s = self.last_command_s = -math.inf

    @property
    def time_s(self) -> float:
        return self.vehicle.time_s

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        if moves(message):
            self.last_command_s = self.time_s
        self.vehicle.receive(message, system, component, port)

    def advance(self, until_s: float) -> Sequence[Outgoing]:
        if not self.happened and until_s >= self.event_s:
            self.happened = True
            self._happen()
        said = self.vehicle.advance(until_s)
        if abs(self.vehicle.body.yaw_rate_radps) > TURNING_RADPS:
            self.last_turning_s = self.time_s
        return said


def moves(message: Message) -> bool:
    """Tell whether a message asks for a turn; a command of zero rate does not."""
    match message:
        case CommandLong(command=115):
            return True
        case SetPositionTargetLocalNed(yaw_rate=rate, type_mask=mask):
            return not (mask & 0x400) or rate != 0.0
        case SetAttitudeTarget(body_yaw_rate=rate, type_mask=mask):
            return not (mask & 0x80) or rate != 0.0
    return False


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


def state_of(vehicle: SimulatedAutopilot) -> tuple[dict[str, float], int, dict[int, int]]:
    """Read parameters, mode and rates straight off the vehicle."""
    streams = vehicle.firmware.telemetry.streams(0)
    rates = {number: streams.interval_us(number) for number in vehicle.firmware.telemetry.available}
    return dict(vehicle.firmware.store.values), vehicle.firmware.reports.heartbeat().custom_mode, rates


def interrupt(kind: str, event: str, seed: int, duration_s: float) -> Outcome | None:
    """Run one calibration and interrupt it; None where it was over before."""
    vehicle = SimulatedAutopilot(kind, seed=seed)
    at_s = random.Random(f"{kind} {event} {seed}").uniform(0.5, duration_s)
    stop = StopRequest()
    happenings: dict[str, Callable[[], None]] = {
        "stick": lambda: vehicle.pilot_moves_stick(4 if kind in ("copter", "sub") else 1),
        "mode": lambda: vehicle.pilot_switches_mode(OTHER_MODE[kind]),
        "disarm": vehicle.disarm,
        "battery": vehicle.battery_failsafe,
        "signal": lambda: setattr(stop, "reason", "Stopped by the system (SIGTERM)."),
    }
    witness = Witness(vehicle, at_s, happenings.get(event, lambda: None))
    before = state_of(vehicle)
    cut = Faults()
    if event in LINK_EVENTS:
        cut = Faults(cut_at_s=at_s, cut_is_final=event == "broken", restored_at_s=at_s + LINK_EVENTS[event])
    outcome = Outcome(kind, event, seed, round(at_s, 2))
    with tempfile.TemporaryDirectory() as folder, FaultyLink(SimulatedLink(witness), cut, seed) as link:
        error: MavCompassError | None = None
        try:
            calibrate_on(
                link,
                f"sim:{kind}",
                CalibrateSettings(motion="vehicle", writing="yes"),
                stop=stop,
                undo_directory=Path(folder),
            )
        except MavCompassError as caught:
            error = caught
        if not witness.happened or (error is None and witness.time_s - at_s < TOO_LATE_S):
            return None
        witness.advance(witness.time_s + 0.01)
        end_s = witness.time_s + 5.0
        while witness.time_s < end_s:
            witness.advance(witness.time_s + 0.01)
    outcome.told, outcome.exit_code = (str(error), error.exit_code) if error else ("done", 0)
    outcome.turning_s = round(max(witness.last_turning_s - at_s, 0.0), 2)
    outcome.command_s = round(max(witness.last_command_s - at_s, 0.0), 2)
    judge(outcome, before, state_of(vehicle), error)
    return outcome


def judge(
    outcome: Outcome,
    before: tuple[dict[str, float], int, dict[int, int]],
    after: tuple[dict[str, float], int, dict[int, int]],
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


def main() -> None:
    """Run the campaign and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--vehicle", action="append", choices=[*OTHER_MODE])
    parser.add_argument("--event", action="append", choices=EVENTS)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    outcomes: list[Outcome] = []
    print("vehicle         event         runs  right  turning max s  command max s  exit codes")
    for kind in arguments.vehicle or ("rover", "copter"):
        for event in arguments.event or EVENTS:
            seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
            found = [o for seed in seeds if (o := interrupt(kind, event, seed, LONGEST_S)) is not None]
            outcomes += found
            row(kind, event, found)
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(outcome) for outcome in outcomes], indent=1))


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
    main()
