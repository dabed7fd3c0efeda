"""What a recording says of its vehicle, for answering in its name."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mavcompass.enums import MavAutopilot, MavType
from mavcompass.errors import BadRecording
from mavcompass.messages import Attitude, CommandAck, Heartbeat, ParamValue, SystemTime, message_id
from mavcompass.two_clocks import shared_id
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.replay.tlog import tlog_frames
from mavcompass.vehicle.wire import decode

# Nobody waits through the night between two power-ups.
LONGEST_PAUSE_S = 10.0


@dataclass(slots=True)
class Contents:
    """Hold what a recording says of its vehicle.

    Attributes:
        system, component: the autopilot's address. stations: addresses of ground stations.
        parameters: the first value of each, as PARAM_VALUE. results: the first COMMAND_ACK of each command.
        counts: messages of the autopilot by id, for their rates; duration_s: of the whole.
    """

    system: int = 1
    component: int = 1
    stations: set[tuple[int, int]] = field(default_factory=set)
    parameters: dict[str, ParamValue] = field(default_factory=dict)
    results: dict[int, int] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    duration_s: float = 0.0

    def interval_us(self, message_id: int) -> int:
        """Return the mean time between messages of an id, microseconds; 0 if there are none."""
        count = self.counts.get(message_id, 0)
        return round(self.duration_s * 1e6 / count) if count else 0


def survey(path: Path) -> Contents:
    """Read a .tlog once, for what the vehicle must be able to answer from the start.

    Raises BadRecording where no autopilot is in it, or two share a system id.
    """
    frames: dict[tuple[int, int], int] = {}
    vehicles: dict[tuple[int, int], Contents] = {}
    stations: set[tuple[int, int]] = set()
    autopilots: set[tuple[int, int]] = set()
    heard = LinkStatistics()
    telling = {message_id(kind) for kind in (Heartbeat, ParamValue, CommandAck, Attitude, SystemTime)}
    clock = RecordingClock()
    for stamp_s, frame in tlog_frames(path):
        sender = (frame.system, frame.component)
        clock.advance(stamp_s)
        frames[sender] = frames.get(sender, 0) + 1
        if (contents := vehicles.get(sender)) is None:
            contents = vehicles[sender] = Contents(*sender)
        contents.counts[frame.message_id] = contents.counts.get(frame.message_id, 0) + 1
        if frame.message_id not in telling:
            continue
        match message := decode(frame.message_id, frame.payload):
            case Attitude() | SystemTime():
                heard.count(*sender, frame.sequence, message)
            case Heartbeat(type=MavType.GCS):
                stations.add(sender)
            case Heartbeat(autopilot=autopilot) if autopilot != MavAutopilot.INVALID:
                autopilots.add(sender)
            case ParamValue() as value:
                contents.parameters.setdefault(value.param_id, value)
            case CommandAck(command, result):
                contents.results.setdefault(command, result)
    autopilots -= stations
    if not autopilots:
        raise BadRecording(f"{path} has no heartbeat of an autopilot.", "Give a recording of a vehicle.")
    chosen = vehicles[max(autopilots, key=frames.__getitem__)]
    if chosen.system in heard.shared:
        raise BadRecording(*shared_id(chosen.system))
    chosen.duration_s, chosen.stations = clock.time_s, stations
    return chosen


class RecordingClock:
    """Turn time stamps that may jump and pause into time from the start that does neither."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self._last_s: float | None = None

    def advance(self, stamp_s: float) -> float:
        """Take the next stamp, return its time."""
        if self._last_s is not None:
            self.time_s += min(max(stamp_s - self._last_s, 0.0), LONGEST_PAUSE_S)
        self._last_s = stamp_s
        return self.time_s
