"""Sum up a fleet: which vehicles, which effects, how large, how each vehicle drifts, where to look first."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from statistics import median

import numpy as np

from mavcompass.errors import PoorCalibration
from mavcompass.fleet.examine import Row, Work
from mavcompass.fleet.population import Distribution, Odd, learn
from mavcompass.printable import counted

_AXES = ("x", "y", "z")
_DAY_S = 86_400.0
# A heading that is off by more than this, or that drifted by so many sigmas, is worth a person's time.
NOTABLE_DEG = 2.0
NOTABLE_SIGMAS = 3.0
# Recordings within an hour are of one flight: the autopilot's log and the ground station's, or parts of it.
ONE_FLIGHT_S = 3600.0
LEAST_MGAUSS = 0.5  # an effect that is nowhere larger is not worth a line
# Verdicts of a diagnosis after which the difference in heading is the recording's own noise.
_SILENT = ("no_gap", "not_testable")


@dataclass(frozen=True, slots=True)
class Point:
    """Hold one recording's place in a compass's history.

    Attributes:
        time_unix_s: when. recording: which.
        off_deg: heading rms between the correction in force (or the simulation) and what was found.
        drift_deg: heading rms between the first accepted correction and this one; None for diagnoses.
        sigma_deg: 1 sigma of `drift_deg`.
        is_noise: the recording is too coarse for `off_deg` to mean anything.
    """

    time_unix_s: float
    recording: str
    off_deg: float | None
    drift_deg: float | None = None
    sigma_deg: float | None = None
    is_noise: bool = False


@dataclass(frozen=True, slots=True)
class Move:
    """Hold by how much the calibrations of two recordings, one after the other, differ beyond chance.

    Attributes:
        before_unix_s, after_unix_s: when they were recorded. deg: heading rms over the circle.
        beside: what else came between them, in words.
    """

    before_unix_s: float
    after_unix_s: float
    deg: float
    beside: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class History:
    """Hold one compass of one vehicle over time, oldest first, and when its calibration moved."""

    compass: int
    device_id: int | None
    points: tuple[Point, ...]
    moves: tuple[Move, ...] = ()

    @property
    def health(self) -> str:
        """Say in a line since when a compass's calibration stands still; nothing for a single flight."""
        first, last = self.points[0], self.points[-1]
        since = self.moves[-1] if self.moves else None
        span_s = last.time_unix_s - (first.time_unix_s if since is None else since.after_unix_s)
        steady = f"steady for {in_words(span_s)}" if span_s >= ONE_FLIGHT_S else ""
        moved = f"moved by {since.deg:.1f}° until {_day(since.after_unix_s)}" if since is not None else ""
        return ", ".join(filter(None, (moved, steady))) if last.drift_deg is not None else ""

    @property
    def rate_deg_per_30_days(self) -> float | None:
        """Return how fast the measured quantity grows, by least squares; None for less than a day."""
        known = [(p.time_unix_s, v) for p in self.points if (v := _measure(p)) is not None]
        times = np.array([t for t, _ in known]) / _DAY_S
        if len(known) < 2 or np.ptp(times) < 1.0:
            return None
        centred = times - times.mean()
        return float(30.0 * (centred @ np.array([v for _, v in known])) / (centred @ centred))


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Hold what is known of one vehicle; `why` says, worst first, what makes it worth a look.

    `not_accepted` recordings gave no calibration: mostly, the vehicle turned too little.
    """

    name: str
    kind: str
    recordings: int
    errors: int
    not_accepted: int
    effects: tuple[tuple[str, float], ...]
    histories: tuple[History, ...]
    worst_deg: float
    why: tuple[str, ...]
    last_recording: str = ""


@dataclass(frozen=True, slots=True)
class EffectSize:
    """Hold how often an effect was found and how large it is, milligauss."""

    effect: str
    recordings: int
    vehicles: int
    median_mgauss: float
    largest_mgauss: float
    largest_in: str


@dataclass(frozen=True, slots=True)
class Summary:
    """Hold the whole fleet; every count is one of recordings.

    Attributes:
        errors: recording and what went wrong, once each. vehicles: the ones to look at first come first.
        slowest: the recordings that took longest, with their seconds.
        not_accepted: recordings that gave no calibration, and why.
        population: what diagnosed vehicles have in common; None of calibrations.
    """

    work: Work
    recordings: int
    errors: tuple[tuple[str, str], ...]
    vehicles: tuple[Vehicle, ...]
    effects: tuple[EffectSize, ...]
    slowest: tuple[tuple[str, float], ...] = ()
    not_accepted: tuple[tuple[str, str], ...] = ()
    population: Distribution | None = None

    @property
    def trend(self) -> tuple[float, int] | None:
        """Return the median drift in 30 days, degrees, and of how many compasses; None where unknown."""
        rates = [r for v in self.vehicles for h in v.histories if (r := h.rate_deg_per_30_days) is not None]
        return (median(rates), len(rates)) if rates else None

    @property
    def look_first(self) -> tuple[Vehicle, ...]:
        """Return the vehicles that give a reason to look at them, worst first."""
        return tuple(vehicle for vehicle in self.vehicles if vehicle.why)


def summarise(rows: Sequence[Row], work: Work) -> Summary:
    """Sum up the rows of `examine`."""
    by_vehicle: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_vehicle[row["vehicle"]].append(row)
    population = learn(rows) if work == "diagnose" else None
    odd = population.odd if population is not None else ()
    vehicles = [
        _vehicle(name, by_vehicle[name], [one for one in odd if one.vehicle == name])
        for name in sorted(by_vehicle)
    ]
    vehicles.sort(key=lambda v: (-v.worst_deg, -len(v.why), v.name))
    return Summary(
        work,
        _count(rows),
        _sentences(rows, _is_error),
        tuple(vehicles),
        _effects(rows),
        _slowest(rows),
        _sentences(rows, _is_not_accepted),
        population,
    )


def effects_of(row: Row) -> dict[str, float]:
    """Return the effects that one row shows, with their size in milligauss.

    A diagnosis names them. A calibration shows the hard iron as it is, and scale and cross terms by what
    they make of the Earth's horizontal field.
    """
    if row.get("verdict") is not None:
        before, after = "effect_", "_mgauss"
        return {
            name[len(before) : -len(after)]: float(size)
            for name, size in row.items()
            if name.startswith(before) and name.endswith(after) and size is not None
        }
    if not row.get("accepted"):
        return {}
    horizontal = row["field_horizontal_mgauss"] or 0.0
    return {
        "hard_iron": math.dist((0.0, 0.0, 0.0), [row[f"offset_{axis}_mgauss"] for axis in _AXES]),
        "axis_scale": 0.5 * abs(row["diagonal_x"] - row["diagonal_y"]) * horizontal,
        "non_orthogonality": abs(row["off_diagonal_xy"]) * horizontal,
    }


def _is_not_accepted(row: Row) -> bool:
    """Tell a recording that can be read and gives no calibration: an ordinary flight, not a fault."""
    return row["status"] == "not_accepted" or (
        row["status"] == "error" and row.get("error_kind") == PoorCalibration.__name__
    )


def _is_error(row: Row) -> bool:
    return row["status"] == "error" and not _is_not_accepted(row)


def _sentences(rows: Sequence[Row], chosen: Callable[[Row], bool]) -> tuple[tuple[str, str], ...]:
    """Return each chosen recording once, and why; where other compasses gave a result, with the compass."""
    good = {row["recording"] for row in rows if not chosen(row)}
    said: dict[str, str] = {}
    for row in filter(chosen, rows):
        which = f"compass {row['compass']}: " if row["recording"] in good and row.get("compass") else ""
        said.setdefault(row["recording"], which + (row.get("error") or row.get("reasons") or ""))
    return tuple(said.items())


def _slowest(rows: Sequence[Row]) -> tuple[tuple[str, float], ...]:
    seconds: dict[str, float] = defaultdict(float)
    for row in rows:
        seconds[row["recording"]] += row.get("seconds") or 0.0
    return tuple(sorted(seconds.items(), key=lambda item: -item[1])[:3])


def _count(rows: Iterable[Row]) -> int:
    return len({row["recording"] for row in rows})


def _effects(rows: Sequence[Row]) -> tuple[EffectSize, ...]:
    found: dict[str, list[tuple[float, Row]]] = defaultdict(list)
    for row in rows:
        for effect, size in effects_of(row).items():
            found[effect].append((size, row))
    out = []
    for effect, cases in found.items():
        largest, where = max(cases, key=lambda case: case[0])
        vehicles = len({row["vehicle"] for _, row in cases})
        middle = median(size for size, _ in cases)
        recordings = _count(row for _, row in cases)
        out.append(EffectSize(effect, recordings, vehicles, middle, largest, where["recording"]))
    return tuple(sorted(out, key=lambda e: (-e.recordings, -e.median_mgauss)))


def _vehicle(name: str, rows: Sequence[Row], odd: Sequence[Odd]) -> Vehicle:
    histories = _histories(rows)
    sizes: dict[str, float] = {}
    for row in rows:
        for effect, size in effects_of(row).items():
            sizes[effect] = max(size, sizes.get(effect, 0.0))
    diagnosed = any(row.get("verdict") is not None for row in rows)
    errors = _count(filter(_is_error, rows))
    not_accepted = _count(filter(_is_not_accepted, rows))
    reasons = [reason for history in histories for reason in _reasons(history, diagnosed)]
    reasons.sort(key=lambda reason: reason[0], reverse=True)
    why = [text for _, text in reasons]
    why += [f"compass {one.compass}: not like the others: {one.words}" for one in odd]
    unexplained = _count(row for row in rows if row.get("unknown"))
    if unexplained:
        shows = "shows" if unexplained == 1 else "show"
        why.append(f"{counted(unexplained, 'recording')} {shows} something that no effect explains")
    if errors:
        why.append(f"{counted(errors, 'recording')} could not be used")
    kinds = [row["vehicle_kind"] for row in rows if row.get("vehicle_kind") not in (None, "unknown")]
    return Vehicle(
        name,
        kinds[0] if kinds else "unknown",
        _count(rows),
        errors,
        not_accepted,
        tuple(sorted(sizes.items(), key=lambda item: -item[1])),
        histories,
        max((worst for worst, _ in reasons), default=0.0),
        tuple(why),
        max((p.time_unix_s, p.recording) for h in histories for p in h.points)[1] if histories else "",
    )


def _histories(rows: Sequence[Row]) -> tuple[History, ...]:
    by_compass: dict[tuple[int, int | None], list[Row]] = defaultdict(list)
    for row in rows:
        if row["status"] == "ok" and row.get("recorded_unix_s") is not None and row.get("compass"):
            by_compass[row["compass"], row.get("device_id")].append(row)
    out = []
    for (compass, device_id), own in sorted(by_compass.items(), key=lambda item: str(item[0])):
        own.sort(key=lambda row: (row["recorded_unix_s"], row["recording"]))
        points = tuple(_point(row, own[0]) for row in own)
        out.append(History(compass, device_id, points, tuple(_moves(own, rows))))
    return tuple(out)


def _moves(own: Sequence[Row], rows: Sequence[Row]) -> Iterator[Move]:
    """Yield where a compass's calibration moved from one recording to the next, of all its vehicle's rows."""
    for old, new in pairwise(own):
        point, start_s = _point(new, old), old["recorded_unix_s"]
        if _is_beyond_chance(point) and point.time_unix_s - start_s >= ONE_FLIGHT_S:
            assert point.drift_deg is not None
            yield Move(start_s, point.time_unix_s, point.drift_deg, tuple(_between(old, new, rows)))


def _between(old: Row, new: Row, rows: Sequence[Row]) -> Iterator[str]:
    """Say what came between two recordings that may have to do with a vehicle's iron."""
    if new.get("firmware") != old.get("firmware") and new.get("firmware") and old.get("firmware"):
        yield f"firmware {old['firmware']} became {new['firmware']}"
    in_force = [[row.get(f"in_force_offset_{axis}_mgauss") for axis in _AXES] for row in (old, new)]
    if in_force[0] != in_force[1]:
        yield "it was calibrated"
    if new.get("accelerometer") != old.get("accelerometer"):
        yield "the accelerometer was calibrated"
    start_s, end_s = old["recorded_unix_s"], new["recorded_unix_s"]
    # What happened while the new one was recorded is not yet between them.
    then = [row for row in rows if start_s <= (row.get("recorded_unix_s") or -math.inf) < end_s]
    yield from dict.fromkeys(f'"{row["events"]}"' for row in then if row.get("events"))


