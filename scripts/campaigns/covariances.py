"""Is the covariance of a calibration positive definite, whatever was visited?

    python scripts/campaigns/covariances.py [--problems 100000] [--seed 1] [--workers 2]

Draws four-position problems: two to seven stops, any steps between them, iron up to half of the field, tilt
up to 0.2 rad. Told are the refused ones and the least eigenvalue of the correlation matrices. Exit code 1
where a covariance is not finite or not positive definite.
"""

from __future__ import annotations

import sys

import numpy as np
from campaign import borrow, ended, options, tried

borrow("calibration")

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
    wanted = options(__doc__, problems=100_000, seed=1, workers=1)
    cases = [(wanted.seed, number) for number in range(wanted.problems)]
    found = [
        *tried(
            least_eigenvalue,
            cases,
            lambda least: [] if least is None or least > 0.0 else [f"least eigenvalue {least}"],
            workers=wanted.workers,
            every=10_000,
        )
    ]
    solved = [least for least in found if least is not None]
    figures = {
        "drawn": len(found),
        "refused": len(found) - len(solved),
        "wrong": sum(not least > 0.0 for least in solved),
        "least eigenvalue": min(solved, default=float("inf")),
    }
    print(", ".join(f"{name} {value:.6g}" for name, value in figures.items()))
    return ended(wanted.json, figures, figures["wrong"])


if __name__ == "__main__":
    sys.exit(main())
