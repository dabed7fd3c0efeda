"""A recording beside its nominal simulation: rows, field, iron, noise, and what is solved for besides."""

from mavcompass.gap.replay.in_force import (
    ANOTHER_IRON,
    IRON_MATRIX,
    IRON_OFFSET,
    STATED,
    Trust,
    calibration_in_force,
    known_iron,
)
from mavcompass.gap.replay.integrity import Readings
from mavcompass.gap.replay.noise import (
    USUAL_SCATTER_MGAUSS,
    WORST_SCATTER_MGAUSS,
    Noise,
    SensorNoise,
    estimate_noise,
    group_values,
    rough_sigma,
    wandering,
    white,
)
from mavcompass.gap.replay.nominal import Replay, level_mgauss, replay
from mavcompass.gap.replay.nuisance import (
    REFERENCE_YAW,
    TELEMETRY_AGE,
    WORLD_FIELD,
    Nuisance,
    Prior,
    block_diagonal,
    turned,
    yaw_starts,
)
from mavcompass.gap.replay.rows import averaged, compass_rows, shared_period_s
from mavcompass.gap.replay.testable import half_testable, untestable_effects

__all__ = [
    "ANOTHER_IRON",
    "IRON_MATRIX",
    "IRON_OFFSET",
    "REFERENCE_YAW",
    "STATED",
    "TELEMETRY_AGE",
    "USUAL_SCATTER_MGAUSS",
    "WORLD_FIELD",
    "WORST_SCATTER_MGAUSS",
    "Noise",
    "Nuisance",
    "Prior",
    "Readings",
    "Replay",
    "SensorNoise",
    "Trust",
    "averaged",
    "block_diagonal",
    "calibration_in_force",
    "compass_rows",
    "estimate_noise",
    "group_values",
    "half_testable",
    "known_iron",
    "level_mgauss",
    "replay",
    "rough_sigma",
    "shared_period_s",
    "turned",
    "untestable_effects",
    "wandering",
    "white",
    "yaw_starts",
]