def _point(row: Row, first: Row) -> Point:
    moment, recording = row["recorded_unix_s"], row["recording"]
    if row.get("verdict") is not None:
        return Point(moment, recording, row.get("heading_gap_deg"), is_noise=row["verdict"] in _SILENT)
    sigmas = (first["heading_sigma_deg"] or 0.0, row["heading_sigma_deg"] or 0.0)
    return Point(
        moment, recording, row["heading_change_deg"], heading_between_deg(first, row), math.hypot(*sigmas)
    )


def heading_between_deg(old: Row, new: Row) -> float | None:
    """Return the heading rms over the circle between the corrections of two calibrated rows, degrees.

    None where the field they are to be compared on is not known.
    """
    from mavcompass.correction import FieldCorrection
    from mavcompass.heading.deviation import heading_change_rad

    horizontal, vertical = new["field_horizontal_mgauss"], new["field_vertical_mgauss"]
    if horizontal is None or vertical is None:
        return None
    corrections = [
        FieldCorrection(
            offsets_mgauss=tuple(row[f"offset_{axis}_mgauss"] for axis in _AXES),
            diagonals=tuple(row[f"diagonal_{axis}"] for axis in _AXES),
            off_diagonals=tuple(row[f"off_diagonal_{pair}"] for pair in ("xy", "xz", "yz")),
            scale=row["scale"],
        )
        for row in (old, new)
    ]
    change = heading_change_rad(corrections[0], corrections[1], horizontal, vertical)
    return math.degrees(math.sqrt(float((change**2).mean())))


