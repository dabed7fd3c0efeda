"""Write a Track CSV: one row for each time of any quantity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mavcompass.files import replacing
from mavcompass.frames import FloatArray
from mavcompass.logs.formats.csv.reader import MOTORS, SCALARS, TIME, VECTORS
from mavcompass.track import Series, Track


def write_track_csv(track: Track, path: Path, instance: int = 1) -> None:
    """Write one compass of a track, with the corrections in force undone, and what else fits the columns.

    One row for each time of any quantity, empty where the quantity has no sample at exactly that time.
    Raises KeyError for a compass that the track does not have.
    """
    columns: list[tuple[tuple[str, ...], Series]] = []
    mag = Series.of(track.compasses[instance].time_s, track.raw_field(instance))
    columns.append((VECTORS["mag"], mag))
    for quantity, names in [(q, n) for q, n in VECTORS.items() if q != "mag"]:
        columns += _column_of(track, quantity, names)
    for quantity, name in SCALARS.items():
        columns += _column_of(track, quantity, (name,))
    if track.motors is not None:
        columns += _column_of(track, "motors", MOTORS[: track.motors.values.shape[1]])
    times, table = _tabulate([series for _, series in columns])
    header = ",".join([TIME, *(name for names, _ in columns for name in names)])
    with replacing(path) as half, half.open("w", encoding="utf-8", newline="\n") as file:
        file.write(header + "\n")
        for moment, row in zip(times.tolist(), table.tolist(), strict=True):
            file.write(f"{moment!r}," + ",".join("" if v != v else repr(v) for v in row) + "\n")


def _column_of(track: Track, quantity: str, names: tuple[str, ...]) -> list[tuple[tuple[str, ...], Series]]:
    series: Series | None = getattr(track, quantity)
    return [] if series is None or not len(series) else [(names, series)]


def _tabulate(columns: Sequence[Series]) -> tuple[FloatArray, FloatArray]:
    """Lay series with their own clocks side by side; a time that occurs twice in one gets rows of its own."""
    occurrences = [_with_occurrence(series.time_s) for series in columns]
    keys = np.unique(np.concatenate(occurrences), axis=0)
    widths = [1 if series.values.ndim == 1 else series.values.shape[1] for series in columns]
    table = np.full((len(keys), sum(widths)), np.nan)
    structured = _as_keys(keys)
    at = 0
    for series, occurrence, width in zip(columns, occurrences, widths, strict=True):
        rows = np.searchsorted(structured, _as_keys(occurrence))
        table[rows, at : at + width] = series.values.reshape(len(series), width)
        at += width
    return keys[:, 0], table


def _with_occurrence(time_s: FloatArray) -> FloatArray:
    """Number the samples that share one time: (N, 2) of time and how many came before at that time."""
    first = np.searchsorted(time_s, time_s)
    return np.stack([time_s, np.arange(time_s.size) - first], axis=1)


def _as_keys(pairs: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    keys = np.empty(len(pairs), dtype=[("time_s", "f8"), ("occurrence", "f8")])
    keys["time_s"], keys["occurrence"] = pairs[:, 0], pairs[:, 1]
    return keys
