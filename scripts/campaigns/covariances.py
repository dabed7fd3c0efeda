"""Is the covariance of a calibration positive definite, whatever was visited?

    python scripts/campaigns/covariances.py [--problems 100000] [--seed 1]

Draws four-position problems: two to seven stops, any steps between them, iron up to half of the field, tilt
up to 0.2 rad. Told are the refused ones and the least eigenvalue of the correlation matrices. Exit code 1
where a covariance is not finite or not positive definite.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT), str(PROJECT / "tests" / "calibration")]

from calibration_worlds import FIELD, Iron, four_positions  # noqa: E402

from mavcompass.calibration.positions import PositionProblem  # noqa: E402
from mavcompass.calibration.positions.problem import fit_positions  # noqa: E402
from mavcompass.calibration.rigid import DEFAULT_PRIOR  # noqa: E402
from mavcompass.correction import IDENTITY  # noqa: E402
from mavcompass.errors import PoorCalibration  # noqa: E402


def least_eigenvalue(seed: tuple[int, int]) -> float | None:
    """Draw and solve a problem; return the least eigenvalue of its correlations, None where it is refused."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-2.5, 2.5, int(rng.integers(2, 8)))
    hard, soft = rng.normal(0.0, 200.0, 3), np.eye(3) + rng.normal(0.0, 0.15, (3, 3))
    data = four_positions(
        Iron((float(hard[0]), float(hard[1]), float(hard[2])), soft),
        rng,
        turns=turns,
        noise=3.0,
        gyro_sigma=0.01,
        gyro_scale_sigma=0.01,
        tilt=float(rng.uniform(0.0, 0.2)),
    )
    try:
        problem = PositionProblem.of(data, IDENTITY, FIELD, DEFAULT_PRIOR)
    except PoorCalibration:
        return None
    covariance = fit_positions(problem).covariance
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).all():
        return float("-inf")
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return float(np.linalg.eigvalsh(covariance * np.outer(scale, scale)).min())


def main() -> int:
    """Draw them all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    refused, wrong, least = 0, 0, float("inf")
    for number in range(options.problems):
        found = least_eigenvalue((options.seed, number))
        if found is None:
            refused += 1
            continue
        least = min(least, found)
        if not found > 0.0:
            wrong += 1
            print(f"problem {number} of seed {options.seed}: {found}", flush=True)
        if (number + 1) % 10_000 == 0:
            print(f"{number + 1} drawn, {wrong} wrong, least eigenvalue {least:.2g}", flush=True)
    print(f"{options.problems} drawn, {refused} refused, {wrong} wrong, least eigenvalue {least:.2g}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
