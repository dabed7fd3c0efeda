"""Regenerate the results of the three papers this project implements, as figures and as numbers.

    scripts/reproduce [--out FOLDER] [--data FOLDER]

Writes one PNG per figure and reproduce.json, which holds our numbers beside the paper's. Where a paper
shows measurements that it does not print, the figure is made from simulated data and, for the level turn,
from a real HMC5883L as well.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook
from mavcompass.calibration.methods.min_max import min_max
from mavcompass.calibration.methods.sensitivity_bias import sensitivity_bias
from mavcompass.calibration.model import GYRO_BIAS, GYRO_SCALE
from mavcompass.calibration.observation import observe, turn_record
from mavcompass.calibration.positions import solve_four_positions
from mavcompass.earth_field import earth_field
from mavcompass.frames import wrap_pi, wrap_two_pi
from mavcompass.logs import read_track

PROJECT = Path(__file__).resolve().parents[2]
Array = NDArray[np.float64]


# --- [Skula] Fig. 2: the field against azimuth, and the error against the first position --------------

FOUR = "mean heading error against the position of the first of four points, and of min-max"
FOUR_PAPER = {"four positions": "the same as min-max or better", "numbers": "shown as a curve, not printed"}


def four_simulated(out: Path) -> dict[str, Any]:
    """Draw the figure for a simulated sensor whose response is not exactly a sine."""
    azimuth = np.radians(np.arange(360.0))
    rng = np.random.default_rng(2010)

    def axis(amplitude: float, offset: float, angle: Array) -> Array:
        # The bridge saturates a little and its field is bent by iron: second and third harmonics.
        bend = 0.012 * np.sin(2.0 * angle + 0.7) + 0.015 * np.sin(3.0 * angle + 0.4)
        return offset + amplitude * (np.sin(angle) + bend) + rng.normal(0.0, 0.5, angle.size)

    x = axis(210.0, 45.0, azimuth + math.pi / 2.0)
    y = axis(180.0, -70.0, azimuth + math.pi)
    numbers = _four_figure(
        out / "four-positions-fig2-simulated.png", azimuth, np.column_stack([x, y]), "simulated"
    )
    return {"about": FOUR + ", simulated", "ours": numbers, "paper": FOUR_PAPER}


def four_real(out: Path, data: Path) -> dict[str, Any]:
    """Draw the figure for a real HMC5883L turned level by hand; the azimuth is the gyro's."""
    recording = data / "real/hmc5883l-hand-rotation/rotate-ccw-around-z-pointing-up.csv"
    about = FOUR + ", HMC5883L turned level by hand"
    if not recording.is_file():
        return {
            "about": about,
            "skipped": f"{recording.name} is not among the recordings",
            "paper": FOUR_PAPER,
        }
    azimuth, field = _level_turn(recording)
    numbers = _four_figure(out / "four-positions-fig2-hmc5883l.png", azimuth, field, "HMC5883L, by hand")
    return {"about": about, "ours": numbers, "paper": FOUR_PAPER}


def _level_turn(recording: Path) -> tuple[Array, Array]:
    """Return one value of X and Y per degree of gyro angle over the two turns, and the angles."""
    track = read_track(recording)
    record = turn_record(track)
    assert record is not None
    data = observe(track, 1, record)
    # The two turns close on each other: that gives the bare gyro's bias and scale.
    fit = solve_four_positions(data)
    time_s = track.compasses[1].time_s
    bias, scale = fit.state[GYRO_BIAS], 1.0 + fit.state[GYRO_SCALE]
    angle = (record.angle_at(time_s) - bias * (time_s - time_s[0])) / scale
    raw = track.compasses[1].reported.values[:, :2]
    bins = np.floor(np.degrees(angle) % 360.0).astype(int)
    present = [k for k in range(360) if (bins == k).any()]
    means = np.array([raw[bins == k].mean(axis=0) for k in present])
    every = np.arange(360)
    columns = [np.interp(every, present, column, period=360.0) for column in means.T]
    return np.radians(every + 0.5), np.column_stack(columns)


