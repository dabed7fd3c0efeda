"""The world's field is not what the model says: anomalies, gradients, a magnet at one place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, rotate
from mavcompass.simulation.effects.effect import (
    NEVER_S,
    Effect,
    Memory,
    Misfit,
    Parameter,
    Rng,
    Signals,
    Stage,
    axes,
)
from mavcompass.simulation.effects.sampling import or_zero

_NEAREST_M = 0.05
_NEAR_PEAK_M = 0.4
_FAR_PATHS = 3.0
_DEPTHS_M, _STRONGEST = (2.0, 5.0, 10.0, 20.0, 50.0), 1000.0
_CLOSE_M, _CLOSE_SHARE, _MOST_CLIMBS = 0.01, 1.0 / 32.0, 12
_ROWS, _APART = 200, 0.05
_PLACES_AT_ONCE = 64  # whose rows together stay in the processor's cache
_MOMENT = ("moment_north", "moment_east", "moment_down")


def _intensity(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    return signals.in_field(signals.stimulus.field_ned_mgauss * (1.0 + theta[0]))


def _inclination(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    field = signals.stimulus.field_ned_mgauss
    horizontal = np.maximum(np.hypot(field[:, 0], field[:, 1]), 1e-9)
    c, s = math.cos(theta[0]), math.sin(theta[0])
    level = horizontal * c - field[:, 2] * s
    down = horizontal * s + field[:, 2] * c
    ratio = level / horizontal
    return signals.in_field(np.stack([field[:, 0] * ratio, field[:, 1] * ratio, down], axis=1))


def _declination(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    n, e, d = signals.stimulus.field_ned_mgauss.T
    c, s = math.cos(theta[0]), math.sin(theta[0])
    return signals.in_field(np.stack([c * n - s * e, s * n + c * e, d], axis=1))


def gradient_matrix(theta: FloatArray) -> FloatArray:
    """Return the gradient (3, 3) of a field without curl and divergence."""
    nn, ee, ne, nd, ed = theta
    return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, -nn - ee]])


def gradient_origin(position_m: FloatArray) -> FloatArray:
    """Return where a gradient begins to count: at the datum, or at the first place of a path far from it.

    Heights above the sea or grid coordinates are no distance from what bends the field.
    """
    known = position_m[np.isfinite(position_m).all(axis=1)]
    if not len(known) or float(np.linalg.norm(known[0])) <= _FAR_PATHS * float(known.std(axis=0).max()):
        return np.zeros(3)
    return np.asarray(known[0])


def _gradient(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    position = signals.stimulus.position_ned_m
    if "origin" not in memory:
        memory["origin"] = gradient_origin(position)
    away = or_zero(position - memory["origin"])
    return signals.in_field(signals.stimulus.field_ned_mgauss + away @ gradient_matrix(theta))


def _height_anomaly(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    height = np.maximum(-or_zero(signals.stimulus.position_ned_m[:, 2]), 0.0)
    share = (theta[3] / (height + theta[3])) ** 3
    return signals.in_field(signals.stimulus.field_ned_mgauss + share[:, None] * theta[:3])


def _height_starts(misfit: Misfit) -> list[FloatArray]:
    """Scan the depth; the field is linear in each, beside a constant that belongs to the place."""
    rows = np.flatnonzero(misfit.rows)
    if rows.size < 40:
        return []
    height = np.maximum(-or_zero(misfit.signals.stimulus.position_ned_m[rows, 2]), 0.0)
    residual = rotate(misfit.signals.stimulus.rotation[rows], misfit.residual.mag_mgauss[rows])
    found = []
    for depth in _DEPTHS_M:
        share = (depth / (height + depth)) ** 3
        design = np.column_stack([share, np.ones(rows.size)])
        solved, left, _, _ = np.linalg.lstsq(design, residual, rcond=None)
        if left.size:
            found.append((float(left.sum()), np.array([*np.clip(solved[0], -_STRONGEST, _STRONGEST), depth])))
    return [start for _, start in sorted(found, key=lambda one: one[0])[:2]]


def dipole_field(position_m: FloatArray, source_m: FloatArray, moment_mgauss_m3: FloatArray) -> FloatArray:
    """Return the field (N, 3) of a dipole: (3 u (u . m) - m) / r^3."""
    offset = position_m - source_m
    distance = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset), _NEAREST_M**2))[:, None]
    unit = offset / distance
    return np.asarray((3.0 * unit * (unit @ moment_mgauss_m3)[:, None] - moment_mgauss_m3) / distance**3)


def _dipole(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    position = or_zero(signals.stimulus.position_ned_m)
    field = dipole_field(position, theta[:3], theta[3:6])
    time = signals.stimulus.time_s
    if theta[6] > -NEVER_S or theta[7] < NEVER_S:
        field = field * ((time >= theta[6]) & (time < theta[7]))[:, None]
    return signals.in_field(signals.stimulus.field_ned_mgauss + field)


def _dipole_starts(misfit: Misfit) -> list[FloatArray]:
    """Scan a grid of places around the path; the moment is linear in each."""
    everywhere = np.flatnonzero(misfit.rows)
    if everywhere.size < 40:
        return []
    starts = _placed(misfit, everywhere, -NEVER_S)
    # The magnet may have been put there while the recording ran: try the moments of the largest jumps.
    residual = misfit.residual.mag_mgauss
    for moment in _jumps(misfit, everywhere, residual):
        starts += _placed(misfit, everywhere[misfit.time_s[everywhere] >= moment], moment)[:1]
    return starts + [
        taken for start in starts if (taken := _taken_away(misfit, everywhere, start)) is not None
    ]


def _taken_away(misfit: Misfit, rows: NDArray[np.int64], start: FloatArray) -> FloatArray | None:
    """Let a dipole end where the residual without it jumps from nothing to much; None where it does not."""
    before = misfit.signals
    made = _dipole(before, start, {}, None).reading.mag_mgauss - before.reading.mag_mgauss
    moments = [m for m in _jumps(misfit, rows, misfit.residual.mag_mgauss - made) if m > start[6]]
    if not moments:
        return None
    return np.array([*start[:7], moments[0]])


def _jumps(misfit: Misfit, rows: NDArray[np.int64], residual: FloatArray) -> list[float]:
    """Return the two moments at which the mean residual of the second before and after differs most."""
    time = misfit.time_s[rows]
    half = max(4, int(1.0 / max(float(np.median(np.diff(time))), 1e-3)))
    if rows.size < 4 * half:
        return []
    total = np.vstack([np.zeros(3), np.cumsum(residual[rows], axis=0)])
    middle = np.arange(half, rows.size - half)
    mean_after = (total[middle + half] - total[middle]) / half
    mean_before = (total[middle] - total[middle - half]) / half
    # Quiet before: what passes by is no jump.
    jump = np.linalg.norm(mean_after, axis=1) - 3.0 * np.linalg.norm(mean_before, axis=1)
    found = []
    for _ in range(2):
        best = int(np.argmax(jump))
        if jump[best] <= 0.0:
            break
        found.append(float(time[middle[best]]))
        jump[max(0, best - 3 * half) : best + 3 * half] = 0.0
    return found


def _placed(misfit: Misfit, everywhere: NDArray[np.int64], on_s: float) -> list[FloatArray]:
    """Find places and moments of a dipole that is there from a moment on."""
    if everywhere.size < 40:
        return []
    size = np.linalg.norm(misfit.residual.mag_mgauss[everywhere], axis=1)
    # A short passage must not slip through: half of the rows are those with the largest residuals.
    strongest = everywhere[np.argsort(-size)[:_ROWS]]
    rows = np.union1d(everywhere[:: max(1, everywhere.size // _ROWS)], strongest)
    position = or_zero(misfit.signals.stimulus.position_ned_m[rows])
    residual = rotate(misfit.signals.stimulus.rotation[rows], misfit.residual.mag_mgauss[rows])
    low, high = position.min(axis=0), position.max(axis=0)
    reach = max(0.5 * float((high - low).max()), 0.3)
    axes = [np.linspace(a - reach, b + reach, 7) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    peak = or_zero(misfit.signals.stimulus.position_ned_m[strongest[:40]]).mean(axis=0)
    near = np.linspace(-_NEAR_PEAK_M, _NEAR_PEAK_M, 5)
    grid = np.vstack([grid, peak + np.stack(np.meshgrid(near, near, near), axis=-1).reshape(-1, 3)])
    gains, _ = _dipoles(position, residual, grid)
    sources = _polished(position, residual, grid[np.argsort(-gains)[:3]], reach / 3.0)
    gains, moments = _dipoles(position, residual, sources)
    starts: list[FloatArray] = []
    for gain, source, moment in zip(gains, sources, moments, strict=True):
        # Two that climbed to the same place are one.
        if gain > 0.0 and all(np.linalg.norm(source - s[:3]) > _APART * reach for s in starts):
            starts.append(np.array([*source, *np.clip(moment, -1e4, 1e4), on_s, NEVER_S]))
    return starts[:2]


def _polished(position: FloatArray, residual: FloatArray, sources: FloatArray, step_m: float) -> FloatArray:
    """Climb from places (M, 3) to better ones, all of them abreast, as near as a fit needs to begin.

    Each goes to the top of parabolas through its neighbours, or to the best of these, and looks nearer once
    the top is among them.
    """
    gains, _ = _dipoles(position, residual, sources)
    steps, several = np.full(len(sources), step_m), np.arange(len(sources))
    sides = np.concatenate([-np.eye(3), np.eye(3)])[:, None]
    for _ in range(_MOST_CLIMBS):
        climbing = steps > max(_CLOSE_M, _CLOSE_SHARE * step_m)
        if not climbing.any():
            break
        around = sources + steps[:, None] * sides
        beside = _dipoles(position, residual, around.reshape(-1, 3))[0].reshape(6, -1)
        slope, bend = beside[3:] - beside[:3], beside[3:] + beside[:3] - 2.0 * gains
        top = np.where(bend < 0.0, -0.5 * slope / np.where(bend < 0.0, bend, 1.0), np.sign(slope)).T
        shift = np.clip(top, -1.0, 1.0)
        there = sources + steps[:, None] * shift
        trials = np.concatenate([sources[None], around, there[None]])
        all_gains = np.vstack([gains, beside, _dipoles(position, residual, there)[0]])
        best = np.where(climbing, np.argmax(all_gains, axis=0), 0)
        sources, gains = trials[best, several], all_gains[best, several]
        at_top, far = best == len(trials) - 1, np.abs(shift).max(axis=1)
        near = (best == 0) | (at_top & (far < 0.5))
        steps *= np.where(near, 0.5, np.where(at_top & (far == 1.0), 2.0, 1.0))
    return sources


def _dipoles(
    position: FloatArray, residual: FloatArray, sources: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how much of the sum of squares a dipole at each place (M, 3) takes away, and its moment.

    With u = offset / r, A_i = (3 u u^T - I) / r^3 is symmetric, and A^T A = (3 u u^T + I) / r^6. Sums over
    offsets p - s are those over the places p, which are the same for all sources s.
    """
    middle = position.mean(axis=0)
    position, sources = position - middle, sources - middle
    squares, with_residual = np.square(position).sum(axis=1), (position * residual).sum(axis=1)
    products = (position[:, :, None] * position[:, None, :]).reshape(-1, 9)
    sums = np.column_stack([products, position, np.ones(len(position))])
    gains, moments = [], []
    for some in np.array_split(sources, -(-len(sources) // _PLACES_AT_ONCE)):
        square = squares - 2.0 * some @ position.T + np.square(some).sum(axis=1)[:, None]
        square = np.maximum(square, _NEAREST_M**2)
        w3 = 1.0 / (square * np.sqrt(square))
        w5 = w3 / square
        of = (w3 * w5) @ sums
        mixed = of[:, 9:12, None] * some[:, None, :]
        normal = of[:, :9].reshape(-1, 3, 3) - mixed - mixed.transpose(0, 2, 1)
        normal = 3.0 * (normal + of[:, 12, None, None] * some[:, :, None] * some[:, None, :])
        normal += (np.square(w3).sum(axis=1) + 1e-12)[:, None, None] * np.eye(3)
        along = (with_residual - some @ residual.T) * w5
        right = 3.0 * (along @ position - along.sum(axis=1)[:, None] * some) - w3 @ residual
        solved = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        gains.append((right * solved).sum(axis=1))
        moments.append(solved)
    return np.concatenate(gains), np.concatenate(moments)


_GRADIENT_SCRIPT = """add_place(b, 0, 0, 0, function(x, y, z)
      return {nn:.6g} * x + {ne:.6g} * y + {nd:.6g} * z, {ne:.6g} * x + {ee:.6g} * y + {ed:.6g} * z,
        {nd:.6g} * x + {ed:.6g} * y - ({nn:.6g} + {ee:.6g}) * z
    end)"""
_DIPOLE_SCRIPT = """if during({on_s:.3f}, {off_s:.3f}) then
      add_place(b, {north_m:.4f}, {east_m:.4f}, {down_m:.4f}, function(x, y, z)
        local r = math.sqrt(math.max(x * x + y * y + z * z, 0.0025))
        local mn, me, md = {moment_north:.6g}, {moment_east:.6g}, {moment_down:.6g}
        local along, cube = 3 * (x * mn + y * me + z * md) / (r * r), r * r * r
        return (x * along - mn) / cube, (y * along - me) / cube, (z * along - md) / cube
      end)
    end"""

EFFECTS = (
    Effect(
        id="field_intensity",
        title="the field is stronger or weaker than the model says",
        stage=Stage.WORLD,
        parameters=(Parameter("fraction", "1", -0.5, 0.5, 0.04, 0.01),),
        forward=_intensity,
        aliases=("axis_scale", "temperature_sensitivity"),
        separated_by="a second site or an absolute reference: it is an equal scale of all axes exactly",
        source="B (1 + e), 1 to 10 % near iron and in the crust",
    ),
    Effect(
        id="inclination",
        title="the field dips more or less than the model says",
        stage=Stage.WORLD,
        parameters=(Parameter("angle_rad", "rad", -0.35, 0.35, 0.04, 0.01),),
        forward=_inclination,
        aliases=("axis_scale", "platform_tilt"),
        separated_by="tilt",
        source="B turned about the magnetic east axis, 0.2 to 10 degrees; down positive",
    ),
    Effect(
        id="declination",
        about_vertical=True,
        title="the field points elsewhere than the model says",
        stage=Stage.WORLD,
        parameters=(Parameter("angle_rad", "rad", -0.6, 0.6, 0.06, 0.01),),
        forward=_declination,
        aliases=("misalignment", "attitude_reference_error"),
        separated_by="tilt, and a yaw that does not come from a compass",
        source="B turned about the vertical, 0.2 to 20 degrees; east positive",
    ),
    Effect(
        id="field_gradient",
        title="the field changes evenly with the place",
        stage=Stage.WORLD,
        parameters=axes(
            -500.0, 500.0, (12.0, -8.0, 5.0, 6.0, -4.0), 5.0, "mG/m", ("nn", "ee", "ne", "nd", "ed")
        ),
        forward=_gradient,
        needs=frozenset({"position"}),
        aliases=("height_anomaly", "spatial_dipole"),
        separated_by="a larger area",
        source="B + G (p - p_0), G symmetric without trace (no curl, no divergence), 5 to 50 mG/m indoors",
        lua=_GRADIENT_SCRIPT.format_map,
    ),
    Effect(
        id="height_anomaly",
        title="a field of the ground that falls with height",
        stage=Stage.WORLD,
        parameters=(
            *axes(-_STRONGEST, _STRONGEST, (60.0, -30.0, 80.0), 20.0, "mG", ("north", "east", "down")),
            Parameter("depth_m", "m", 0.5, 200.0, 10.0, 3.0),
        ),
        forward=_height_anomaly,
        needs=frozenset({"height"}),
        aliases=("field_gradient", "spatial_dipole"),
        separated_by="the same heights at another place",
        source="B (d / (h + d))^3, d the depth of what makes it; ArduPilot's SIM_MAG_ALY",
        starts=_height_starts,
        sitl=lambda v: {
            **{f"SIM_MAG_ALY_{a}": v[name] for a, name in zip("XYZ", ("north", "east", "down"), strict=True)},
            "SIM_MAG_ALY_HGT": v["depth_m"],
        },
    ),
    Effect(
        id="spatial_dipole",
        title="a magnet or iron at one place",
        stage=Stage.WORLD,
        parameters=(
            *axes(-1000.0, 1000.0, (1.0, 0.6, 0.3), 0.1, "m", ("north_m", "east_m", "down_m")),
            *axes(-1e4, 1e4, (40.0, -25.0, 60.0), 50.0, "mG m^3", _MOMENT),
            Parameter("on_s", "s", -NEVER_S, NEVER_S, -NEVER_S, 1.0, optional=True),
            Parameter("off_s", "s", -NEVER_S, NEVER_S, NEVER_S, 1.0, optional=True),
        ),
        forward=_dipole,
        needs=frozenset({"position"}),
        aliases=("field_gradient", "height_anomaly"),
        separated_by="pass the place again on another heading",
        source="(3 u (u . m) - m) / r^3",
        starts=_dipole_starts,
        lua=_DIPOLE_SCRIPT.format_map,
    ),
)
