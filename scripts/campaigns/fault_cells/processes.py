"""A real program on a real port, killed by the system at a step that the vehicle sees."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from campaign import borrow

from fault_cells.scene import COMPASS, Scene
from fault_cells.works import prepare_write
from mavcompass.messages import Message, ParamRequestRead, ParamSet
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.parameters.values import same_value

borrow("")
from serving import serving  # noqa: E402

_LONGEST_S = 60.0
_SPEED = 10.0


class Victim:
    """Be a vehicle that has whoever talks to it killed when it hears the n-th message of a kind."""

    def __init__(self, vehicle: SimulatedAutopilot, kind: type[Message], number: int) -> None:
        self.vehicle, self.kind, self.left = vehicle, kind, number
        self.program: subprocess.Popen[str] | None = None

    @property
    def time_s(self) -> float:
        """Return the vehicle's time."""
        return self.vehicle.time_s

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Hear a message, and kill."""
        if isinstance(message, self.kind) and self.program is not None:
            self.left -= 1
            if not self.left:
                self.program.send_signal(signal.SIGKILL)
        self.vehicle.receive(message, system, component, port)

    def advance(self, until_s: float) -> Sequence[Outgoing]:
        """Live on."""
        return self.vehicle.advance(until_s)


def killed_process(number: int) -> list[str]:
    """Kill `params write` at its n-th write, after the sixth in the proof, and judge what is left."""
    kind, nth = (ParamSet, number) if number <= 6 else (ParamRequestRead, 70 + number)
    vehicle = SimulatedAutopilot("rover", seed=3)
    victim = Victim(vehicle, kind, nth)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare_write(Scene(vehicle, folder))
        before = _compass(vehicle)
        with serving(victim, speed=_SPEED) as (_, port):
            words = ("params", "write", f"tcp:127.0.0.1:{port}", str(folder / "wanted.param"), "--yes")
            victim.program = first = _started(folder, *words)
            said = "".join(first.communicate(timeout=_LONGEST_S))
            victim.program = None
            if first.returncode != -signal.SIGKILL:
                return [f"was not killed but ended with {first.returncode}: {said}"]
            after = _compass(vehicle)
            if all(same_value(after[n], v) for n, v in before.items()):
                return []
            return _restored(folder, said, before, vehicle)


def _restored(folder: Path, said: str, before: dict[str, float], vehicle: SimulatedAutopilot) -> list[str]:
    """Type the command that the killed program had told."""
    sentence = re.search(r"params restore \S+ \S+\.json", said)
    if sentence is None:
        return [f"killed with new values written, and had told no way back: {said!r}"]
    second = _started(folder, *shlex.split(sentence[0]), "--yes")
    answer = "".join(second.communicate(timeout=_LONGEST_S))
    now = _compass(vehicle)
    left = [name for name, value in before.items() if not same_value(now[name], value)]
    wrong = [f"the way back leaves {', '.join(left)}: {answer}"] if left else []
    return wrong + (["a traceback"] if "Traceback" in said + answer else [])


def _started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "mavcompass", *arguments],
        env={**os.environ, "MAVCOMPASS_UNDO_DIR": str(folder / "undo")},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _compass(vehicle: SimulatedAutopilot) -> dict[str, float]:
    held = vehicle.firmware.store.values
    return {name: value for name, value in held.items() if name.startswith(COMPASS)}