def _four_figure(target: Path, azimuth: Array, field: Array, label: str) -> dict[str, float]:
    step = azimuth.size // 4
    four = np.array(
        [
            mean_error_deg(
                four_positions_textbook(field[(first + step * np.arange(4)) % azimuth.size])[0].apply(field),
                azimuth,
            )
            for first in range(azimuth.size)
        ]
    )
    extremes = mean_error_deg(min_max(field).apply(field), azimuth)
    degrees = np.degrees(azimuth)
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7.5, 7.0), sharex=True, layout="constrained")
    top.plot(degrees, field[:, 0], label="X")
    top.plot(degrees, field[:, 1], label="Y")
    top.set_ylabel("field, mG")
    top.set_title(f"Four positions against min-max ({label}), after Skula, Fig. 2")
    top.legend()
    bottom.plot(degrees, four, label=f"four positions: {four.mean():.2f} deg on average")
    bottom.axhline(extremes, linestyle="--", color="black", label=f"min-max: {extremes:.2f} deg")
    bottom.set_xlabel("azimuth, deg (below: of the first position)")
    bottom.set_ylabel("mean heading error, deg")
    bottom.legend()
    figure.savefig(target, dpi=110)
    plt.close(figure)
    return {
        "four positions, best first position, deg": float(four.min()),
        "four positions, average, deg": float(four.mean()),
        "four positions, worst, deg": float(four.max()),
        "min-max, deg": extremes,
        "share of first positions where four are not worse": float((four <= extremes).mean()),
    }


def mean_error_deg(field: Array, azimuth: Array) -> float:
    """Return the mean absolute error of the heading, its constant part (the mounting) taken out."""
    error = wrap_pi(np.arctan2(-field[:, 1], field[:, 0]) - azimuth)
    constant = np.angle(np.exp(1j * error).mean())
    return float(np.degrees(np.abs(wrap_pi(error - constant)).mean()))


# --- [Li et al.] Fig. 4 and 5: a tilted two-axis compass, and the bound for a wrong Z -------------------
#
# The paper's axes: X forward, Z along the magnetometer's third axis, azimuth arctan(Y / X), which is
# clockwise from north only if Y counts to the LEFT (its text says right; with Y to the right the same
# formula gives minus the heading). Its roll theta and pitch phi turn the measured vector back to the
# horizontal, so they have the opposite sign of a right-handed rotation of the vehicle: theta = -roll
# and phi = -pitch for right-handed X forward, Y left, Z up, and equally for forward, right, down.

TILT_PAPER = {"largest error without compensation, deg": 22.0, "largest error with compensation, deg": 0.5}
# Beijing, where the experiment was made. The paper does not print its field.
BEIJING = (39.99, 116.36, 50.0, 2026.0)
AZIMUTH_RAD = math.radians(45.0)
# The paper does not print what its sensors leave; a tilt error of 0.1 deg and 1 mG give its half degree.
TILT_ERROR_RAD = math.radians(0.1)
FIELD_ERROR_MGAUSS = 1.0


def paper_azimuth(x: Array, y: Array, theta_rad: Array, phi_rad: Array, length: float, sign: float) -> Array:
    """Return the tilt-compensated azimuth of a two-axis compass, [0, 2 pi): the paper's equations as printed.

    The paper gives the positive root of eq. 2 only; which one is right depends on hemisphere and axes
    (`sign`). Where noise makes the difference negative, Z is 0. atan2 stands for its arctan(Y / X).
    """
    z = sign * np.sqrt(np.maximum(length**2 - x**2 - y**2, 0.0))  # eq. 2, printed again as eq. 3
    y_level = y * np.cos(theta_rad) + z * np.sin(theta_rad)  # eq. 4: turned to the horizontal by roll theta
    z_roll = -y * np.sin(theta_rad) + z * np.cos(theta_rad)
    x_level = x * np.cos(phi_rad) - z_roll * np.sin(phi_rad)  # eq. 5: then by pitch phi
    return np.asarray(wrap_two_pi(np.arctan2(y_level, x_level)))  # eq. 6, level eq. 1


def tilts(out: Path) -> dict[str, dict[str, Any]]:
    """Draw both figures; returns their entries."""
    moving = np.radians(np.arange(-10.0, 10.01, 1.0))
    fixed = np.full(moving.size, math.radians(10.0))
    return {
        "two-axis-fig4": _tilt_figure(out / "two-axis-fig4.png", 4, "pitch", fixed, moving),
        "two-axis-fig5": _tilt_figure(out / "two-axis-fig5.png", 5, "roll", moving, fixed),
    }


def _tilt_figure(target: Path, number: int, swept: str, roll: Array, pitch: Array) -> dict[str, Any]:
    rng = np.random.default_rng(number)
    x, y, z = tilted_field(roll, pitch)
    length = float(np.sqrt(x[0] ** 2 + y[0] ** 2 + z[0] ** 2))
    lean = rng.normal(0.0, TILT_ERROR_RAD, (2, roll.size))
    off = rng.normal(0.0, FIELD_ERROR_MGAUSS, (2, roll.size))
    without = np.degrees(wrap_pi(np.arctan2(y + off[1], x + off[0]) - AZIMUTH_RAD))
    azimuth = paper_azimuth(
        x + off[0], y + off[1], roll + lean[0], pitch + lean[1], length, float(np.sign(z[0]))
    )
    compensated = np.degrees(wrap_pi(azimuth - AZIMUTH_RAD))
    exact = paper_azimuth(x, y, roll, pitch, length, float(np.sign(z[0])))
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
        "paper": TILT_PAPER,
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


