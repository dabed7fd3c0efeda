"""What changes from reading to reading: scatter, an offset that changes sign, a line of alternating current.

Averaged rows hide them. They are looked for in every reading, beside the slow rest of what the nominal
simulation leaves; effects are taken out before anything is averaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.replay.integrity import Readings
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import detected_by
from mavcompass.simulation.effects.effect import FREQUENCY, Detector

# Second differences of white noise so many readings apart have no reading in common. Their correlation is
# zero but for chance (within three sigmas), whose variance over their number is 1 + 2 (4/6)^2 + 2 (1/6)^2
# (Bartlett, Suppl. J. Royal Stat. Soc. 8, 1946).
_OF_NEIGHBOURS = 35.0 / 18.0
_LAGS, _BY_CHANCE = (3, 4, 5), 3.0 * math.sqrt(_OF_NEIGHBOURS)


def quiet_variance(readings: Readings, values: FloatArray) -> float:
    """Return the mean square of columns (M, 3) over the quieter readings."""
    return float(np.mean(values[readings.quiet] ** 2)) if readings.quiet.any() else 0.0


def excess_variance(readings: Readings, baseline: Readings, repeats: bool = False) -> float:
    """Return the variance of white scatter in excess of the baseline's, mG^2, while the field hardly turns.

    What `repeats` is read at uneven times, and scatters by nature. 0 where it is not much more, and where it
    is no noise: fast changes that follow each other, or come in bursts.
    """
    now, before = quiet_scatter(readings), quiet_scatter(baseline)
    excess = now**2 - before**2
    quiet = float(readings.quiet.mean()) > usual.scatter.least_quiet and not repeats
    least = usual.scatter.doubtful if quiet else usual.scatter.never_quiet
    if excess <= least * max(before, 1e-9) ** 2:
        return 0.0
    # White noise scatters as much between readings further apart. Of the two estimates the larger one is
    # nearer: what wanders in the baseline is taken off both.
    further = quiet_scatter(readings, 2) ** 2 - quiet_scatter(baseline, 2) ** 2
    white = excess / usual.scatter.unlike < further < usual.scatter.unlike * excess
    noise = white and _unrelated(readings) and _steady(readings, excess) and _of_each_axis(readings)
    along = (
        _usual(_along_field(readings)[readings.quiet]) ** 2
        - _usual(_along_field(baseline)[baseline.quiet]) ** 2
    )
    return max(excess, further) if noise and along > usual.scatter.along * excess else 0.0


def burst_mgauss(readings: Readings, baseline: Readings) -> float:
    """Return what scatters from reading to reading and is no noise of the sensor, rms, in mG.

    Single readings that stand far off both neighbours; or, where the vehicle hardly swings in either
    recording, a scatter whose variance along the field is more than twice the baseline's. 0 where there are
    not far more such readings than in the baseline, or than a few that went wrong.
    """
    (now, along), (before, beside) = _off_neighbours(readings), _off_neighbours(baseline)
    share, size = _standing_off(now)
    burst = size if share > max(usual.bursts.few_wrong, usual.bursts.more * _standing_off(before)[0]) else 0.0
    if min(len(now) / len(readings.valid), len(before) / len(baseline.valid)) < usual.bursts.even:
        return burst
    if np.mean(along**2) <= (1.0 + usual.scatter.doubtful) * np.mean(beside**2):
        return burst
    return max(burst, math.sqrt(max(float(np.mean(now**2) - np.mean(before**2)), 0.0)))


def _off_neighbours(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return by how much readings are off both neighbours, (M, 3) and along the field (M,), of those while
    the field turns evenly: late readings stand off where a turn begins and ends."""
    both = readings.valid.copy()
    both[1:-1] &= readings.valid[:-2] & readings.valid[2:]
    both[[0, -1]] = False
    off = np.abs(neighbours(readings.error_mgauss))
    swings = np.linalg.norm(neighbours(readings.nominal_mgauss), axis=1)
    beside = np.max(
        [np.roll(swings, shift) for shift in range(-usual.bursts.beside, usual.bursts.beside + 1)], axis=0
    )
    both &= beside < float(np.linalg.norm(_usual(off[both])))
    return off[both], _along_field(readings)[both]


