"""A recording as if the vehicle were there: what it said then, and answers to what it is asked now.

A .tlog is played frame by frame, as recorded. Of any other recording the Track is turned into messages
(`track_messages`). The replayed vehicle beats its heart, tells its parameters and answers commands as the
recording says; parameters written to it are kept for the session, although nothing moves for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mavcompass.errors import LinkLost
from mavcompass.messages import Heartbeat, Incoming, Message
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity
from mavcompass.vehicle.links.autopilot import Recorded, SaidMessage
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.replay.alterations import Alterations
from mavcompass.vehicle.replay.answers import Answers, Contents, survey
from mavcompass.vehicle.replay.tlog import RecordingClock, tlog_frames
from mavcompass.vehicle.wire import decode

# So long a first reading is waited for.
_WAITED_FOR_S = 3.0


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

    def receive(self, message: Message, system: int, component: int, port: int) -> None:
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
    def playing(cls, path: Path, identity: Identity = ONBOARD_COMPUTER) -> ReplayedLink:
        """Open a recording, at its first reading; see `replayed_autopilot`."""
        return cls(replayed_autopilot(path, at_readings=True), str(path), identity)

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message; see Link."""
        incoming = super().receive(timeout_s)
        if incoming is None and self._recorded.ended and not self.waiting:
            raise LinkLost(f"The recording {self.name} ended too soon.", "Give one with 30 s at rest.")
        return incoming


def replayed_autopilot(
    path: Path, alterations: Alterations | None = None, at_readings: bool = False
) -> ReplayedAutopilot:
    """Make the vehicle of a recording: a .tlog frame by frame, any other by its Track.

    Parameters that a .tlog lacks are told by the autopilot's own log beside it. `at_readings`: what was said
    more than some seconds before the first reading of a compass is said at once, as a live vehicle would.
    Raises UsageError for a file that is not there, BadRecording where nothing can be played.
    """
    from mavcompass.logs import read_track
    from mavcompass.logs.formats.tlog.companion import logs_beside
    from mavcompass.vehicle.replay.track_messages import track_contents, track_messages, track_parameters

    if path.suffix.lower() == ".tlog":
        contents = survey(path)
        if logs_beside(path):
            contents.parameters = track_parameters(read_track(path)) | contents.parameters
        skipped_s = contents.readings_from_s - _WAITED_FOR_S if at_readings else 0.0
        played = play_tlog(path, contents, max(skipped_s, 0.0))
        return ReplayedAutopilot(played, contents, alterations)
    track = read_track(path)
    return ReplayedAutopilot(track_messages(track), track_contents(track), alterations)


def play_tlog(path: Path, contents: Contents, from_s: float = 0.0) -> Iterator[SaidMessage]:
    """Hand out the frames of a .tlog with times from so long after its start; earlier ones at 0."""
    clock = RecordingClock()
    for stamp_s, frame in tlog_frames(path):
        time_s = max(clock.advance(stamp_s) - from_s, 0.0)
        message = decode(frame.message_id, frame.payload)
        if (frame.system, frame.component) in contents.stations and not isinstance(message, Heartbeat):
            continue  # what a ground station asked then is not what it asks now
        yield SaidMessage(time_s, frame.system, frame.component, message, frame=frame)
