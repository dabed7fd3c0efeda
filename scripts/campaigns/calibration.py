"""How good is the four-position calibration, and is its sigma true? A Monte Carlo table.

    python scripts/campaigns/calibration.py [--runs 5000] [--only NAME] [--json FILE]

A quarter of the vehicles have cross terms (4 % rms), as the fit's prior has it; the others have none.
Each run makes a vehicle with irons of its own, calibrates it and compares the heading at one random
heading with the truth. "covered" is the share of accepted runs whose error lies within 1 and 1.96 of the
claimed sigma; a run that the verdict refuses is not counted there, but its reason is.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook
from mavcompass.calibration.model import level_to_body
from mavcompass.calibration.observation import Dwell, FourPositionData, Step
from mavcompass.calibration.observation.wire import unquantise
from mavcompass.calibration.positions import FourPositionsResult, solve_four_positions
from mavcompass.calibration.positions.verdict import judge
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.compute import level_heading

EARTH = EarthField((200.0 * math.cos(0.2), 200.0 * math.sin(0.2), -430.0))
CIRCLE = np.arange(72) * (2.0 * math.pi / 72)


@dataclass(frozen=True)
class Scenario:
    """What a run is made of; angles in degrees, fields in milligauss."""

    about: str
    positions: int = 4
    noise: float = 3.0
    samples: int = 50
    step_error: float = 0.0
    gyro_sigma: float = 0.0
    gyro_scale_sigma: float = 0.0
    gyro_bias_sigma: float = 0.0  # degrees per second
    offset: float = 80.0
    offset_of_h: float = 0.0  # instead of `offset`, with the steps closed on the bent compass
    gain: float = 0.06
    cross: float = 0.04
    crossed: float = 0.25  # share of vehicles with cross terms
    tilt: float = 0.0
    tilt_sigma: float = 0.0
    whole_numbers: bool = False
    disturbance: float = 0.0
    current: float = 0.0  # amperes
    motor: float = 0.0  # mG per ampere
    world_model: bool = True


SCENARIOS = {
    "exact steps": Scenario("exact steps, white noise 3 mG", crossed=0.0),
    "wrong steps": Scenario("steps 3 deg rms, gyro 0.3 deg per step", step_error=3.0, gyro_sigma=0.3),
    "bent loop 0.25 H": Scenario(
        "steps closed on the bad compass", offset_of_h=0.25, gyro_sigma=0.3, noise=1.0
    ),
    "bent loop 0.5 H": Scenario(
        "steps closed on the bad compass", offset_of_h=0.5, gyro_sigma=0.3, noise=1.0
    ),
    "whole numbers": Scenario(
        "int16 truncation, noise 0.2 to 2 mG", whole_numbers=True, noise=-1.0, step_error=3.0, gyro_sigma=0.3
    ),
    "tilt": Scenario(
        "ground of 3 deg, tilt known to 0.2 deg",
        tilt=3.0,
        tilt_sigma=0.2,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "cross terms": Scenario(
        "soft iron with cross terms of 0.03",
        cross=0.03,
        crossed=1.0,
        gain=0.1,
        step_error=5.0,
        gyro_sigma=0.3,
    ),
    "gyro scale and bias": Scenario(
        "gyro scale 1 %, bias 0.05 deg/s, three positions in ten with 5 stops",
        positions=5,
        gyro_scale_sigma=0.01,
        gyro_bias_sigma=0.05,
        gyro_sigma=0.1,
        step_error=5.0,
    ),
    "disturbance": Scenario(
        "steel of 20 mG rms, each axis, near one position", disturbance=20.0, step_error=3.0, gyro_sigma=0.3
    ),
    "disturbance, 5 stops": Scenario(
        "the same with a fifth stop back at the first heading",
        positions=5,
        disturbance=20.0,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "current": Scenario(
        "0 to 10 A of 0.5 mG/A; judged at their mean current",
        current=10.0,
        motor=0.5,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "three positions": Scenario("only three positions", positions=3, step_error=5.0, gyro_sigma=0.3),
    "no place": Scenario("no world model", world_model=False, step_error=3.0, gyro_sigma=0.3),
}


@dataclass(frozen=True)
class Truth:
    """The vehicle of a run: raw = offset + gain field."""

    offset: FloatArray
    gain: FloatArray

    def raw(
        self, psi: FloatArray, roll: FloatArray | float = 0.0, pitch: FloatArray | float = 0.0
    ) -> FloatArray:
        h, z = EARTH.horizontal_mgauss, EARTH.ned_mgauss[2]
        level = np.stack([h * np.cos(psi), -h * np.sin(psi), np.full(psi.size, z)], axis=1)
        roll, pitch = np.broadcast_to(roll, psi.shape), np.broadcast_to(pitch, psi.shape)
        body = np.einsum("nij,nj->ni", level_to_body(roll, pitch), level)
        return body @ self.gain.T + self.offset


def draw(scenario: Scenario, rng: np.random.Generator) -> tuple[Truth, FourPositionData]:
    """Make one vehicle and what its sensors see at the positions."""
    truth = vehicle_of(scenario, rng)
    k = scenario.positions
    psi = headings_of(scenario, truth, rng)
    roll, pitch = np.radians(rng.normal(0.0, 1.0, (2, k)) * scenario.tilt)
    noise = scenario.noise if scenario.noise >= 0.0 else 10.0 ** rng.uniform(-0.7, 0.3)
    current = rng.uniform(0.0, 1.0, k) * scenario.current
    motor = rng.normal(0.0, 1.0, 3) * scenario.motor
    mean = truth.raw(psi, roll, pitch) + (current - current.mean())[:, np.newaxis] * motor
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


def vehicle_of(scenario: Scenario, rng: np.random.Generator) -> Truth:
    spread = 0.0 if scenario.offset_of_h else scenario.gain
    gain = np.diag(1.0 + rng.normal(0.0, 1.0, 3) * spread)
    gain[2, 2] = 0.5 * (gain[0, 0] + gain[1, 1]) + rng.normal() * 0.03
    for pairs in (((0, 1),), ((0, 2), (1, 2))):
        size = scenario.cross * (rng.random() < scenario.crossed)
        for row, column in pairs:
            gain[row, column] = gain[column, row] = rng.normal() * size
    offset = rng.normal(0.0, 1.0, 3) * scenario.offset
    if scenario.offset_of_h:
        angle = rng.uniform(0.0, 2.0 * math.pi)
        size = scenario.offset_of_h * EARTH.horizontal_mgauss
        offset = np.array([size * math.cos(angle), size * math.sin(angle), 20.0 * rng.normal()])
    return Truth(offset, gain)


def headings_of(scenario: Scenario, truth: Truth, rng: np.random.Generator) -> FloatArray:
    k = scenario.positions
    first = rng.uniform(0.0, 2.0 * math.pi)
    nominal = 2.0 * math.pi / k if k != 5 else math.pi / 2.0
    if not scenario.offset_of_h:
        turns = nominal + np.radians(rng.normal(0.0, 1.0, k - 1) * scenario.step_error)
        return first + np.concatenate([[0.0], np.cumsum(turns)])
    # The autopilot turns until its bent compass has moved by 90 degrees.
    fine = np.linspace(0.0, 2.0 * math.pi, 3601)
    shown = level_heading(truth.raw(fine))
    wanted = first + nominal * np.arange(k)
    nearest = np.array([fine[np.argmin(np.abs(wrap_pi(shown - w)))] for w in wanted])
    return np.asarray(nearest[0] + np.concatenate([[0.0], np.cumsum(np.mod(np.diff(nearest), 2 * math.pi))]))


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


def errors_deg(correction: FieldCorrection, truth: Truth) -> FloatArray:
    """Return the level heading errors on the circle, (72,)."""
    return np.degrees(wrap_pi(level_heading(correction.apply(truth.raw(CIRCLE))) - CIRCLE))


def cramer_rao_deg(scenario: Scenario, truth: Truth) -> float:
    """Return the bound of the textbook's five parameters: sqrt(3/8) sigma / (H sqrt n), mean gain 1."""
    gains = np.diag(truth.gain)[:2]
    share = 0.5 * float((1.0 / gains**2).sum())
    sigma = scenario.noise / math.sqrt(scenario.samples)
    return math.degrees(math.sqrt(3.0 / 8.0 * share) * sigma / EARTH.horizontal_mgauss)


