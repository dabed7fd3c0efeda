"""A recording as if the vehicle were there: what it said then, and answers to what it is asked now.

A .tlog is played frame by frame, as recorded. Of any other recording the Track is turned into messages
(`track_messages`). The replayed vehicle beats its heart, tells its parameters and answers commands as the
recording says; parameters written to it are kept for the session, although nothing moves for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from mavcompass.errors import LinkLost, UsageError
from mavcompass.messages import Heartbeat, Incoming, Message
from mavcompass.track import Track
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity
from mavcompass.vehicle.links.autopilot import Recorded, SaidMessage
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.replay.alterations import Alterations
from mavcompass.vehicle.replay.answers import Answers, Contents, survey
from mavcompass.vehicle.replay.tlog import RecordingClock, tlog_frames
from mavcompass.vehicle.wire import decode

ReadTrack = Callable[[Path], Track]


class ReplayedAutopilot:
    """Be the vehicle of a recording; see `mavcompass.vehicle.links.autopilot.Autopilot`."""

    def __init__(
        self, played: Iterable[SaidMessage], contents: Contents, alterations: Alterations | None = None
    ) -> None:
        self.time_s = 0.0
        self._alter = (alterations or Alterations()).begin()
        self._coming: Iterator[SaidMessage] = iter(played)
        self._next = next(self._coming, None)
        self._answers = Answers(contents)

    @property
    def ended(self) -> bool:
        """Tell whether everything has been played."""
        return self._next is None

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Hear a message; the answer leaves with the next `advance`."""
        self._answers.hear(message, port, self.time_s)

    def advance(self, until_s: float) -> Sequence[SaidMessage]:
        """Play up to then."""
        played: list[SaidMessage] = list(self._answers.take())
        while self._next is not None and self._next.time_s <= until_s:
            if self._answers.notice(self._next):
                played.append(self._alter(self._next))
            self._next = next(self._coming, None)
        self.time_s = max(self.time_s, until_s)
        return played


class ReplayedLink(SimulatedLink):
    """Play a recording in this process; LinkLost at its end."""

    def __init__(self, recorded: Recorded, name: str, identity: Identity = ONBOARD_COMPUTER) -> None:
        super().__init__(recorded, name, identity)
        self._recorded = recorded

    @classmethod
    def playing(
        cls, path: Path, read_track: ReadTrack | None = None, identity: Identity = ONBOARD_COMPUTER
    ) -> ReplayedLink:
        """Open a recording; see `replayed_autopilot`."""
        return cls(replayed_autopilot(path, read_track), str(path), identity)

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message; see Link."""
        incoming = super().receive(timeout_s)
        if incoming is None and self._recorded.ended and not self.waiting:
            raise LinkLost(f"The recording {self.name} has ended.", "Play it again, or another one.")
        return incoming


def replayed_autopilot(
    path: Path, read_track: ReadTrack | None = None, alterations: Alterations | None = None
) -> ReplayedAutopilot:
    """Make the vehicle of a recording: a .tlog frame by frame, any other by its Track.

    Raises UsageError for a file that is not there, BadRecording where nothing can be played.
    """
    if path.suffix.lower() == ".tlog":
        contents = survey(path)
        return ReplayedAutopilot(play_tlog(path, contents), contents, alterations)
    if read_track is None:
        raise UsageError(f"{path} is no telemetry log.", "Replay it with `mavcompass replay`.")
    from mavcompass.vehicle.replay.track_messages import track_contents, track_messages

    track = read_track(path)
    return ReplayedAutopilot(track_messages(track), track_contents(track), alterations)


def play_tlog(path: Path, contents: Contents) -> Iterator[SaidMessage]:
    """Hand out the frames of a .tlog with times from its start."""
    clock = RecordingClock()
    for stamp_s, frame in tlog_frames(path):
        time_s = clock.advance(stamp_s)
        message = decode(frame.message_id, frame.payload)
        if (frame.system, frame.component) in contents.stations and not isinstance(message, Heartbeat):
            continue  # what a ground station asked then is not what it asks now
        yield SaidMessage(time_s, frame.system, frame.component, message, frame=frame)
