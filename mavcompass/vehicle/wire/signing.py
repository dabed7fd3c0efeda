"""Signatures of MAVLink 2 frames (`mavlink.frame` says how they are laid out)."""

from __future__ import annotations

import hashlib
import json
import logging
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.files import read_text
from mavcompass.installation.private_files import locked, private_folder, state_directory, write_private
from mavcompass.messages.message import SIGNATURE_BYTES

_EPOCH_2015_S = 1_420_070_400
_TICKS_PER_S = 100_000
# MAVLink 2, "Message signing": a stream that is more than a minute behind is not believed.
_MINUTE = 60 * _TICKS_PER_S
# The disk is written to once in so long; after a kill, messages of so long are not believed.
_AHEAD = 2 * _TICKS_PER_S
_HEXADECIMAL = re.compile("[0-9a-fA-F]{64}")
_WHAT_A_KEY_IS = (
    "Give a file with one line: 64 hexadecimal digits, or the passphrase behind the vehicle's key."
)


Stream = tuple[int, int, int]  # system, component, link id
_OURS: Stream = (0, 0, 0)  # nobody sends as system 0
_log = logging.getLogger(__name__)


def unix_time_s() -> float:
    """Return the wall clock, for signatures only."""
    return time.time()


@dataclass(slots=True)
class Signing:
    """Sign what is sent and check what is heard with a 32-byte key shared with the vehicle.

    Attributes:
        memory: the file that keeps the time stamps over a restart; None: they are forgotten at the end.

    Raises ValueError for a key of another length.
    """

    key: bytes
    link_id: int = 0
    clock: Callable[[], float] = unix_time_s
    memory: Path | None = None
    _newest: int = 0
    _last_heard: dict[Stream, int] = field(default_factory=dict)
    # What the file holds, ahead of what was heard: so far it need not be written again.
    _kept: dict[Stream, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.key) != 32:
            raise ValueError(f"a MAVLink signing key has 32 bytes, not {len(self.key)}")
        if self.memory is not None:
            self._newest, self._last_heard = _recall(self.memory)

    @classmethod
    def from_passphrase(cls, passphrase: str) -> Signing:
        """Make the key as the common ground stations do: SHA-256 of the passphrase."""
        return cls(hashlib.sha256(passphrase.encode()).digest())

    @classmethod
    def of_file(cls, path: Path) -> Signing:
        """Read the key from a file: 64 hexadecimal digits, or the passphrase; keep its time stamps on disk.

        Raises UsageError for a file that holds none, and where the time stamps cannot be kept.
        """
        try:
            text = read_text(path).strip()
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"The signing key {path} cannot be read ({error}).", _WHAT_A_KEY_IS) from error
        if not text or "\n" in text:
            raise UsageError(f"{path} holds no signing key.", _WHAT_A_KEY_IS)
        key = bytes.fromhex(text) if _HEXADECIMAL.fullmatch(text) else cls.from_passphrase(text).key
        folder = state_directory() / "signing"
        signing = cls(key, memory=folder / f"{hashlib.sha256(key).hexdigest()[:16]}.json")
        try:
            private_folder(folder)
            signing.keep()
        except OSError as error:
            raise UsageError(
                f"The time stamps of signed messages cannot be kept in {folder} ({error.strerror}): after a"
                " restart old ones could be played again.",
                "Make room there, or name another folder in XDG_STATE_HOME.",
            ) from error
        return signing

    def sign(self, frame: bytes) -> bytes:
        """Return the 13 bytes to append; each is later than the last, and than all that was heard."""
        self._newest = stamp = max(self._now(), self._newest + 1)
        self._keep_ahead(_OURS, stamp)
        head = bytes((self.link_id,)) + stamp.to_bytes(6, "little")
        return head + self._digest(frame, head)

    def accepts(self, frame: bytes, system: int, component: int) -> bool:
        """Check a signed frame: the right key, later than any before from this sender and link, not stale.

        Stale is what is more than a minute behind the newest stamp of all, or this computer's clock.
        """
        signature = frame[-SIGNATURE_BYTES:]
        if self._digest(frame[:-SIGNATURE_BYTES], signature[:7]) != signature[7:]:
            return False
        stamp = int.from_bytes(signature[1:7], "little")
        stream = (system, component, signature[0])
        stale = max(self._now(), self._newest) - _MINUTE
        if stamp <= self._last_heard.get(stream, -1) or stamp < stale:
            return False
        self._last_heard[stream], self._newest = stamp, max(self._newest, stamp)
        self._keep_ahead(stream, stamp)
        return True

    def keep(self, ahead: int = 0) -> None:
        """Write the time stamps to the disk, so much ahead; another process's stay. Raises OSError."""
        if self.memory is None:
            return
        mine = {stream: stamp + ahead for stream, stamp in self._last_heard.items()}
        mine[_OURS] = self._newest + ahead
        with locked(self.memory.parent):
            newest, known = _recall(self.memory)
            known[_OURS] = newest
            theirs = {stream: stamp for stream, stamp in known.items() if stamp > self._kept.get(stream, -1)}
            for stream, stamp in theirs.items():
                mine[stream] = max(stamp, mine.get(stream, -1))
            newest = mine.pop(_OURS)
            # What is stale is refused without being remembered.
            streams = {"/".join(map(str, s)): stamp for s, stamp in mine.items() if stamp >= newest - _MINUTE}
            write_private(self.memory, json.dumps({"newest": newest, "streams": streams}), flushed=False)
        self._kept = {**mine, _OURS: newest}

    def _keep_ahead(self, stream: Stream, stamp: int) -> None:
        """See that a restart, however it comes, does not go behind this stamp."""
        if self.memory is not None and stamp > self._kept.get(stream, -1):
            try:
                self.keep(_AHEAD)
            except OSError as error:
                self._kept[stream] = stamp + _AHEAD
                _log.warning("the time stamps of signed messages could not be kept (%s)", error)

    def _now(self) -> int:
        return max(int((self.clock() - _EPOCH_2015_S) * _TICKS_PER_S), 0)

    def _digest(self, frame: bytes, head: bytes) -> bytes:
        return hashlib.sha256(self.key + frame + head).digest()[:6]


def _recall(memory: Path) -> tuple[int, dict[Stream, int]]:
    """Read what `Signing.keep` wrote; nothing where there is none, or it is damaged."""
    try:
        document = json.loads(memory.read_text(encoding="utf-8"))
        known = {}
        for name, stamp in document["streams"].items():
            system, component, link = map(int, name.split("/"))
            known[system, component, link] = int(stamp)
        return int(document["newest"]), known
    except FileNotFoundError:
        return 0, {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        _log.warning(
            "%s cannot be read (%s): stamps are judged by this computer's clock alone", memory, error
        )
        return 0, {}
