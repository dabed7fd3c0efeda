"""The summary page of a fleet: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mavcompass.fleet.summary import LEAST_MGAUSS, NOTABLE_DEG, ONE_FLIGHT_S, History, Summary, Vehicle
from mavcompass.frames import FloatArray
from mavcompass.report.svg import Plot, bars, limits, write_page

# Units of time, the first that recordings span two of: seconds, name, how their beginning is written.
_UNITS = (
    (86_400.0, "days", "%Y-%m-%d"),
    (3_600.0, "hours", "%Y-%m-%d %H:%M UTC"),
)
# A page stays one that a person can read; the Parquet file has everything.
_MOST_VEHICLES, _MOST_DRIFTS, _MOST_ERRORS, _MOST_FIRST = 300, 24, 50, 12
# Classes of the style sheet for the first, second and third compass: line and band, dots.
_CURVES = (("new", "new"), ("old", "old"), ("truth", "axis-z"))


def write_fleet_report(summary: Summary, facts: Mapping[str, str], path: Path) -> None:
    """Write the page. Raises UsageError where it cannot be written or jinja2 is missing."""
    effects = [e for e in summary.effects if e.largest_mgauss >= LEAST_MGAUSS]
    drifting = [v for v in summary.vehicles if any(map(_is_over_time, v.histories))]
    shown = {
        "summary": summary,
        "facts": facts,
        "notable_deg": NOTABLE_DEG,
        "first": [(v, "/".join(Path(v.last_recording).parts[-2:])) for v in summary.look_first[:_MOST_FIRST]],
        "effects": effects,
        "vehicles": [(v, _last_off_deg(v), _rate(v), _health(v)) for v in summary.vehicles[:_MOST_VEHICLES]],
        "healthy": any(map(_health, summary.vehicles)),
        "drifts": [(v, drift_figure(v, summary.work == "calibrate")) for v in drifting[:_MOST_DRIFTS]],
        "drifting": len(drifting),
        "errors": summary.errors[:_MOST_ERRORS],
        "not_accepted": summary.not_accepted[:_MOST_ERRORS],
        "effect_bars": bars(
            sorted(((e.effect, e.median_mgauss) for e in effects), key=lambda e: -e[1])[:12],
            "mG",
            "Median size of each effect",
        ),
    }
    write_page(path, "fleet.html", shown)


def _is_over_time(history: History) -> bool:
    return history.points[-1].time_unix_s - history.points[0].time_unix_s >= ONE_FLIGHT_S


def drift_figure(vehicle: Vehicle, calibrated: bool) -> str:
    """Draw a vehicle's compasses over time: drift of the calibration, or the heading gap, in degrees."""
    drawn = list(filter(_is_over_time, vehicle.histories))
    start = min(h.points[0].time_unix_s for h in drawn)
    span_s = max(h.points[-1].time_unix_s for h in drawn) - start
    unit_s, unit, written = next((u for u in _UNITS if span_s >= 2.0 * u[0]), _UNITS[-1])
    curves = [_curve(history, start, unit_s, calibrated) for history in drawn]
    began = datetime.fromtimestamp(start, UTC).strftime(written)
    plot = Plot(
        x_range=limits(*(since for since, _, _ in curves), least=1.0),
        y_range=limits([0.0], *(values + sigmas for _, values, sigmas in curves), least=1.0),
        x_label=f"{unit} since {began}",
        y_label="moved since then, deg" if calibrated else "heading gap, deg",
        title=f"{vehicle.name} over time",
        height=220.0,
    )
    for number, (since, values, sigmas) in enumerate(curves):
        css, dots_css = _CURVES[number % len(_CURVES)]
        if calibrated:
            plot.band(since, (values - sigmas).clip(min=0.0), values + sigmas, css)
        plot.line(since, values, css)
        plot.dots(since, values, dots_css, 2.4, f"compass {drawn[number].compass}")
    return plot.render()


def _curve(
    history: History, start: float, unit_s: float, calibrated: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    def column(values: Sequence[float | None]) -> FloatArray:
        return np.array([np.nan if value is None else value for value in values])

    points = history.points
    values = column([p.drift_deg if calibrated else p.off_deg for p in points])
    sigmas = np.nan_to_num(column([p.sigma_deg for p in points]))
    return (np.array([p.time_unix_s for p in points]) - start) / unit_s, values, sigmas


def _last_off_deg(vehicle: Vehicle) -> float | None:
    lasts = [h.points[-1].off_deg for h in vehicle.histories]
    return max((value for value in lasts if value is not None), default=None)


def _health(vehicle: Vehicle) -> list[str]:
    return [f"{h.compass}: {said}" for h in vehicle.histories if (said := h.health)]


def _rate(vehicle: Vehicle) -> float | None:
    rates = [rate for h in vehicle.histories if (rate := h.rate_deg_per_30_days) is not None]
    return max(rates, key=abs, default=None)
