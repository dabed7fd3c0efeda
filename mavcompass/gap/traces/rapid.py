"""Effects that change from reading to reading: an offset that changes sign, a line of alternating current.

Averaged rows hide them. They are looked for in every reading, beside the slow rest of what the nominal
simulation leaves, and taken out before anything is averaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.replay.integrity import Readings
from mavcompass.gap.replay.rows import averaged
from mavcompass.gap.tables import usual
from mavcompass.gap.traces.scattered import excess_variance, quiet_variance
from mavcompass.simulation.effects import detected_by
from mavcompass.simulation.effects.effect import FREQUENCY, Detector

_FINER = 8
# How much nearer than its width in the spectrum the frequency of a line is sought.
_STEPS, _ROUNDS = 8, 3
_WAVES = (*(f"{wave}_{axis}" for wave in ("sin", "cos") for axis in "xyz"), FREQUENCY)


@dataclass(frozen=True, slots=True, eq=False)
class Rapid:
    """Hold an effect that was found in the single readings.

    Attributes:
        effect: its id; parameters: its values; sigma: their standard deviations.
        change_mgauss: what it adds to every reading, (M, 3).
    """

    effect: str
    parameters: dict[str, float]
    sigma: dict[str, float]
    change_mgauss: FloatArray

    @property
    def variance_mgauss2(self) -> float:
        """Return its mean square over readings and axes."""
        return float(np.mean(self.change_mgauss**2))


def find_rapid(readings: Readings, baseline: Readings | None, least_mgauss: float) -> Rapid | None:
    """Return the effect that holds most of the fast excess over the baseline's, or a clear line; else None.

    Of less than `least_mgauss` rms none is told.
    """
    if readings.quiet.sum() < 2 * usual.rapid.block:
        return None
    fast = _fast(readings)
    before = 0.0 if baseline is None else quiet_variance(baseline, _fast(baseline))
    excess = quiet_variance(readings, fast) - before
    line, clear = _line(readings, fast)
    clear = clear and line.variance_mgauss2 > least_mgauss**2 and not _is_in(baseline, line)
    toggling = _toggling(readings, fast)
    alternates = toggling.variance_mgauss2 > (1.0 - usual.rapid.simpler) * line.variance_mgauss2
    if excess <= least_mgauss**2:  # the baseline is as loud, by something else
        return None if not clear else toggling if alternates else line

    def share(rapid: Rapid) -> float:
        if rapid.variance_mgauss2 <= least_mgauss**2:
            return 0.0
        left = quiet_variance(readings, fast - _without_slow(readings, rapid.change_mgauss))
        return 1.0 - (left - before) / excess

    best = toggling if share(toggling) > max(share(line) - usual.rapid.simpler, 0.0) else line
    if share(best) > usual.rapid.share:
        return best
    if clear and (alternates or best is line):
        return toggling if alternates else line
    if share(best) < usual.rapid.beside_noise or baseline is None:
        return None
    return best if excess_variance(readings.without(best.change_mgauss), baseline) > 0.0 else None


def _fast(readings: Readings) -> FloatArray:
    error = np.where(readings.valid[:, None], np.nan_to_num(readings.error_mgauss), 0.0)
    return _without_slow(readings, error)


def _without_slow(readings: Readings, columns: FloatArray) -> FloatArray:
    """Return columns (M, k) without what lasts for seconds."""
    width = max(2 * round(0.5 * usual.rapid.slow_s / readings.period_s) + 1, 5)
    return columns - averaged(columns, width)


def _toggling(readings: Readings, fast: FloatArray) -> Rapid:
    """Fit an offset that changes sign with every reading.

    Readings that were lost are counted by the time; where the count errs a block of a dozen readings has the
    other sign.
    """
    count = np.concatenate([[0], np.cumsum(np.round(np.diff(readings.time_s) / readings.period_s))])
    sign = 1.0 - 2.0 * (count % 2)
    blocks = np.arange(len(fast)) // usual.rapid.block
    size = np.bincount(blocks, readings.valid)
    sums = np.stack([np.bincount(blocks, sign * column * readings.valid) for column in fast.T], axis=1)
    _, vectors = np.linalg.eigh((sums / np.maximum(size, 1.0)[:, None]).T @ sums)
    sign = sign * np.where(sums @ vectors[:, -1] < 0.0, -1.0, 1.0)[blocks]
    offset, sigma = _fitted(readings, sign[:, None], fast)
    return _rapid("alternation", ("x", "y", "z"), offset[0], sigma[0], sign[:, None] * offset)


def _line(readings: Readings, fast: FloatArray) -> tuple[Rapid, bool]:
    """Fit a sine of one frequency: what stands out from its neighbours in the spectrum, then closer by least
    squares. A vehicle that swings is loud as well, and broad; one that drives laps has its motion's lines.

    Returns it, and whether it is no noise, no swing and nothing of the motion's.
    """
    time, rows = readings.time_s, readings.valid
    since = time - time[0]
    hertz, power = _spectrum(readings, fast)
    if not hertz.size:
        return _rapid("line", _WAVES, np.zeros(7), np.zeros(7), np.zeros_like(fast)), False
    width = 1.0 / float(since[-1])
    nominal = np.where(rows[:, None], np.nan_to_num(readings.nominal_mgauss), 0.0)
    motion = _loudest_near(_spectrum(readings, _without_slow(readings, nominal))[1], hertz, width)
    own, outstanding = motion > usual.line.its_motion * power, power / _neighbours(hertz, power, width)
    loudest = int(np.argmax(np.where(outstanding > usual.line.no_noise, power, 0.0)))
    # Beside a line of the motion's, what that makes of other errors has lines at its harmonics.
    loud = bool(outstanding[loudest] > usual.line.no_noise and not own[loudest])
    at = loudest if loud else int(np.argmax(np.where(own, 0.0, outstanding)))
    # And a load that comes and goes evenly has several.
    others = (
        (outstanding > usual.line.no_noise) & ~own & (np.abs(hertz - hertz[at]) > usual.line.skirts * width)
    )
    clear = loud and float(power[others].max(initial=0.0)) < usual.line.alone * power[at]
    best = float(hertz[at])
    for _ in range(_ROUNDS):
        tried = best + width * np.linspace(-1.0, 1.0, 2 * _STEPS + 1)
        best = float(tried[int(np.argmin([_left(_waves(since, f)[rows], fast[rows]) for f in tried]))])
        width /= _STEPS
    # The catalogue counts the phase on the recording's own clock.
    columns = _waves(time, best)
    waves, _ = _fitted(readings, columns, fast)
    doubt = _line_doubt(readings, columns, waves, fast)
    return _rapid("line", _WAVES, np.append(waves.ravel(), best), doubt, columns @ waves), clear


def _line_doubt(readings: Readings, columns: FloatArray, waves: FloatArray, fast: FloatArray) -> FloatArray:
    """Return the sigmas of a line's values (7,): what its frequency may be off by turns its phase.

    Of a sine's sums alone the sigma at the clock's zero is half as wide as it ought to be, or less
    (Rife and Boorstyn, IEEE Trans. Inf. Theory 20, 1974).
    """
    rows = readings.valid
    design = _without_slow(readings, columns)[rows]
    # The derivative of sin and cos by the frequency; the time is counted from the clock's zero.
    turning = (
        2.0 * math.pi * readings.time_s[:, None] * (columns[:, 1:] * waves[0] - columns[:, :1] * waves[1])
    )
    turning = _without_slow(readings, turning)[rows]
    noise = np.maximum(np.std(fast[rows] - design @ waves, axis=0), 1e-9)
    normal = np.zeros((7, 7))
    for axis in range(3):
        own = np.column_stack([design, turning[:, axis]]) / noise[axis]
        place = np.ix_([axis, 3 + axis, 6], [axis, 3 + axis, 6])
        normal[place] += own.T @ own
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    covariance = np.linalg.pinv(normal / np.outer(size, size)) / np.outer(size, size)
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _spectrum(readings: Readings, fast: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (K,) at which a line may lie, and the mean square of a sine there."""
    rows, since = readings.valid, readings.time_s - readings.time_s[0]
    step = readings.period_s / _FINER
    at = np.round(since / step).astype(np.int64)
    length = int(2 ** math.ceil(math.log2(2 * at[-1] + 1)))  # half a width apart: no line lies far between
    power = np.zeros(length // 2 + 1)
    for column in fast.T:
        power += np.abs(np.fft.rfft(np.bincount(at, column * rows, minlength=length))) ** 2
    hertz = np.asarray(np.fft.rfftfreq(length, step), np.float64)
    within = (hertz > usual.line.lowest_hz) & (hertz < 0.5 / readings.period_s)
    return hertz[within], power[within] * 2.0 / (3.0 * max(int(rows.sum()), 1) ** 2)


def _is_in(baseline: Readings | None, line: Rapid) -> bool:
    """Tell whether a baseline holds the same line."""
    if baseline is None:
        return False
    hertz, power = _spectrum(baseline, _fast(baseline))
    near = np.abs(hertz - line.parameters[FREQUENCY]) < 2.0 / float(np.ptp(baseline.time_s))
    return bool((power[near] > usual.line.its_own * line.variance_mgauss2).any())


def _neighbours(hertz: FloatArray, power: FloatArray, width_hz: float) -> FloatArray:
    """Return a spectrum's (K,) usual power near each frequency: medians of bands, joined by lines."""
    bands = np.array_split(np.arange(hertz.size), max(int(np.ptp(hertz) / (usual.line.band * width_hz)), 1))
    medians = [np.median(power[band]) for band in bands]
    return np.maximum(np.interp(hertz, [hertz[band].mean() for band in bands], medians), 1e-12)


def _loudest_near(power: FloatArray, hertz: FloatArray, width_hz: float) -> FloatArray:
    """Return the greatest power within two widths of a line around each frequency, (K,)."""
    reach = max(round(2.0 * width_hz * hertz.size / float(np.ptp(hertz))), 1)
    padded = np.pad(power, reach, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1))


def _waves(time_s: FloatArray, hertz: float) -> FloatArray:
    phase = 2.0 * math.pi * hertz * time_s
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def _left(columns: FloatArray, values: FloatArray) -> float:
    """Return the sum of squares that columns (M, k) leave of values (M, 3)."""
    best = np.linalg.solve(columns.T @ columns, columns.T @ values)
    return float(np.sum((values - columns @ best) ** 2))


def _fitted(readings: Readings, columns: FloatArray, fast: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit columns (M, k) without their slow part to what is fast (M, 3); return values and sigmas (k, 3)."""
    rows = readings.valid
    design = _without_slow(readings, columns)[rows]
    covariance = np.linalg.inv(design.T @ design)
    values = covariance @ design.T @ fast[rows]
    noise = np.std(fast[rows] - design @ values, axis=0)
    return values, np.sqrt(np.diag(covariance))[:, None] * noise


def _rapid(
    shown: Detector, names: tuple[str, ...], values: FloatArray, sigma: FloatArray, change: FloatArray
) -> Rapid:
    return Rapid(
        detected_by(shown).id,
        dict(zip(names, values.tolist(), strict=True)),
        dict(zip(names, sigma.tolist(), strict=True)),
        np.asarray(change),
    )
