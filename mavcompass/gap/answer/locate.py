"""Where the gap lies: its share along each coordinate, per channel; and what the report draws of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, matrix_to_euler
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import heading_error_rad
from mavcompass.gap.replay import group_values
from mavcompass.gap.result import Picture, Place

_BINS = 12
_REPORTED = 16


def coordinates(problem: Problem) -> dict[str, tuple[FloatArray, str]]:
    """Return the coordinates that the recording has: values (N,), and their unit."""
    s = problem.replay.signals.stimulus
    yaw = matrix_to_euler(s.rotation)[2]
    found: dict[str, tuple[FloatArray, str]] = {
        "heading": (np.degrees(yaw % (2.0 * math.pi)), "deg"),
        "tilt": (np.degrees(np.arccos(np.clip(s.rotation[:, 2, 2], -1.0, 1.0))), "deg"),
        "time": (s.time_s, "s"),
        "rate": (np.degrees(np.linalg.norm(s.rate_radps, axis=1)), "deg/s"),
    }
    for name, values, unit in (
        ("current", s.current_a, "A"),
        ("throttle", s.throttle, ""),
        ("temperature", s.temperature_degc, "degC"),
    ):
        found[name] = (values, unit)
    position = s.position_ned_m
    if np.isfinite(position).all():
        found["position"] = (np.linalg.norm(position - position.mean(axis=0), axis=1), "m from the middle")
    return {n: (v, u) for n, (v, u) in found.items() if np.isfinite(v).all() and float(np.std(v)) > 1e-9}


def channels(problem: Problem, fit: Fit) -> dict[str, FloatArray]:
    """Return nominal residuals in units of the floor, by channel, (n,) on usable rows."""
    nominal = problem.predict(fit, effects=False)
    out: dict[str, FloatArray] = {}
    rows = problem.usable
    for group in problem.groups:
        error = group_values(problem.replay.measured, group) - group_values(nominal, group)
        for axis, letter in enumerate("xyz"):
            out[f"{group}_{letter}"] = error[rows, axis] / problem.noise[group].rms[axis]
    heading = heading_error_rad(problem.replay, problem.replay.measured.mag_mgauss, nominal.mag_mgauss)
    field = problem.replay.signals.stimulus.field_ned_mgauss[0]
    sigma = float(np.mean(problem.noise["mag"].rms)) / max(float(np.hypot(field[0], field[1])), 1.0)
    out["heading"] = heading[rows] / sigma
    return out


def where(problem: Problem, fit: Fit) -> tuple[Place, ...]:
    """Rank (channel, coordinate): the share of the excess that binned means along the coordinate hold.

    The share is (between-bin sum of squares less its expectation) / (sum of squares less n), of all
    that exceeds the floor in the sensor's three channels. `frequency` is what no coordinate explains at
    low order: the share above a fifth of half the sampling rate.
    """
    rows = problem.usable
    residuals = channels(problem, fit)
    excess = {name: max(float(r @ r) - r.size, 0.0) for name, r in residuals.items()}
    sensors = {name.split("_")[0] for name in excess}
    total = {g: sum(e for name, e in excess.items() if name.split("_")[0] == g) for g in sensors}
    found = []
    for channel, residual in residuals.items():
        whole = total[channel.split("_")[0]]
        if whole <= 4.0 * math.sqrt(6.0 * residual.size) or excess[channel] <= 0.0:
            continue
        axis_share = excess[channel] / whole
        if channel != "heading":
            found.append(Place(channel, "axis", min(axis_share, 1.0), channel.split("_")[1]))
        for name, (values, unit) in coordinates(problem).items():
            share, at = _between(values[rows], residual, unit)
            found.append(Place(channel, name, float(np.clip(share / whole, 0.0, 1.0)), at))
        power = np.abs(np.fft.rfft(residual)) ** 2
        fast = power[power.size // 5 :].sum() / max(float(power[1:].sum()), 1e-12)
        part = max(float(fast) * float(residual @ residual) - 0.8 * residual.size, 0.0)
        found.append(Place(channel, "frequency", float(np.clip(part / whole, 0.0, 1.0)), "fast"))
    found.sort(key=lambda place: -place.share)
    return tuple(p for p in found if p.share > 0.02)[:_REPORTED]


def bin_means(values: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres, means and counts of the residual in bins of equal width along a coordinate."""
    edges = np.linspace(float(values.min()), float(values.max()) + 1e-9, _BINS + 1)
    label = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(label, minlength=_BINS).astype(np.float64)
    mean = np.bincount(label, residual, minlength=_BINS) / np.maximum(count, 1.0)
    return 0.5 * (edges[1:] + edges[:-1]), mean, count


def _between(values: FloatArray, residual: FloatArray, unit: str) -> tuple[float, str]:
    # A constant offset belongs to the axis, not to every coordinate.
    centres, mean, count = bin_means(values, residual - residual.mean())
    squares = count * mean**2
    used = int((count > 0).sum())
    top = int(np.argmax(np.where(count >= 5, np.abs(mean), 0.0)))
    return float(squares.sum()) - used, f"{centres[top]:.3g} {unit}".strip()


def picture(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> Picture:
    """Collect what the report draws."""
    replay = problem.replay
    before = replay.measured.mag_mgauss - problem.predict(fit, effects=False).mag_mgauss
    predicted = problem.predict(fit)
    return Picture(
        time_s=replay.time_s,
        valid=replay.valid,
        test=test,
        before_mgauss=before,
        after_mgauss=replay.measured.mag_mgauss - predicted.mag_mgauss,
        coordinates=coordinates(problem),
        floor_mgauss=problem.noise["mag"].rms,
        innovations=problem.innovations(predicted)["mag"],
    )