def textbook_errors_deg(data: FourPositionData, truth: Truth) -> FloatArray | None:
    """Return the errors of the paper's method on the same readings, which assumes 90 degree steps."""
    if len(data.dwells) < 4:
        return None
    means = np.array([d.mean_mgauss for d in data.dwells[:4]])
    return errors_deg(four_positions_textbook(means)[0].correction(), truth)


def run(scenario: Scenario, runs: int, seed: int, progress: Callable[[int], None]) -> dict[str, object]:
    """Run one scenario and summarise it."""
    rng = np.random.default_rng(seed)
    ratio, worst, squares, textbook, bound = [], [], [], [], []
    claimed = []
    refused: Counter[str] = Counter()
    for index in range(runs):
        progress(index)
        truth, data = draw(scenario, rng)
        fit = solve_four_positions(data, earth=EARTH if scenario.world_model else None)
        reasons, _ = judge(data, fit)
        if reasons:
            refused[_kind(reasons[0])] += 1
            continue
        error = errors_deg(fit.correction, truth)
        ratio.append(_ratio(fit, error, int(rng.integers(72))))
        squares.append(float((error**2).mean()))
        worst.append(float(np.abs(error).max()))
        claimed.append(math.degrees(fit.heading_sigma_rad) ** 2)
        bound.append(cramer_rao_deg(scenario, truth) ** 2)
        plain = textbook_errors_deg(data, truth)
        if plain is not None:
            textbook.append(float((plain**2).mean()))
    accepted = len(ratio)
    values = np.array(ratio)
    return {
        "about": scenario.about,
        "runs": runs,
        "accepted": accepted,
        "refused": dict(refused),
        "covered_68": float((np.abs(values) < 1.0).mean()) if accepted else None,
        "covered_95": float((np.abs(values) < 1.96).mean()) if accepted else None,
        "heading_rms_deg": math.sqrt(float(np.mean(squares))) if accepted else None,
        "heading_p95_max_deg": float(np.percentile(worst, 95)) if accepted else None,
        "claimed_rms_deg": math.sqrt(float(np.mean(claimed))) if accepted else None,
        "textbook_rms_deg": math.sqrt(float(np.mean(textbook))) if textbook else None,
        "over_bound": math.sqrt(float(np.mean(squares)) / float(np.mean(bound)))
        if accepted and scenario == SCENARIOS["exact steps"]
        else None,
    }


