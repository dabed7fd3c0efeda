"""Who takes part: one small file each with `solve`, and how each is run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]


class Refusal(Exception):
    """Say why a rival gives no correction: its own judgement, not a fault."""


@dataclass(frozen=True)
class Solution:
    """Hold a correction: field = matrix (reading + offset) + motor amperes; the heading's claimed sigma."""

    offset: F
    matrix: F = field(default_factory=lambda: np.eye(3))
    motor: F = field(default_factory=lambda: np.zeros(3))
    sigma_deg: float | None = None


@dataclass(frozen=True)
class Headings:
    """Hold magnetic headings at the compass's readings (M,), radians; what is claimed of them (M,)."""

    heading: F
    sigma: F | None = None


@dataclass(frozen=True)
class Named:
    """Hold what is said to be wrong: names, none for nothing; `sure` False where it says that it is not."""

    names: frozenset[str]
    sure: bool = True


@dataclass(frozen=True)
class Rival:
    """Say how a rival is run.

    Attributes:
        module: of this folder. argument: which of its methods.
        program: True for a rival's own program or package as released, False for its algorithm rebuilt here.
        task: calibration, heading or gap.
        own: True where it needs an environment of its own. every: of how many cases it is given one.
    """

    module: str
    argument: str = ""
    program: bool = True
    task: str = "calibration"
    own: bool = False
    every: int = 1


RIVALS = {
    "mavcompass": Rival("ours"),
    "ArduPilot onboard": Rival("firmware", "ardupilot", program=False),
    "PX4 onboard": Rival("firmware", "px4", program=False),
    "MAGFit (web)": Rival("fits", program=False),
    "pymavlink magfit_WMM": Rival("pymavlink_tools", "magfit_WMM.py", every=40),
    "pymavlink magfit": Rival("pymavlink_tools", "magfit.py", every=40),
    "magyc_ls": Rival("magyc_methods", "magyc_ls", own=True, every=8),
    "magyc_nls": Rival("magyc_methods", "magyc_nls", own=True, every=8),
    "TWOSTEP (magyc)": Rival("magyc_methods", "twostep_hsi", own=True),
    "Fang's ellipsoid (magyc)": Rival("magyc_methods", "ellipsoid_fit_fang", own=True),
    "sphere_fit (magyc)": Rival("magyc_methods", "sphere_fit", own=True),
    "ellipsoid, textbook": Rival("fits", "ellipsoid", program=False),
    "mavcompass heading": Rival("ours", "heading", task="heading"),
    "tilt by accelerometer": Rival("orientation", "accelerometer", task="heading", program=False),
    "VQF": Rival("orientation", "vqf", task="heading", own=True),
    "Madgwick (ahrs)": Rival("orientation", "Madgwick", task="heading", own=True),
    "Mahony (ahrs)": Rival("orientation", "Mahony", task="heading", own=True),
    "mavcompass gap": Rival("ours", "gap", task="gap"),
    "MAGFit's fits compared": Rival("fits", "gap", task="gap", program=False),
}