def in_words(span_s: float) -> str:
    """Spell a time as people do: 3 hours, 40 days."""
    unit_s, unit = (_DAY_S, "day") if span_s >= 2.0 * _DAY_S else (3600.0, "hour")
    return counted(max(round(span_s / unit_s), 1), unit)


def _day(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).date().isoformat()


def _is_beyond_chance(point: Point) -> bool:
    """Tell whether a calibration moved by what is worth a person's time, and not by chance."""
    if point.drift_deg is None or point.sigma_deg is None:
        return False
    return point.drift_deg >= max(NOTABLE_DEG, NOTABLE_SIGMAS * point.sigma_deg)


def _measure(point: Point) -> float | None:
    return point.off_deg if point.drift_deg is None else point.drift_deg


def _reasons(history: History, diagnosed: bool) -> list[tuple[float, str]]:
    """Say what is notable in a compass's history, with how many degrees it is about."""
    out = []
    last, which = history.points[-1], f"compass {history.compass}"
    flight = [p for p in history.points if last.time_unix_s - p.time_unix_s < ONE_FLIGHT_S]
    off_deg = max((p.off_deg for p in flight if p.off_deg is not None and not p.is_noise), default=0.0)
    if off_deg >= NOTABLE_DEG:
        # A diagnosis has the sensor's own gap, whatever the calibration in force makes of it.
        off = "the simulation's heading is {:.1f}° away" if diagnosed else "heading off by {:.1f}°"
        when = "recording" if len(flight) == 1 else f"hour ({counted(len(flight), 'recording')})"
        out.append((off_deg, f"{which}: {off.format(off_deg)} in its last {when}"))
    for move in history.moves:
        beside = f" ({'; '.join(move.beside)})" if move.beside else ""
        days = [_day(moment) for moment in (move.before_unix_s, move.after_unix_s)]
        when = f"on {days[1]}" if days[0] == days[1] else f"between {days[0]} and {days[1]}"
        out.append((move.deg, f"{which}: its calibration moved by {move.deg:.1f}° {when}{beside}"))
    if not history.moves and _is_beyond_chance(last):
        assert last.drift_deg is not None
        span_s = last.time_unix_s - history.points[0].time_unix_s
        moved = f"its calibration moved by {last.drift_deg:.1f}° in {in_words(span_s)}"
        apart = f"recordings of the same hour differ by {last.drift_deg:.1f}°"
        out.append((last.drift_deg, f"{which}: {moved if span_s >= ONE_FLIGHT_S else apart}"))
    return out
