"""Play signed frames again: late, in another order, on other links, after restarts; none is believed.

    .venv/bin/python scripts/campaigns/replayed_signatures.py --frames 10000

Several senders sign on several links. Some of what they say never arrives. Somebody who heard all of it plays
frames again that are no newer than what was believed of their sender, or stale, as they are or with another
link id, while the program is stopped, killed and started again, and its clock set back.
"""

from __future__ import annotations

import random
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from campaign import ended, folder, options, share

from mavcompass.messages import Attitude
from mavcompass.messages.message import SIGNATURE_BYTES
from mavcompass.vehicle.wire.framing import FrameWriter, split_frame
from mavcompass.vehicle.wire.signing import Signing

KEY = bytes(range(32))
BEGAN_S = 1_780_000_000.0
STREAMS = ((1, 1, 0), (1, 1, 1), (1, 191, 0), (2, 1, 0), (255, 190, 3))
_LINK_AT = -SIGNATURE_BYTES
Stream = tuple[int, int, int]


@dataclass
class Siege:
    """Be one long attack on one program, which keeps its stamps in a file.

    Attributes:
        believed: attacks by kind that were believed; the last stamp of each stream that was.
    """

    chance: random.Random
    memory: Path
    now_s: float = BEGAN_S
    clock_off_s: float = 0.0
    heard: list[tuple[Stream, int, bytes]] = field(default_factory=list)
    last: dict[Stream, int] = field(default_factory=dict)
    newest: int = 0
    played: Counter[str] = field(default_factory=Counter)
    believed: list[str] = field(default_factory=list)
    genuine: Counter[bool] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.senders = {
            stream: FrameWriter(signing=Signing(KEY, stream[2], clock=lambda: self.now_s))
            for stream in STREAMS
        }
        self.start()

    def start(self) -> None:
        """Start the program: what it knows is what is on the disk."""
        self.ear = Signing(KEY, clock=lambda: self.now_s + self.clock_off_s, memory=self.memory)

    def run(self, frames: int) -> None:
        """Let senders speak and play frames until so many were played."""
        while sum(self.played.values()) < frames:
            self.now_s += self.chance.expovariate(10.0)
            self._speak(self.chance.choice(STREAMS))
            for _ in range(self.chance.randint(0, 4)):
                self._attack()
            if self.chance.random() < 0.01:
                self._restart()

    def _speak(self, stream: Stream) -> None:
        raw = self.senders[stream].write(Attitude(roll=self.chance.random()), *stream[:2])
        stamp = int.from_bytes(raw[_LINK_AT + 1 : _LINK_AT + 7], "little")
        self.heard.append((stream, stamp, raw))
        out_of_reach = stream in STREAMS[3:] and self.now_s < BEGAN_S + 200.0
        if out_of_reach or self.chance.random() < 0.2:
            return  # it never arrives
        accepted = self._hears(raw)
        self.genuine[accepted] += 1
        if accepted:
            self.last[stream] = max(stamp, self.last.get(stream, -1))
            self.newest = max(stamp, self.newest)

    def _attack(self) -> None:
        span = self.chance.choice((10, 200, len(self.heard)))
        stream, stamp, raw = self.chance.choice(self.heard[-span:])
        kind = "stale" if stamp < self.newest - 60 * 100_000 else "played again"
        if kind == "played again" and stamp > self.last.get(stream, -1):
            kind = ""  # it is only late: nothing newer of its stream was believed
        if not kind or self.chance.random() < 0.3:
            other = self.chance.choice([link for link in range(256) if link != raw[_LINK_AT]])
            raw = b"".join((raw[:_LINK_AT], bytes((other,)), raw[_LINK_AT + 1 :]))
            kind = "another link"
        self.played[kind] += 1
        if self._hears(raw):
            self.believed.append(f"{kind}: {stream} at {stamp}")

    def _hears(self, raw: bytes) -> bool:
        frame = split_frame(raw)
        return self.ear.accepts(raw, frame.system, frame.component)

    def _restart(self) -> None:
        kind = self.chance.choice(("stopped", "killed", "killed"))
        if kind == "stopped":
            self.ear.keep()
        self.now_s += self.chance.choice((0.0, 0.5, 5.0, 90.0))
        self.clock_off_s = self.chance.choice((0.0, 0.0, -30.0, -3600.0, -1e9))
        self.start()


def main(words: list[str] | None = None) -> int:
    """Lay siege."""
    wanted = options(__doc__, words, frames=10_000, seed=1)
    with folder() as place:
        siege = Siege(random.Random(wanted.seed), place / "stamps.json")
        siege.run(wanted.frames)
    for sentence in siege.believed[:20]:
        print(sentence)
    kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(siege.played.items()))
    genuine = siege.genuine[True] / sum(siege.genuine.values())
    believed = share(len(siege.believed), sum(siege.played.values()))
    print(f"{believed} believed ({kinds}); of genuine ones {100.0 * genuine:.0f} %")
    return ended(wanted.json, siege.played, siege.believed or genuine < 0.5)


if __name__ == "__main__":
    sys.exit(main())
