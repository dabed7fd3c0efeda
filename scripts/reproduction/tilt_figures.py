"""[Li et al.] Fig. 4 and 5: the azimuth error of a tilted two-axis compass, and the bound for a wrong Z."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.earth_field import earth_field
from mavcompass.frames import wrap_pi
from mavcompass.heading.two_axis import (
    paper_azimuth,
    paper_two_axis_azimuth,
    vertical_error_bound_rad,
)

Array = NDArray[np.float64]
PAPER = {"largest error without compensation, deg": 22.0, "largest error with compensation, deg": 0.5}
# Beijing, where the experiment was made. The paper does not print its field.
BEIJING = (39.99, 116.36, 50.0, 2026.0)
AZIMUTH_RAD = math.radians(45.0)
# The paper does not print what its sensors leave; a tilt error of 0.1 deg and 1 mG give its half degree.
TILT_ERROR_RAD = math.radians(0.1)
FIELD_ERROR_MGAUSS = 1.0


def draw(out: Path) -> dict[str, dict[str, Any]]:
    """Draw both figures; returns their entries."""
    moving = np.radians(np.arange(-10.0, 10.01, 1.0))
    fixed = np.full(moving.size, math.radians(10.0))
    return {
        "two-axis-fig4": _figure(out / "two-axis-fig4.png", 4, "pitch", fixed, moving),
        "two-axis-fig5": _figure(out / "two-axis-fig5.png", 5, "roll", moving, fixed),
    }


def _figure(target: Path, number: int, swept: str, roll: Array, pitch: Array) -> dict[str, Any]:
    import matplotlib.pyplot as plt

    rng = np.random.default_rng(number)
    x, y, z = tilted_field(roll, pitch)
    length = float(np.sqrt(x[0] ** 2 + y[0] ** 2 + z[0] ** 2))
    lean = rng.normal(0.0, TILT_ERROR_RAD, (2, roll.size))
    off = rng.normal(0.0, FIELD_ERROR_MGAUSS, (2, roll.size))
    without = np.degrees(wrap_pi(paper_azimuth(x + off[0], y + off[1]) - AZIMUTH_RAD))
    azimuth = paper_two_axis_azimuth(
        x + off[0], y + off[1], roll + lean[0], pitch + lean[1], length, float(np.sign(z[0]))
    )
    compensated = np.degrees(wrap_pi(azimuth - AZIMUTH_RAD))
    exact = paper_two_axis_azimuth(x, y, roll, pitch, length, float(np.sign(z[0])))
    degrees = np.degrees(pitch if swept == "pitch" else roll)
    figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    axes.plot(degrees, without, "o-", label=f"without: at most {np.abs(without).max():.1f} deg (paper: 22)")
    axes.plot(
        degrees, compensated, "s-", label=f"with: at most {np.abs(compensated).max():.2f} deg (paper: 0.5)"
    )
    axes.set_xlabel(f"{swept}, deg (the other angle 10 deg)")
    axes.set_ylabel("azimuth error, deg")
    axes.set_title(f"Two-axis compass at azimuth 45 deg, after Li et al., Fig. {number}")
    axes.legend()
    figure.savefig(target, dpi=110)
    plt.close(figure)
    return {
        "about": f"azimuth 45 deg, one angle 10 deg, {swept} from -10 to 10 deg",
        "ours": {
            "largest error without compensation, deg": float(np.abs(without).max()),
            "largest error with compensation, deg": float(np.abs(compensated).max()),
            "with compensation and perfect sensors, deg": float(
                np.degrees(np.abs(wrap_pi(exact - AZIMUTH_RAD)).max())
            ),
        },
        "paper": PAPER,
    }


def tilted_field(theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return the field in the paper's axes at azimuth 45 degrees: its equations 4 and 5 undone."""
    earth = earth_field(*BEIJING)
    x_level = earth.horizontal_mgauss * math.cos(AZIMUTH_RAD)
    y_level = earth.horizontal_mgauss * math.sin(AZIMUTH_RAD)
    vertical = -earth.ned_mgauss[2]  # the paper's third axis points up
    x = x_level * np.cos(phi) + vertical * np.sin(phi)
    z_roll = -x_level * np.sin(phi) + vertical * np.cos(phi)
    y = y_level * np.cos(theta) - z_roll * np.sin(theta)
    z = y_level * np.sin(theta) + z_roll * np.cos(theta)
    return x, y, z


def bound() -> dict[str, Any]:
    """State the paper's bound for a Z that is off by 2 mG where the horizontal field has 200."""
    return {
        "about": "azimuth error by 2 mG of Z at 200 mG horizontal",
        "ours": {"bound, deg": math.degrees(vertical_error_bound_rad(2.0, 200.0))},
        "paper": {"bound, deg": 0.8},
    }
