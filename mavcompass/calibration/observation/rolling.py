"""Does what has wheels still roll? A position that begins while it brakes takes longer to be known.

Steered wheels that go straight may still roll: no gyro sees that, while a braking of 1 m/s^2 leans the
accelerometer's down by six degrees, alike at every stop. It is seen where it begins and ends: there the
specific force changes by more than the body's turning explains. What leans meanwhile `attitude` knows.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

WHEELED = frozenset({"rover", "ackermann-rover"})
# The mean forces of so long before and after a moment are compared.
_HALF_S = 0.25
# A change of this much leans the accelerometer by half a degree; what chance gives is no change.
_LEAST_STEP_MPS2, _CHANCE = 0.08, 5.0


class RollingWitness:
    """Tell live, reading by reading, whether a vehicle on wheels brakes or gathers way."""

    def __init__(self) -> None:
        self._felt: deque[tuple[float, ...]] = deque()  # time, force, angle turned

    def hear(self, time_s: float, gyro_radps: tuple[float, ...], acc_mps2: tuple[float, ...]) -> None:
        """Take the next reading, body axes."""
        angle = [0.0, 0.0, 0.0]
        if self._felt:
            before = self._felt[-1]
            lasted_s = time_s - before[0]
            angle = [a + lasted_s * rate for a, rate in zip(before[4:], gyro_radps, strict=True)]
        self._felt.append((time_s, *acc_mps2, *angle))
        while self._felt[0][0] < time_s - 2.0 * _HALF_S:
            self._felt.popleft()

    def rolls(self, noise_mps2: float) -> bool:
        """Tell whether the force of the last quarter of a second is another than that of the one before."""
        felt = np.array(self._felt)
        late = felt[:, 0] > felt[-1, 0] - _HALF_S
        if late.all() or not np.isfinite(felt).all():
            return False
        before, after = felt[~late].mean(axis=0), felt[late].mean(axis=0)
        turned = np.cross(after[4:] - before[4:], 0.5 * (before[1:4] + after[1:4]))
        step = float(np.linalg.norm(after[1:4] - before[1:4] + turned))
        chance = _CHANCE * noise_mps2 * math.sqrt(2.0 / min(late.sum(), (~late).sum()))
        return step > math.hypot(_LEAST_STEP_MPS2, chance)
