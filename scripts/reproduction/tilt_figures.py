"""[Li et al.] Fig. 4 and 5: the azimuth error of a tilted two-axis compass, and the bound for a wrong Z.

The paper's axes: X forward, Z along the magnetometer's third axis, azimuth arctan(Y / X), which is
clockwise from north only if Y counts to the LEFT (its text says right; with Y to the right the same
formula gives minus the heading). Its roll theta and pitch phi turn the measured vector back to the
horizontal, so they have the opposite sign of a right-handed rotation of the vehicle: theta = -roll
and phi = -pitch for right-handed X forward, Y left, Z up, and equally for forward, right, down.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.earth_field import earth_field
from mavcompass.frames import wrap_pi, wrap_two_pi

Array = NDArray[np.float64]
PAPER = {"largest error without compensation, deg": 22.0, "largest error with compensation, deg": 0.5}
# Beijing, where the experiment was made. The paper does not print its field.
BEIJING = (39.99, 116.36, 50.0, 2026.0)
AZIMUTH_RAD = math.radians(45.0)
# The paper does not print what its sensors leave; a tilt error of 0.1 deg and 1 mG give its half degree.
TILT_ERROR_RAD = math.radians(0.1)
FIELD_ERROR_MGAUSS = 1.0


def paper_azimuth(x: ArrayLike, y: ArrayLike) -> Any:
    """Return the level two-axis azimuth (eq. 1 and 6), [0, 2 pi); atan2 in place of arctan(Y / X)."""
    return wrap_two_pi(np.arctan2(y, x))


def paper_vertical(x: ArrayLike, y: ArrayLike, length: ArrayLike, sign: float = 1.0) -> Any:
    """Estimate the third axis from the field's length (eq. 2, printed again as eq. 3).

    Z = sign sqrt(length^2 - X^2 - Y^2). The paper gives the positive root only; which one is right
    depends on hemisphere and axes (`sign`). Where noise makes the difference negative, Z is 0.
    """
    left = np.asarray(length, float) ** 2 - np.asarray(x, float) ** 2 - np.asarray(y, float) ** 2
    return sign * np.sqrt(np.maximum(left, 0.0))


def paper_level_field(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, theta_rad: ArrayLike, phi_rad: ArrayLike
) -> tuple[Array, Array, Array]:
    """Turn a field to the horizontal by roll theta (eq. 4), then pitch phi (eq. 5): Xh, Yh, Zv."""
    x, y, z = (np.asarray(v, dtype=np.float64) for v in (x, y, z))
    theta, phi = np.asarray(theta_rad, float), np.asarray(phi_rad, float)
    y_roll = y * np.cos(theta) + z * np.sin(theta)
    z_roll = -y * np.sin(theta) + z * np.cos(theta)
    x_level = x * np.cos(phi) - z_roll * np.sin(phi)
    return x_level, y_roll, x * np.sin(phi) + z_roll * np.cos(phi)


def paper_two_axis_azimuth(
    x: ArrayLike,
    y: ArrayLike,
    theta_rad: ArrayLike,
    phi_rad: ArrayLike,
    length: ArrayLike,
    sign: float = 1.0,
) -> Any:
    """Return the tilt-compensated azimuth of a two-axis compass (eq. 2, 4, 5, 6), [0, 2 pi)."""
    z = paper_vertical(x, y, length, sign)
    x_level, y_level, _ = paper_level_field(x, y, z, theta_rad, phi_rad)
    return paper_azimuth(x_level, y_level)


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
    """State the paper's bound, atan(sqrt(2) dZ / H), for a Z that is off by 2 mG where H is 200."""
    return {
        "about": "azimuth error by 2 mG of Z at 200 mG horizontal",
        "ours": {"bound, deg": math.degrees(math.atan(math.sqrt(2.0) * 2.0 / 200.0))},
        "paper": {"bound, deg": 0.8},
    }
