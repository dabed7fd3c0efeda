"""[Skula] Fig. 2: the field against azimuth, and the heading error against the first position."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook
from mavcompass.calibration.methods.min_max import min_max
from mavcompass.frames import wrap_pi

Array = NDArray[np.float64]
ABOUT = "mean heading error against the position of the first of four points, and of min-max"
PAPER = {"four positions": "the same as min-max or better", "numbers": "shown as a curve, not printed"}


def simulated(out: Path) -> dict[str, Any]:
    """Draw the figure for a simulated sensor whose response is not exactly a sine."""
    azimuth = np.radians(np.arange(360.0))
    rng = np.random.default_rng(2010)

    def axis(amplitude: float, offset: float, angle: Array) -> Array:
        # The bridge saturates a little and its field is bent by iron: second and third harmonics.
        bend = 0.012 * np.sin(2.0 * angle + 0.7) + 0.015 * np.sin(3.0 * angle + 0.4)
        return offset + amplitude * (np.sin(angle) + bend) + rng.normal(0.0, 0.5, angle.size)

    x = axis(210.0, 45.0, azimuth + math.pi / 2.0)
    y = axis(180.0, -70.0, azimuth + math.pi)
    numbers = _draw(out / "four-positions-fig2-simulated.png", azimuth, np.column_stack([x, y]), "simulated")
    return {"about": ABOUT + ", simulated", "ours": numbers, "paper": PAPER}


def real(out: Path, data: Path) -> dict[str, Any]:
    """Draw the figure for a real HMC5883L turned level by hand; the azimuth is the gyro's."""
    recording = data / "real/hmc5883l-hand-rotation/rotate-ccw-around-z-pointing-up.csv"
    about = ABOUT + ", HMC5883L turned level by hand"
    if not recording.is_file():
        return {"about": about, "skipped": f"{recording.name} is not among the recordings", "paper": PAPER}
    azimuth, field = _level_turn(recording)
    numbers = _draw(out / "four-positions-fig2-hmc5883l.png", azimuth, field, "HMC5883L, by hand")
    return {"about": about, "ours": numbers, "paper": PAPER}


def _level_turn(recording: Path) -> tuple[Array, Array]:
    """Return one value of X and Y per degree of gyro angle over the two turns, and the angles."""
    from mavcompass.calibration.model import GYRO_BIAS, GYRO_SCALE
    from mavcompass.calibration.observation import FourPositionData, observe, turn_record
    from mavcompass.calibration.positions import solve_four_positions
    from mavcompass.logs import read_track

    track = read_track(recording)
    record = turn_record(track)
    assert record is not None
    data: FourPositionData = observe(track, 1, record)
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


def _draw(target: Path, azimuth: Array, field: Array, label: str) -> dict[str, float]:
    import matplotlib.pyplot as plt

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
