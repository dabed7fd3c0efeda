"""[Memsense] Fig. 2 and 3: a level turn without and with a local field, and the steel bicycle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration.methods.sensitivity_bias import sensitivity_bias

HORIZONTAL_GAUSS = 0.28
BICYCLE = (-0.284, 0.402, -0.322, 0.246)


def draw(out: Path) -> dict[str, dict[str, Any]]:
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
        "sensitivity-fig2": _figure(out / "sensitivity-fig2.png", "without a local field, Fig. 2", clean),
        "sensitivity-fig3": _figure(out / "sensitivity-fig3.png", "on the steel bicycle, Fig. 3", bent),
    }


def _turn(x_gain: float, x_offset: float, y_gain: float, y_offset: float) -> np.ndarray:
    angle = np.radians(np.arange(361.0))
    x = x_offset + x_gain * HORIZONTAL_GAUSS * np.cos(angle)
    y = y_offset - y_gain * HORIZONTAL_GAUSS * np.sin(angle)
    return np.column_stack([x, y]) + np.random.default_rng(3).normal(0.0, 0.001, (361, 2))


def _figure(target: Path, title: str, turn: np.ndarray) -> dict[str, Any]:
    import matplotlib.pyplot as plt

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
