"""Signatures of MAVLink 2 frames (`mavlink.frame` says how they are laid out)."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.mavlink.frame import SIGNATURE_BYTES

_EPOCH_2015_S = 1_420_070_400
_HEXADECIMAL = re.compile("[0-9a-fA-F]{64}")
_WHAT_A_KEY_IS = (
    "Give a file with one line: 64 hexadecimal digits, or the passphrase behind the vehicle's key."
)


def unix_time_s() -> float:
    """Return the wall clock, for signatures only."""
    return time.time()


@dataclass(slots=True)
class Signing:
    """Sign what is sent and check what is heard with a 32-byte key shared with the vehicle.

    Raises ValueError for a key of another length.
    """

    key: bytes
    link_id: int = 0
    clock: Callable[[], float] = unix_time_s
    _last_sent: int = 0
    _last_heard: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.key) != 32:
            raise ValueError(f"a MAVLink signing key has 32 bytes, not {len(self.key)}")

    @classmethod
    def from_passphrase(cls, passphrase: str) -> Signing:
        """Make the key as the common ground stations do: SHA-256 of the passphrase."""
        return cls(hashlib.sha256(passphrase.encode()).digest())

    @classmethod
    def of_file(cls, path: Path) -> Signing:
        """Read the key from a file: 64 hexadecimal digits, or the passphrase. Raises UsageError."""
        try:
            text = path.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"The signing key {path} cannot be read ({error}).", _WHAT_A_KEY_IS) from error
        if not text or "\n" in text:
            raise UsageError(f"{path} holds no signing key.", _WHAT_A_KEY_IS)
        return cls(bytes.fromhex(text)) if _HEXADECIMAL.fullmatch(text) else cls.from_passphrase(text)

    def sign(self, frame: bytes) -> bytes:
        """Return the 13 bytes to append; each is later than the last."""
        stamp = max(int((self.clock() - _EPOCH_2015_S) * 1e5), self._last_sent + 1)
        self._last_sent = stamp
        head = bytes((self.link_id,)) + stamp.to_bytes(6, "little")
        return head + self._digest(frame, head)

    def accepts(self, frame: bytes, system: int, component: int) -> bool:
        """Check a signed frame: the right key, and later than any before from this sender and link."""
        signature = frame[-SIGNATURE_BYTES:]
        if self._digest(frame[:-SIGNATURE_BYTES], signature[:7]) != signature[7:]:
            return False
        stamp = int.from_bytes(signature[1:7], "little")
        stream = (system, component, signature[0])
        if stamp <= self._last_heard.get(stream, -1):
            return False
        self._last_heard[stream] = stamp
        return True

    def _digest(self, frame: bytes, head: bytes) -> bytes:
        return hashlib.sha256(self.key + frame + head).digest()[:6]
