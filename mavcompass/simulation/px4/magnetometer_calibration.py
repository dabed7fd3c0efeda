"""PX4's own compass calibration: six sides, each held still and then turned round, told by texts alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from mavcompass.correction import FieldCorrection, Vector
from mavcompass.enums import MavSeverity
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.compasses import TurnedReadings
from mavcompass.units import MGAUSS_PER_GAUSS, STANDARD_GRAVITY_MPS2

# Each side by the specific force that it shows, in the order in which they are asked for.
_SIDES: dict[str, tuple[int, int]] = {
    "back": (0, 1),
    "front": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "up": (2, 1),
    "down": (2, -1),
}
_POINTS, _SIDE_S = 40, 7.0
_STILL_S, _STILL_RADPS, _ALONG = 0.5, math.radians(3.0), 0.5
_PATIENCE_S, _MOST_FAILURES = 20.0, 4
_TURNING_RAD = 0.5
_RADIUS_GAUSS = (0.2, 0.7)


class MagnetometerCalibration:
    """Hold the state of PREFLIGHT_CALIBRATION with p2 = 1."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self.state: Literal["off", "still", "turn", "collect"] = "off"
        self._waited_s = self._still_s = 0.0
        self._rotated = [0.0, 0.0, 0.0]
        self._side, self._points = "", 0

    @property
    def running(self) -> bool:
        """Tell whether it is under way."""
        return self.state != "off"

    def start(self, compasses: int) -> None:
        """Begin, with no side done."""
        self._turned = [TurnedReadings() for _ in range(compasses)]
        self._pending, self._failures = list(_SIDES), 0
        self._say("calibration started: 2 mag")
        self._ask()

    def cancel(self) -> None:
        """End it without a result."""
        if self.running:
            self._end("calibration cancelled")

    def observe(self, dt_s: float, raw_mgauss: Sequence[Vector]) -> list[FieldCorrection] | None:
        """Take new readings in the sensors' axes; returns what is to be stored when all sides are done."""
        if not self.running:
            return None
        sample = self._board.sensors.samples[0]
        self._waited_s += dt_s
        if self.state == "still":
            self._await_side(dt_s, sample.gyro_radps, sample.acc_mps2)
        elif self.state == "turn":
            self._rotated = [a + w * dt_s for a, w in zip(self._rotated, sample.gyro_radps, strict=True)]
            if max(map(abs, self._rotated)) > _TURNING_RAD:
                self.state, self._waited_s, self._points = "collect", 0.0, 0
            elif self._waited_s > 5.0 * _SIDE_S:
                self._say("Failed: This calibration requires rotation.", mark=False)
                self._end("calibration failed: mag")
        elif self._collect(raw_mgauss):
            return self._fitted()
        return None

    def _await_side(self, dt_s: float, rate: Vector, force: Vector) -> None:
        self._still_s = self._still_s + dt_s if math.hypot(*rate) < _STILL_RADPS else 0.0
        if self._waited_s > _PATIENCE_S:
            self._failures += 1
            self._say("detected motion, hold still...")
            if self._failures > _MOST_FAILURES:
                self._end("calibration failed: timeout: no motion")
            else:
                self._ask()
        if self._still_s < _STILL_S or not self.running:
            return
        g = STANDARD_GRAVITY_MPS2
        for side, (axis, sign) in _SIDES.items():
            if all(abs(f - (sign * g if k == axis else 0.0)) < _ALONG * g for k, f in enumerate(force)):
                self._take(side)
                return

    def _take(self, side: str) -> None:
        self._still_s = 0.0
        if side not in self._pending:
            if self._waited_s > 2.0:
                self._say(f"{side} side already completed")
                self._ask()
            return
        self._side, self.state, self._waited_s, self._rotated = side, "turn", 0.0, [0.0] * 3
        for _ in range(2):
            self._say(f"{side} orientation detected")
        self._say("Rotate vehicle")

    def _collect(self, raw: Sequence[Vector]) -> bool:
        """Collect on a side; True when it was the last."""
        apart = 5.4 * math.hypot(*self._board.world.field_ned_mgauss) / math.sqrt(6 * _POINTS) / 3.0
        if all([turned.take(r, apart) for turned, r in zip(self._turned, raw, strict=True)]):
            self._points += 1
            percent = int(100 * (6 - len(self._pending) + self._points / _POINTS) / 6)
            self._say(f"{self._side} side calibration: progress <{percent}>")
        if self._points < _POINTS and self._waited_s < _SIDE_S:
            return False
        self._pending.remove(self._side)
        for _ in range(2):
            self._say(f"{self._side} side done, rotate to a different side")
        if self._pending:
            self._ask()
        return not self._pending

    def _fitted(self) -> list[FieldCorrection] | None:
        """Return the fits, scaled to the Earth's field here."""
        found, total = [], math.hypot(*self._board.world.field_ned_mgauss)
        for place, turned in enumerate(self._turned):
            fit = turned.fit()
            radius = 0.0 if fit is None else fit[1] / MGAUSS_PER_GAUSS
            if fit is None or not _RADIUS_GAUSS[0] <= radius < _RADIUS_GAUSS[1]:
                self._say(f"Retry calibration (unable to fit mag {place})", mark=False)
                self._end("calibration failed: mag")
                return None
            scale = total / fit[1]
            found.append(FieldCorrection.from_matrix(fit[0].offsets_mgauss, scale * fit[0].matrix))
        self._say("progress <100>")
        self._end("calibration done: mag")
        return found

    def _ask(self) -> None:
        self.state, self._waited_s, self._still_s = "still", 0.0, 0.0
        self._say(f"pending: {' '.join(self._pending)}")
        self._say("hold vehicle still on a pending side")

    def _end(self, text: str) -> None:
        self.state = "off"
        self._say(text)

    def _say(self, text: str, mark: bool = True) -> None:
        self._board.say(f"[cal] {text}" if mark else text, MavSeverity.INFO if mark else MavSeverity.CRITICAL)
