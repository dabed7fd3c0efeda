"""ArduPilot's own compass calibration: 300 readings all over the sphere, thinned, filled up again, fitted.

A turn on the level yields at most 57 readings that are 6.3 degrees apart, so it never ends by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavcompass.correction import FieldCorrection, Vector
from mavcompass.enums import MagCalStatus
from mavcompass.messages import MagCalProgress, MagCalReport
from mavcompass.simulation.autopilot.compasses import TurnedReadings

_SAMPLES, _SPACING_RAD = 300, math.radians(6.3)
_RADIUS_AT_FIRST, _RADIUS = 200.0, (150.0, 950.0)
_SCALE, _MOST_OFFSET = (1.0 / 1.5, 1.5), 1800.0
_FIT_MGAUSS = 16.0  # COMPASS_CAL_FIT; twice for all but the first


@dataclass(slots=True)
class _Compass:
    """Hold how far one compass's calibration is."""

    instance: int
    expected_mgauss: float
    status: MagCalStatus = MagCalStatus.RUNNING_STEP_ONE
    turned: TurnedReadings = field(default_factory=TurnedReadings)
    radius: float = _RADIUS_AT_FIRST
    thinned_to: int = 0
    found: FieldCorrection = field(default_factory=FieldCorrection)
    fitness: float = 0.0

    @property
    def running(self) -> bool:
        return self.status in (MagCalStatus.RUNNING_STEP_ONE, MagCalStatus.RUNNING_STEP_TWO)

    @property
    def apart(self) -> float:
        return self.radius * 2.0 * math.sin(0.5 * _SPACING_RAD)

    def observe(self, raw: Vector) -> None:
        if not self.running or not self.turned.take(raw, self.apart) or len(self.turned) < _SAMPLES:
            return
        if self.status is MagCalStatus.RUNNING_STEP_ONE:
            _, self.radius = self.turned.centre()
            self.turned.thin(self.apart)
            self.thinned_to, self.status = len(self.turned), MagCalStatus.RUNNING_STEP_TWO
        else:
            self.status = self._fitted()

    def _fitted(self) -> MagCalStatus:
        fit = self.turned.fit()
        if fit is None:
            return MagCalStatus.FAILED
        unit, radius, self.fitness = fit
        scale = self.expected_mgauss / radius
        self.found = FieldCorrection.from_matrix(unit.offsets_mgauss, scale * unit.matrix, scale)
        sound = max(map(abs, unit.offsets_mgauss)) < _MOST_OFFSET and _RADIUS[0] < radius < _RADIUS[1]
        if not sound or self.fitness > _FIT_MGAUSS * (1 if self.instance == 1 else 2):
            return MagCalStatus.FAILED
        return MagCalStatus.SUCCESS if _SCALE[0] <= scale <= _SCALE[1] else MagCalStatus.BAD_RADIUS

    def percent(self) -> float:
        if self.status is MagCalStatus.RUNNING_STEP_ONE:
            return 33.3 * len(self.turned) / _SAMPLES
        return 33.3 + 65.7 * (len(self.turned) - self.thinned_to) / max(_SAMPLES - self.thinned_to, 1)


class MagnetometerCalibration:
    """Hold the state of DO_START_MAG_CAL."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all, as a power-up does."""
        self.reboot_wanted = False
        self._compasses: dict[int, _Compass] = {}

    @property
    def running(self) -> bool:
        """Tell whether a compass is being calibrated."""
        return any(compass.running for compass in self._compasses.values())

    def start(self, instances: tuple[int, ...], expected_mgauss: float) -> None:
        """Begin to collect; from now on a reboot is wanted before it arms, however this ends."""
        self.reboot_wanted = True
        self._compasses |= {i: _Compass(i, expected_mgauss) for i in instances}

    def cancel(self) -> None:
        """Stop, and forget what was found."""
        self._compasses.clear()

    def observe(self, raw: Mapping[int, Vector]) -> None:
        """Take new readings by compass, in body axes, before any correction."""
        for instance, compass in self._compasses.items():
            compass.observe(raw[instance])

    def accept(self) -> dict[int, FieldCorrection] | None:
        """Return what is to be stored, and end; None where a compass has not succeeded."""
        compasses = list(self._compasses.values())
        self._compasses.clear()
        if any(compass.status is not MagCalStatus.SUCCESS for compass in compasses):
            return None
        return {compass.instance: compass.found for compass in compasses}

    def reports(self) -> list[MagCalProgress | MagCalReport]:
        """Report the progress of each compass, or what came of it."""
        mask = sum(1 << i - 1 for i in self._compasses)
        return [_report(compass, mask) for compass in self._compasses.values()]


def _report(compass: _Compass, mask: int) -> MagCalProgress | MagCalReport:
    if compass.running:
        known = compass.status is MagCalStatus.RUNNING_STEP_TWO
        centre = compass.turned.centre()[0] if known else np.zeros(3)
        return MagCalProgress(
            compass_id=compass.instance - 1,
            cal_mask=mask,
            cal_status=compass.status,
            attempt=1,
            completion_pct=int(compass.percent()),
            completion_mask=tuple(compass.turned.sections(centre).to_bytes(10, "little")),
        )
    found = compass.found
    return MagCalReport(
        compass.instance - 1,
        mask,
        compass.status,
        0,
        compass.fitness,
        *found.offsets_mgauss,
        *found.diagonals,
        *found.off_diagonals,
        scale_factor=found.scale,
    )