# --- [Memsense] Fig. 2 and 3: a level turn without and with a local field, and the steel bicycle --------

HORIZONTAL_GAUSS = 0.28
BICYCLE = (-0.284, 0.402, -0.322, 0.246)


def level_turns(out: Path) -> dict[str, dict[str, Any]]:
    """Draw both figures; returns their entries."""
    clean = _turn(1.0, 0.0, 1.0, 0.0)
    low_x, high_x, low_y, high_y = BICYCLE
    bent = _turn(
        0.5 * (high_x - low_x) / HORIZONTAL_GAUSS,
        0.5 * (high_x + low_x),
        0.5 * (high_y - low_y) / HORIZONTAL_GAUSS,
        0.5 * (high_y + low_y),
    )
    return {
        "sensitivity-fig2": _turn_figure(
            out / "sensitivity-fig2.png", "without a local field, Fig. 2", clean
        ),
        "sensitivity-fig3": _turn_figure(out / "sensitivity-fig3.png", "on the steel bicycle, Fig. 3", bent),
    }


def _turn(x_gain: float, x_offset: float, y_gain: float, y_offset: float) -> np.ndarray:
    angle = np.radians(np.arange(361.0))
    x = x_offset + x_gain * HORIZONTAL_GAUSS * np.cos(angle)
    y = y_offset - y_gain * HORIZONTAL_GAUSS * np.sin(angle)
    return np.column_stack([x, y]) + np.random.default_rng(3).normal(0.0, 0.001, (361, 2))


def _turn_figure(target: Path, title: str, turn: np.ndarray) -> dict[str, Any]:
    low, high = turn.min(axis=0), turn.max(axis=0)
    solved = sensitivity_bias(low[0], high[0], low[1], high[1])
    corrected = solved.apply(turn)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
    left.plot(turn[:, 0], label="X")
    left.plot(turn[:, 1], label="Y")
    left.set_xlabel("angle, deg")
    left.set_ylabel("field, gauss")
    left.legend()
    right.plot(*turn.T, label="as measured")
    right.plot(*corrected.T, "--", label="corrected")
    right.set_aspect("equal")
    right.set_xlabel("X, gauss")
    right.set_ylabel("Y, gauss")
    right.legend()
    figure.suptitle(f"A level turn {title}, after Memsense")
    figure.savefig(target, dpi=110)
    plt.close(figure)
    radius = np.hypot(*corrected.T)
    return {
        "about": f"a level turn {title}",
        "ours": {
            "largest horizontal field, gauss": float(turn.max()),
            "roundness after correction (rms of the radius), %": float(100.0 * radius.std() / radius.mean()),
        },
        "paper": {"largest horizontal field, gauss": 0.28 if "without" in title else 0.402},
    }


def bicycle() -> dict[str, Any]:
    """Work the paper's example."""
    solved = sensitivity_bias(*BICYCLE)
    ours = (solved.gain[0], solved.bias[0], solved.gain[1], solved.bias[1])
    names = ("Xs", "Xb", "Ys", "Yb")
    return {
        "about": "the steel bicycle's sensitivities and biases, gauss",
        "ours": {name: round(value, 3) for name, value in zip(names, ours, strict=True)},
        "paper": dict(zip(names, (1.0, -0.059, 1.208, 0.046), strict=True)),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Make all figures; print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PROJECT / "build" / "reproduce")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data"),
        help="folder of the shared recordings, for the real level turn",
    )
    options = parser.parse_args(argv)
    plt.switch_backend("Agg")
    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"schema": "mavcompass.reproduce/1", "figures": {}, "tables": {}}
    figures, tables = results["figures"], results["tables"]
    figures["four-positions-fig2-simulated"] = four_simulated(options.out)
    figures["four-positions-fig2-hmc5883l"] = four_real(options.out, options.data)
    figures |= tilts(options.out)
    tables["two-axis-z-error-bound"] = bound()
    figures |= level_turns(options.out)
    tables["bicycle"] = bicycle()
    target = options.out / "reproduce.json"
    target.write_text(json.dumps(results, indent=1) + "\n")
    _print(results)
    print(f"\nwritten to {options.out}")
    return 0


def _print(results: dict[str, Any]) -> None:
    for kind in ("figures", "tables"):
        for name, entry in results[kind].items():
            print(f"{name}: {entry['about']}")
            for side in ("ours", "paper"):
                shown = ", ".join(f"{k} {_text(v)}" for k, v in entry.get(side, {}).items())
                print(f"  {side:5} {shown or entry.get('skipped', '-')}")


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    raise SystemExit(main())
