"""One sound clock for a track: others work on grids over time, so a span must be one that samples bear out.

A time stamp is a number in a file, and may be any. A quantity whose samples all share one moment, or came
faster than any sensor gives them, has no clock. And a recording lasts no longer than its samples can carry:
where it would, its longest silences are shortened, all to one length, as far as that takes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.track import Series, Track

# The sparsest telemetry brings a few samples a second, of all quantities together, and one a second at least;
# an hour of silence costs nobody much.
_LONGEST_A_SAMPLE_S, _ALWAYS_S = 1.0, 3600.0
# IMUs are sampled at 32 kHz at most, and logged more slowly.
_SHORTEST_A_SAMPLE_S = 1e-5


def with_sound_times(track: Track) -> Track:
    """Return the track, or one without what has no clock, its silences shortened; the notes tell of it."""
    clockless = {name for name, series in _series(track) if _is_clockless(series.time_s)}
    if clockless:
        track = _without(track, clockless)
    all_times = [series.time_s for _, series in _series(track)]
    samples = sum(times.size for times in all_times)
    most_s = max(_ALWAYS_S, _LONGEST_A_SAMPLE_S * samples)
    ends = [(times[0], times[-1]) for times in all_times]
    if not ends or max(end for _, end in ends) - min(start for start, _ in ends) <= most_s:
        return track
    return _shortened(track, np.unique(np.concatenate(all_times)), most_s)


def _series(track: Track) -> list[tuple[str, Series]]:
    return [(name, series) for name, series in track.columns() if len(series)]


def _is_clockless(times: FloatArray) -> bool:
    return times.size > 1 and bool(times[-1] - times[0] < _SHORTEST_A_SAMPLE_S * (times.size - 1))


def _without(track: Track, clockless: set[str]) -> Track:
    kept = track.with_columns(lambda name, series: None if name in clockless else series)
    named = ", ".join(name.rpartition("_")[0] or name for name in sorted(clockless))
    note = f"Left out {named}: the times of its samples are one and the same, or closer than any sensor's."
    return replace(kept, notes=(*track.notes, note))


def _shortened(track: Track, moments: FloatArray, most_s: float) -> Track:
    """Shorten the longest silences between `moments`, sorted, until all lasts `most_s` at the most."""
    silences = np.diff(moments)
    longest_s = _longest(silences, most_s)
    kept = np.minimum(silences, longest_s)
    # From the side where most was said, so that most times stay what they were.
    middle = int(np.searchsorted(moments, np.median(np.concatenate([s.time_s for _, s in _series(track)]))))
    since = np.concatenate([[0.0], np.cumsum(kept)])
    placed = since - since[middle]
    # So far from a boot that its numbers have no room for single samples, a time says nothing.
    if np.spacing(abs(moments[middle])) < _SHORTEST_A_SAMPLE_S:
        placed += moments[middle]

    def moved(times: FloatArray) -> FloatArray:
        return np.asarray(np.interp(times, moments, placed))

    count = int(np.count_nonzero(silences > longest_s))
    note = (
        f"{count} silences were shortened to {longest_s:.0f} s: the times of {moments.size} samples span"
        f" {moments[-1] - moments[0]:.3g} s, which is longer than they can carry."
    )
    return replace(track.with_times(moved), notes=(*track.notes, note))


def _longest(silences: FloatArray, most_s: float) -> float:
    """Return the length L such that silences, none longer than L, last `most_s` together."""
    ordered = np.sort(silences)
    # With the k shortest as they are, the others have (most - their sum) / (n - k) each.
    before = np.concatenate([[0.0], np.cumsum(ordered)[:-1]])
    share = (most_s - before) / np.arange(ordered.size, 0, -1)
    return float(share[np.argmax(share < ordered)])
