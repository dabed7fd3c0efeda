"""The sets of sources of ArduPilot's estimator (EK3_SRCn_*): which one is in use, and what a switch does."""

from __future__ import annotations

import math

from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.parameters import ParameterStore

_SETS = (1, 2, 3)
_COMPASS, _COMPASS_AS_FALLBACK = 1.0, 3.0
_HEADING_ONLY = 2.0  # EK3_MAG_CAL
_SUREST_READING = 0.2  # of what is shipped; less is not taken of a field's, nor ever set of a heading's


class Sources:
    """Choose a set of sources; the choice is forgotten at a restart.

    Seen on ArduPilot 4.5.7: when the compass becomes the source of yaw, its yaw is taken over at once; a
    flying copter goes back within a second to what its filter has learnt of the field.

    Attributes:
        compasses_aside: the filter follows no compass until the next start, whatever its sources are.
    """

    def __init__(self, board: Board, store: ParameterStore) -> None:
        self._board = board
        self._store = store
        self.boot()

    def boot(self) -> None:
        """Use the first set."""
        self.number = 1
        self.compasses_aside = False
        self._followed = True

    def use(self, number: int) -> bool:
        """Use another set; False where there is no such set."""
        if number not in _SETS:
            return False
        self.number = number
        return True

    def correct(self, dt_s: float, compass_yaw_rad: float | None) -> None:
        """Let the filter follow the compass, where that is its source of yaw."""
        # A submarine does not climb, which is what the filter begins to learn the field at (EK3_MAG_CAL 3).
        estimate = self._board.filter
        flying = self._board.profile.chassis == "copter" and not self._board.body.landed
        named = self._store.get(f"EK3_SRC{self.number}_YAW", 1.0) in (_COMPASS, _COMPASS_AS_FALLBACK)
        follows = named and not self.compasses_aside
        if follows and not self._followed and compass_yaw_rad is not None and not flying:
            estimate.take_yaw(compass_yaw_rad)
        learns = flying and self._store["EK3_MAG_CAL"] != _HEADING_ONLY
        within_rad = self._learns_within_rad() if learns else 0.0
        noises = self._noises("EK3_MAG_M_NSE" if learns else "EK3_YAW_M_NSE")
        estimate.correct(dt_s, compass_yaw_rad if follows else None, within_rad, *noises)
        self._followed = follows

    def _learns_within_rad(self) -> float:
        """Return how far the direction of the field may be learnt to be off the world model's."""
        return math.asin(min(1.0, self._store["EK3_MAG_EF_LIM"] / self._board.world.horizontal_mgauss))

    def _noises(self, reading: str) -> tuple[float, float]:
        """Return how much surer a reading counts than as shipped, and how much more the bias may wander."""
        store = self._store
        less, more = (store[name] / store.factory_value(name) for name in (reading, "EK3_GBIAS_P_NSE"))
        return 1.0 / max(less, _SUREST_READING), more