def _ratio(fit: FourPositionsResult, error_deg: FloatArray, place: int) -> float:
    sigma = math.degrees(float(fit.heading_error.sigma_rad(CIRCLE[place])[0]))
    return float(error_deg[place]) / sigma


def _kind(reason: str) -> str:
    return " ".join(reason.split()[:6])


def main() -> int:
    """Print the table; write it as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--only", default=None, help="one scenario by name")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    chosen = {n: s for n, s in SCENARIOS.items() if options.only in (None, n)}
    table = {}
    print(
        f"{'scenario':22} {'accepted':>9} {'rms deg':>8} {'claimed':>8} {'paper':>8} {'1 s':>6} {'1.96 s':>8}"
    )
    for number, (name, scenario) in enumerate(chosen.items()):
        row = run(replace(scenario), options.runs, options.seed + number, _progress(name, options.runs))
        table[name] = row
        cells = [row["heading_rms_deg"], row["claimed_rms_deg"], row["textbook_rms_deg"]]
        shown = [f"{c:8.3f}" if isinstance(c, float) else f"{'-':>8}" for c in cells]
        covered = [row["covered_68"], row["covered_95"]]
        percent = [f"{100 * c:.1f}" if isinstance(c, float) else "-" for c in covered]
        line = f"{name:22} {row['accepted']:>9} {' '.join(shown)} {percent[0]:>6} {percent[1]:>8}"
        print(line, row["refused"] or "")
        if row["over_bound"]:
            print(f"{'':22} heading error / Cramer-Rao bound: {row['over_bound']:.3f}")
    if options.json:
        options.json.write_text(json.dumps(table, indent=1))
    return 0


def _progress(name: str, runs: int) -> Callable[[int], None]:
    def show(index: int) -> None:
        if sys.stderr.isatty() and index % 250 == 0:
            print(f"\r{name}: {index}/{runs}", end="\r", file=sys.stderr)

    return show


if __name__ == "__main__":
    raise SystemExit(main())
