"""What a compass shows while its vehicle stands: a field that changes then, was changed by somebody."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from mavcompass.heading.live import Heading

# So much of a turn is taken out as the gyro tells it; after more, what was before is forgotten.
_NUDGED_RAD = math.radians(30.0)
# Seconds over which now is averaged, and before, which follows what goes as slowly as a hull swings.
_NOW_S, _BEFORE_S = 3.0, 5.0
# A change by this share of the limit is not followed.
_FOLLOWED = 0.5


@dataclass(slots=True)
class FieldStep:
    """Compare a compass's field with what it was before, while the vehicle is disarmed and stands.

    A battery, a payload or a tool changes it at once; that somebody nudges the vehicle round is taken out.

    Attributes:
        off_deg: how far the change bends a heading; it stays when the vehicle is armed, until it turns.
    """

    off_deg: float = 0.0
    _before: tuple[complex, float] | None = None  # forward + i right, down
    _now: tuple[complex, float] = (0j, 0.0)
    _stood_s: float = 0.0
    _turned_rad: float = 0.0

    def add(
        self,
        heading: Heading,
        rate_radps: float,
        bias_radps: float,
        stands: bool,
        step_s: float,
        limit_deg: float,
    ) -> None:
        """Take the next reading, `step_s` seconds after the last; a hull that swings passes for a bias."""
        self._turned_rad += rate_radps * step_s
        if not stands:
            self._stood_s = 0.0
            if abs(self._turned_rad) > _NUDGED_RAD:
                self.off_deg, self._before, self._turned_rad = 0.0, None, 0.0
            return
        forward, right, down = heading.level_mgauss
        self._stood_s += step_s
        self._now = _nearer(self._now, (complex(forward, right), down), step_s / min(self._stood_s, _NOW_S))
        if self._stood_s < _NOW_S:
            return
        if self._before is None:
            self._before, self._turned_rad = self._now, 0.0
        # In the axes of what turns the Earth's field turns the other way.
        before = (self._before[0] * cmath.exp(-1j * self._turned_rad), self._before[1])
        apart_rad, hidden_rad = (
            cmath.phase(self._now[0] * before[0].conjugate()),
            abs(bias_radps) * (_NOW_S + _BEFORE_S),
        )
        swung = before[0] * cmath.exp(1j * min(max(apart_rad, -hidden_rad), hidden_rad))
        change = math.hypot(abs(self._now[0] - swung), self._now[1] - before[1])
        self.off_deg = math.degrees(math.atan2(change, heading.horizontal_mgauss))
        follow = step_s / _BEFORE_S if self.off_deg < _FOLLOWED * limit_deg else 0.0
        self._before, self._turned_rad = _nearer(before, self._now, follow), 0.0


def _nearer(mean: tuple[complex, float], new: tuple[complex, float], share: float) -> tuple[complex, float]:
    share = min(share, 1.0)
    return mean[0] + share * (new[0] - mean[0]), mean[1] + share * (new[1] - mean[1])
