"""What a fit leaves: the floor where nothing is wrong, and tests whether the rest is chance."""

from mavcompass.gap.left.adequacy import Adequacy, judge
from mavcompass.gap.left.doubtful import doubting
from mavcompass.gap.left.floor import (
    Floor,
    apart,
    foreseen,
    from_recording,
    heading_error_rad,
    heading_scatter,
    kind_of,
    measured_noise,
    rms,
    rms_deg,
    widened,
    with_noise,
)
from mavcompass.gap.left.scatter import (
    Scatter,
    find_scatter,
    noise_with,
)
from mavcompass.gap.left.taught import DISCREPANCY_MGAUSS, from_baseline

__all__ = [
    "DISCREPANCY_MGAUSS",
    "Adequacy",
    "Floor",
    "Scatter",
    "apart",
    "doubting",
    "find_scatter",
    "foreseen",
    "from_baseline",
    "from_recording",
    "heading_error_rad",
    "heading_scatter",
    "judge",
    "kind_of",
    "measured_noise",
    "noise_with",
    "rms",
    "rms_deg",
    "widened",
    "with_noise",
]
