"""How good is a calibration, and is its sigma true? Monte Carlo tables.

    python scripts/campaigns/calibration.py [--runs 5000] [--seed 20261121] [--only NAME] [--workers 2]

A quarter of the vehicles have cross terms (4 % rms), as the fit's prior has it; the others have none.
Each run makes a vehicle with irons of its own, calibrates it by the four-position fit from its positions and
compares the heading at one random heading with the truth. Behind it is the share of errors within 1 and 1.96
of the claimed sigma; of what the verdict refuses the reasons are counted. Whole recordings of any motion are
CompassBench's (`scripts/bench world`) and those of `vehicles.py`.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from campaign import ended, options, rms, tried
from made_up import CIRCLE, EARTH, SCENARIOS, Iron, Scenario, body_field, errors_deg, headings_of, vehicle_of

from mavcompass.calibration.findings import judge
from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook
from mavcompass.calibration.observation import Dwell, FourPositionData, Step
from mavcompass.calibration.observation.wire import unquantise
from mavcompass.calibration.positions import solve_four_positions
from mavcompass.frames import FloatArray


def dwelt(scenario: Scenario, rng: np.random.Generator) -> tuple[Iron, FourPositionData]:
    """Make one vehicle and what its sensors see at the positions."""
    truth = vehicle_of(scenario, rng)
    k = scenario.positions
    psi = headings_of(scenario, truth, rng)
    roll, pitch = np.radians(rng.normal(0.0, 1.0, (2, k)) * scenario.tilt)
    noise = scenario.noise if scenario.noise >= 0.0 else 10.0 ** rng.uniform(-0.7, 0.3)
    current = rng.uniform(0.0, 1.0, k) * scenario.current
    motor = rng.normal(0.0, 1.0, 3) * scenario.motor
    mean = truth.raw(body_field(psi, roll, pitch, EARTH)) + (current - current.mean())[:, np.newaxis] * motor
    if scenario.disturbance:
        mean[rng.integers(k)] += rng.normal(0.0, 1.0, 3) * scenario.disturbance
    readings = mean[:, np.newaxis, :] + rng.normal(0.0, 1.0, (k, scenario.samples, 3)) * noise
    spread = np.sqrt(((readings - readings.mean(axis=1, keepdims=True)) ** 2).mean(axis=(0, 1)))
    hidden = np.zeros((k, 3))
    if scenario.whole_numbers:
        readings = np.trunc(readings)
        pairs = [unquantise(r.mean(axis=0), r.std(axis=0), 1.0, True) for r in readings]
        value, hidden = (np.array(v) for v in zip(*pairs, strict=True))
        variance = np.maximum(readings.var(axis=1), 1e-6) / scenario.samples
    else:
        value = readings.mean(axis=1)
        variance = np.tile(spread**2 / scenario.samples, (k, 1))
    lean = np.radians(rng.normal(0.0, 1.0, (2, k)) * scenario.tilt_sigma)
    dwells = tuple(
        Dwell(
            start_s=8.0 * i,
            end_s=8.0 * i + 5.0,
            mean_mgauss=value[i],
            covariance_mgauss2=np.diag(variance[i]),
            quantisation_mgauss2=np.diag(hidden[i] ** 2),
            roll_rad=float(roll[i] + lean[0, i]),
            pitch_rad=float(pitch[i] + lean[1, i]),
            tilt_sigma_rad=max(math.radians(scenario.tilt_sigma), 1e-6),
            samples=scenario.samples,
            current_a=float(current[i]) if scenario.current else math.nan,
        )
        for i in range(k)
    )
    return truth, _with_steps(scenario, dwells, psi, rng)


def _with_steps(
    scenario: Scenario, dwells: tuple[Dwell, ...], psi: FloatArray, rng: np.random.Generator
) -> FourPositionData:
    scale = 1.0 + rng.normal() * scenario.gyro_scale_sigma
    bias = math.radians(rng.normal() * scenario.gyro_bias_sigma)
    sigma = math.radians(scenario.gyro_sigma)
    steps = tuple(
        Step(float(turn * scale + 8.0 * bias + rng.normal() * sigma), max(sigma, 1e-6), 8.0)
        for turn in np.diff(psi)
    )
    return FourPositionData(
        dwells,
        steps,
        gyro_scale_sigma=max(scenario.gyro_scale_sigma, 1e-9),
        gyro_bias_sigma_radps=max(math.radians(scenario.gyro_bias_sigma), 1e-9),
    )


def cramer_rao_deg(scenario: Scenario, truth: Iron) -> float:
    """Return the bound of the textbook's five parameters: sqrt(3/8) sigma / (H sqrt n), mean gain 1."""
    gains = np.diag(truth.gain)[:2]
    share = 0.5 * float((1.0 / gains**2).sum())
    sigma = scenario.noise / math.sqrt(scenario.samples)
    return math.degrees(math.sqrt(3.0 / 8.0 * share) * sigma / EARTH.horizontal_mgauss)