def _standing_off(off: FloatArray) -> tuple[float, float]:
    """Return the share of readings (M, 3) that are off by many times what most are, on any axis, and what
    they add to the rms of all, in mG."""
    if len(off) <= usual.scatter.fewest:
        return 0.0, 0.0
    most = _usual(off)
    # Of coarse numbers most differ by nothing.
    far = np.any(off > np.where(most > 0.0, usual.bursts.far_off * most, np.inf), axis=1)
    return float(far.mean()), float(np.sqrt(np.mean((off * far[:, None]) ** 2)))


def quiet_doubt(readings: Readings) -> float:
    """Return how far the square of `quiet_scatter` may be off, 1 sigma, as a share of it.

    A median tells a normal deviation as well as 0.37 times as many squares would; of second differences.
    """
    count = 3.0 * float(readings.quiet.sum())
    return math.sqrt(2.0 * _OF_NEIGHBOURS / (0.37 * max(count, 1.0)))


def quiet_scatter(readings: Readings, apart: int = 1) -> float:
    """Return the scatter between readings some steps apart in mG, robustly, on the quieter ones."""
    both = readings.quiet.copy()
    both[:apart] = both[both.size - apart :] = False
    if both.sum() <= usual.scatter.fewest:
        return 0.0
    return float(np.sqrt(np.mean(_usual(neighbours(readings.error_mgauss, apart)[both]) ** 2)))


def neighbours(error_mgauss: FloatArray, apart: int = 1) -> FloatArray:
    """Return second differences of columns (N, 3), scaled to white noise's deviation; zero at the ends."""
    out = np.zeros_like(error_mgauss)
    k = apart
    if len(out) > 2 * k:
        out[k:-k] = error_mgauss[2 * k :] - 2.0 * error_mgauss[k:-k] + error_mgauss[: -2 * k]
    return out / math.sqrt(6.0)


def _usual(values: FloatArray) -> FloatArray:
    """Return the deviation of columns (M, ...), robustly; 0 where there are none."""
    return (
        np.asarray(1.4826 * np.median(np.abs(values), axis=0)) if len(values) else np.zeros(values.shape[1:])
    )


def _along_field(readings: Readings) -> FloatArray:
    """Return second differences along the field, (N,), scaled to white noise's deviation.

    An attitude that shakes faster than its gyro is read turns the field, and leaves nothing there.
    """
    field = readings.nominal_mgauss
    product = np.einsum("ij,ij->i", neighbours(readings.error_mgauss), field)
    return np.asarray(product / np.maximum(np.linalg.norm(field, axis=1), 1e-9))


def _unrelated(readings: Readings) -> bool:
    """Tell whether no reading's scatter follows others': a vehicle's swing, seen by a slow compass, does."""
    second, quiet = neighbours(readings.error_mgauss), readings.quiet
    for lag in _LAGS:
        both = quiet[lag:] & quiet[:-lag]
        one, other = second[lag:][both], second[:-lag][both]
        size = math.sqrt(float(np.sum(one**2) * np.sum(other**2)))
        related = max(usual.scatter.related, _BY_CHANCE / math.sqrt(max(one.size, 1)))
        if both.sum() > usual.scatter.fewest and abs(float(np.sum(one * other))) > related * size:
            return False
    return True


def _of_each_axis(readings: Readings) -> bool:
    """Tell whether each axis scatters by itself: what changes all of them together is one thing's field."""
    second = neighbours(readings.error_mgauss)[readings.quiet]
    square = second.T @ second
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    return bool(np.abs(np.triu(square / np.outer(size, size), 1)).max() < usual.scatter.together)


def _steady(readings: Readings, excess: float) -> bool:
    """Tell whether the scatter stays alike all the time."""
    square = np.mean(neighbours(readings.error_mgauss)[readings.quiet] ** 2, axis=1)
    spans = [
        float(np.mean(part))
        for part in np.array_split(square, usual.scatter.spans)
        if part.size >= usual.scatter.fewest
    ]
    return not spans or max(spans) < usual.scatter.unsteady * max(min(spans), 0.25 * excess)


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
    likeliest = toggling if alternates else line
    if excess <= least_mgauss**2:  # the baseline is as loud, by something else
        return likeliest if clear else None

    def share(rapid: Rapid) -> float:
        if rapid.variance_mgauss2 <= least_mgauss**2:
            return 0.0
        left = quiet_variance(readings, fast - _without_slow(readings, rapid.change_mgauss))
        return 1.0 - (left - before) / excess

    best = toggling if share(toggling) > max(share(line) - usual.rapid.simpler, 0.0) else line
    if share(best) > usual.rapid.share:
        return best
    if clear and (alternates or best is line):
        return likeliest
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
