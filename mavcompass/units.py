"""The units used inside, and the factors at the boundaries.

Inside: milligauss, metres per second squared, radians, radians per second, seconds, body axes
FRD (forward, right, down), world axes NED (north, east, down).
"""

from __future__ import annotations

import math

STANDARD_GRAVITY_MPS2 = 9.80665
MGAUSS_PER_GAUSS = 1000.0
NANOTESLA_PER_MGAUSS = 100.0

RAD_PER_DEG = math.pi / 180.0
DEG_PER_RAD = 180.0 / math.pi

# MAVLink's RAW_IMU and SCALED_IMU carry thousandths of a standard gravity and of a radian per second.
MPS2_PER_MILLI_G = STANDARD_GRAVITY_MPS2 / 1000.0
RADPS_PER_MILLIRADPS = 1.0e-3
