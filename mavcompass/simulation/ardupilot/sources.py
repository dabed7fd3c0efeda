"""The sets of sources of ArduPilot's estimator (EK3_SRCn_*): which one is in use, and what a switch does."""

from __future__ import annotations

from mavcompass.simulation.autopilot import Board, ParameterStore

_SETS = (1, 2, 3)
_COMPASS, _COMPASS_AS_FALLBACK = 1.0, 3.0


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
        estimate, flying = self._board.filter, self._board.profile.hovers and not self._board.body.landed
        named = self._store.get(f"EK3_SRC{self.number}_YAW", 1.0) in (_COMPASS, _COMPASS_AS_FALLBACK)
        follows = named and not self.compasses_aside
        if follows and not self._followed and compass_yaw_rad is not None and not flying:
            estimate.take_yaw(compass_yaw_rad)
        estimate.correct(dt_s, compass_yaw_rad if follows else None)
        self._followed = follows