def textbook_errors_deg(data: FourPositionData, truth: Iron) -> FloatArray | None:
    """Return the errors of the paper's method on the same readings, which assumes 90 degree steps."""
    if len(data.dwells) < 4:
        return None
    means = np.array([d.mean_mgauss for d in data.dwells[:4]])
    return errors_deg(four_positions_textbook(means)[0].correction(), truth)


@dataclass(frozen=True)
class Score:
    """Hold what became of a vehicle: errors over the circle and claims in degrees; `ratio` at one heading.

    Attributes:
        paper_deg, bound_deg: what the textbook's method leaves, and what nobody could do better.
    """

    error_deg: FloatArray
    ratio: float
    claimed_deg: float
    paper_deg: FloatArray | None
    bound_deg: float


def scored(scenario: Scenario, rng: np.random.Generator) -> Score | str:
    """Calibrate a vehicle; return the reason where it is refused."""
    truth, data = dwelt(scenario, rng)
    fit = solve_four_positions(data, earth=EARTH if scenario.world_model else None)
    if reasons := judge(data, fit)[0]:
        return " ".join(reasons[0].split()[:6])
    error, place = errors_deg(fit.correction, truth), int(rng.integers(72))
    sigma = math.degrees(float(fit.heading_error.sigma_rad(CIRCLE[place])[0]))
    return Score(
        error,
        float(error[place]) / sigma,
        math.degrees(fit.heading_sigma_rad),
        textbook_errors_deg(data, truth),
        cramer_rao_deg(scenario, truth),
    )


def run(name: str, runs: int, seed: int) -> dict[str, Any]:
    """Run one scenario and summarise it."""
    scenario, rng = SCENARIOS[name], np.random.default_rng(seed + list(SCENARIOS).index(name))
    drawn = [scored(scenario, rng) for _ in range(runs)]
    scores = [one for one in drawn if isinstance(one, Score)]
    error_deg, ratio = rms(one.error_deg for one in scores), np.abs([one.ratio for one in scores])
    return {
        "about": scenario.about,
        "runs": runs,
        "accepted": len(scores),
        "refused": dict(Counter(one for one in drawn if isinstance(one, str))),
        "heading_rms_deg": error_deg,
        "heading_p95_max_deg": float(np.percentile([np.abs(one.error_deg).max() for one in scores], 95))
        if scores
        else math.nan,
        "claimed_rms_deg": rms(one.claimed_deg for one in scores),
        "textbook_rms_deg": rms(one.paper_deg for one in scores if one.paper_deg is not None),
        "covered": [100.0 * float((ratio < limit).mean()) if scores else math.nan for limit in (1.0, 1.96)],
        "over_bound": error_deg / rms(one.bound_deg for one in scores),
    }


def main() -> int:
    """Print the table."""
    wanted = options(__doc__, runs=5000, seed=20261121, only=("", "one scenario by name"), workers=1)
    names = [name for name in SCENARIOS if wanted.only in ("", name)]
    print(f"{'scenario':22} {'accepted':>9} {'rms deg':>8} {'claimed':>8} {'paper':>8}    1, 1.96 s")
    table = {}
    rows = tried(partial(run, runs=wanted.runs, seed=wanted.seed), names, workers=wanted.workers)
    for name, row in zip(names, rows, strict=True):
        table[name] = row
        sizes = " ".join(
            f"{row[size]:8.3f}" for size in ("heading_rms_deg", "claimed_rms_deg", "textbook_rms_deg")
        )
        shares = " ".join(f"{percent:7.1f}" for percent in row["covered"])
        print(f"{name:22} {row['accepted']:9} {sizes} {shares}", row["refused"] or "", flush=True)
        if name == "exact steps":
            print(f"{'':22} heading error / Cramer-Rao bound: {row['over_bound']:.3f}")
    return ended(wanted.json, table, wrong=False)


if __name__ == "__main__":
    sys.exit(main())
