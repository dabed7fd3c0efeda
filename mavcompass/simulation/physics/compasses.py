"""The compasses a simulated vehicle comes with: iron drawn by seed, under an old, wrong calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavcompass.correction import FieldCorrection, Vector
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.sensors import CompassModel

Calibration = Literal["old", "exact"]

# Noise per 100 Hz sample: an HMC5883L-class, an IST8310-class and a better compass.
_NOISE_MGAUSS = (2.5, 3.0, 1.5)


@dataclass(frozen=True, slots=True)
class CompassSetup:
    """Hold a compass and the calibration that is in force at the start."""

    model: CompassModel
    in_force: FieldCorrection


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _iron(rng: np.random.Generator, hard_mgauss: float) -> FieldCorrection:
    direction = rng.standard_normal(3)
    direction[2] *= 0.6
    offsets = hard_mgauss * direction / math.hypot(*direction)
    return FieldCorrection(
        offsets_mgauss=_vector(offsets),
        diagonals=_vector(1.0 + rng.uniform(-0.08, 0.08, 3) * (1.0, 1.0, 0.4)),
        off_diagonals=_vector(rng.uniform(-0.03, 0.03, 3) * (1.0, 0.5, 0.5)),
    )


def draw_compasses(seed: int, horizontal_mgauss: float, calibration: Calibration) -> tuple[CompassSetup, ...]:
    """Draw three compasses.

    The first has been calibrated once, before something of iron was moved: its calibration is wrong
    by 0.5 to 0.75 of the horizontal field, which bends headings by 20 to 30 degrees rms. The other
    two are calibrated as well as people do (a few degrees). "exact" sets all three exactly right.
    """
    setups = []
    for index, noise in enumerate(_NOISE_MGAUSS):
        rng = generator(seed, f"iron {index + 1}")
        iron = _iron(rng, hard_mgauss=rng.uniform(60.0, 240.0))
        in_force = iron
        if calibration == "old":
            wrong = rng.uniform(0.5, 0.75) if index == 0 else rng.uniform(0.02, 0.06)
            heading = rng.uniform(0.0, 2.0 * math.pi)
            moved = wrong * horizontal_mgauss * np.array([math.cos(heading), math.sin(heading), 0.0])
            moved[2] = rng.uniform(-40.0, 40.0) * (1.0 if index == 0 else 0.2)
            in_force = replace(iron, offsets_mgauss=_vector(np.add(iron.offsets_mgauss, moved)))
            if index == 0:
                in_force = replace(in_force, diagonals=(1.0, 1.0, 1.0), off_diagonals=(0.0, 0.0, 0.0))
        setups.append(CompassSetup(CompassModel(iron, noise), in_force))
    return tuple(setups)
