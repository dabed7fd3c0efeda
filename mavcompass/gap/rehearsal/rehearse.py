"""Rehearse the calibration of a diagnosed vehicle: what heading error to expect, why, and what lowers it.

Vehicles of its kind are drawn from what the diagnosis believes, each is calibrated in the simulation, and the
correction is judged against the truth. Then the same vehicles again, without one effect or source of error
after the other, and by other protocols: with the same chances, so that a few tell the difference.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.reference import Choice
from mavcompass.gap.rehearsal.draws import SOURCES, Draws
from mavcompass.gap.rehearsal.kind import Kind, Stored, kind_of
from mavcompass.gap.rehearsal.procedure import USUAL, Protocol, calibrate, heading_errors_deg
from mavcompass.gap.result import MOTOR, Diagnosis
from mavcompass.gap.tables import usual
from mavcompass.printable import plain
from mavcompass.simulation.effects import get
from mavcompass.simulation.effects.effect import PLACED
from mavcompass.track import Track

_LOADS = frozenset({"current", "motors", "throttle|current|motors"})
SCHEMA = "mavcompass.gap-rehearsal/1"
_AS_THEY_ARE = (
    "compass", "effects", "heading_error_deg", "remedies", "draws", "compared", "refused", "positions",
    "claimed_deg", "stances", "seed", "notes", "seconds",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Expected:
    """Hold the rms heading error over the circle to expect, degrees.

    `rms` is over all vehicles drawn; 95 of 100 of them stay within `interval95`.
    """

    rms: float
    median: float
    interval95: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Errors:
    """Hold the heading error to expect on the level, and leaning by 15 degrees in any direction."""

    level: Expected
    tilt_15: Expected


@dataclass(frozen=True, slots=True)
class Part:
    """Hold what makes a part of the error, an "effect" or a "source" of it, and the error without.

    `share` is the part of the level error's square that goes with it, `share_tilted` of the tilted one's.
    """

    name: str
    kind: str
    without: Errors
    share: float
    share_tilted: float


@dataclass(frozen=True, slots=True)
class Remedy:
    """Hold what was tried instead of the usual calibration, the error with it, and how much lower that is.

    `change` and `change_tilted` are ratios of rms errors, of the same vehicles: 0.5 halves it.
    """

    what: str
    heading_error_deg: Errors
    change: float
    change_tilted: float


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """Hold the whole answer.

    Attributes:
        source: the recording. compass: from 1. effects: what the vehicle may have.
        heading_error_deg: to expect after calibrating it by four positions, used as in the recording.
        parts: the budget, the largest first. remedies: what was tried, the best first.
        draws: how many vehicles; compared: how many of them for each part and remedy; refused: how many fits
            had no solution. positions: how many were visited, on the average.
        claimed_deg: what the calibration itself would say of its level error, 1 sigma rms.
        stances: how many calm stretches the recording shows. notes: what to know about all this.
    """

    source: str
    compass: int
    effects: tuple[str, ...]
    heading_error_deg: Errors
    parts: tuple[Part, ...]
    remedies: tuple[Remedy, ...]
    draws: int
    compared: int
    refused: int
    positions: float
    claimed_deg: float
    stances: int
    seed: int
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def dominant(self) -> Part | None:
        """Return what makes most of the level error; None where nothing makes a tenth of it."""
        return self.parts[0] if self.parts and self.parts[0].share >= 0.1 else None

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.gap-rehearsal/1`, plain values only."""
        return {
            "schema": SCHEMA,
            "log": self.source,
            "budget": plain(self.parts),
            "dominant": self.dominant.name if self.dominant is not None else None,
            **{name: plain(getattr(self, name)) for name in _AS_THEY_ARE},
        }


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Hold calibrations of the first N vehicles of a kind; nan where the fit had no solution.

    Attributes:
        judged: rms errors over the circle, level and tilted, what the calibration says of the level one,
            degrees each, and how many positions were visited, (N, 4).
        refusal: why the last that had none had no solution.
    """

    judged: FloatArray
    refusal: PoorCalibration | None = None

    @property
    def errors_deg(self) -> FloatArray:
        """Return the errors, level and tilted, (N, 2)."""
        return self.judged[:, :2]

    @property
    def errors(self) -> Errors:
        """Return what is to be expected."""
        level, tilted = (_expected(column[np.isfinite(column)]) for column in self.errors_deg.T)
        return Errors(level, tilted)

    def change_from(self, other: Run) -> tuple[float, float]:
        """Return the ratio of rms errors, level and tilted, to those of the same vehicles done otherwise."""
        both = np.isfinite(self.errors_deg) & np.isfinite(other.errors_deg)
        mine, theirs = (np.where(both, run.errors_deg, 0.0) for run in (self, other))
        level, tilted = np.sqrt((mine**2).sum(axis=0) / np.maximum((theirs**2).sum(axis=0), 1e-12)).tolist()
        return level, tilted


def calibrations(
    kind: Kind,
    draws: Draws,
    count: int,
    protocol: Protocol = USUAL,
    without: Collection[str] = (),
    done: Callable[[], None] = lambda: None,
) -> Run:
    """Calibrate the first vehicles of a kind, judge what they got, and tell each that is done."""
    out = np.full((count, 4), np.nan)
    refusal = None
    for number in range(count):
        individual = draws[number].without(without, kind)
        try:
            fit = calibrate(kind, individual, protocol)
        except PoorCalibration as why:
            refusal = why
        else:
            level, tilted = heading_errors_deg(kind, individual, fit.correction)
            visited = len(fit.magnetic_headings_rad)
            out[number] = level, tilted, np.degrees(fit.heading_sigma_rad), visited
        done()
    return Run(out, refusal)


def _expected(errors_deg: FloatArray) -> Expected:
    rms_deg, median_deg = float(np.sqrt(np.mean(errors_deg**2))), float(np.median(errors_deg))
    return Expected(rms_deg, median_deg, (0.0, float(np.quantile(errors_deg, 0.95, method="higher"))))


def rehearse(
    track: Track,
    diagnosis: Diagnosis | Stored,
    draws: int = 1000,
    seed: int = 1,
    reference: Choice = "auto",
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Rehearsal:
    """Tell the heading error to expect of a four-position calibration of a recording's vehicle.

    `progress` is told how many calibrations are done, and of how many. Raises BadRecording where the
    recording does not show how the vehicle stands, PoorCalibration where none of its kind can be calibrated.
    """
    started = time.perf_counter()
    with single_thread():
        kind = kind_of(track, diagnosis, reference)
        compared = min(
            draws, max(round(usual.rehearsal.compared_share * draws), usual.rehearsal.fewest_compared)
        )
        sorts = dict.fromkeys(SOURCES, "source") | dict.fromkeys(kind.effects, "effect")
        protocols = list(_protocols(kind))
        done, of = count(1), draws + compared * (len(sorts) + len(protocols))
        vehicles = Draws(kind, seed)

        def run(of_them: int, protocol: Protocol = USUAL, without: Collection[str] = ()) -> Run:
            return calibrations(kind, vehicles, of_them, protocol, without, lambda: progress(next(done), of))

        whole = run(draws)
        if not np.isfinite(whole.errors_deg).any() and whole.refusal is not None:
            raise whole.refusal
        few, parts, remedies = Run(whole.judged[:compared]), list[Part](), list[Remedy]()
        for name, sort in sorts.items():
            other = run(compared, without={name})
            level, tilted = other.change_from(few)
            parts.append(Part(name, sort, other.errors, 1.0 - level**2, 1.0 - tilted**2))
        for words, protocol in protocols:
            other = run(compared, protocol)
            remedies.append(Remedy(words, other.errors, *other.change_from(few)))
    _, _, claimed_deg, positions = whole.judged.T
    return Rehearsal(
        source=track.source,
        compass=diagnosis.compass,
        effects=kind.effects,
        heading_error_deg=whole.errors,
        parts=tuple(sorted(parts, key=lambda part: -part.share)),
        remedies=tuple(sorted(remedies, key=lambda remedy: remedy.change)),
        draws=draws,
        compared=compared,
        refused=int(np.isnan(claimed_deg).sum()),
        positions=float(np.nanmean(positions)),
        claimed_deg=float(np.sqrt(np.nanmean(claimed_deg**2))),
        stances=len(kind.stances),
        seed=seed,
        seconds=time.perf_counter() - started,
        notes=tuple(_notes(kind, diagnosis)),
    )


def _protocols(kind: Kind) -> Iterator[tuple[str, Protocol]]:
    """List what a person could do instead, with its words."""
    yield "two more stops (--positions 6)", Protocol(positions=6)
    yield "four more stops (--positions 8)", Protocol(positions=8)
    leaning = ((usual.rehearsal.leaning_rad, 0.0), (0.0, usual.rehearsal.leaning_rad))
    yield (
        "two more stops leaning by 15 deg, right and nose up (by hand: --motion hand)",
        Protocol(leaning_rad=leaning),
    )
    needs = {need for effect in kind.effects for need in get(effect).needs}
    if needs & _LOADS or np.any(kind.iron.motor_mgauss):
        yield "motors off while calibrating (by hand: --motion hand)", Protocol(motors_off=True)
    if "motor_current" in kind.effects:
        x, y, z = _motor_mean(kind).tolist()
        yield (
            "the motor compensation set to what was found (COMPASS_MOT), then calibrated",
            Protocol(motor_mgauss=(x, y, z)),
        )
    if needs & PLACED:
        if kind.vehicle == "copter":
            yield (
                f"calibrated while hovering {usual.rehearsal.away_m:.0f} m higher",
                Protocol(away_m=(0.0, 0.0, -usual.rehearsal.away_m)),
            )
        yield (
            f"calibrated {usual.rehearsal.away_m:.0f} m away",
            Protocol(away_m=(usual.rehearsal.away_m, 0.0, 0.0)),
        )


def _motor_mean(kind: Kind) -> np.ndarray:
    """Return the motors' raw field per ampere, (3,), as the likeliest explanation with it has it."""
    best = max((b for b in kind.beliefs if "motor_current" in b.effects), key=lambda b: b.weight)
    at = best.places[best.effects.index("motor_current")]
    return kind.iron.motor_mgauss + best.mean[MOTOR] + best.mean[at : at + 3]


def _notes(kind: Kind, diagnosis: Diagnosis | Stored) -> Iterator[str]:
    if diagnosis.verdict in ("unknown", "named_with_remainder"):
        yield "Something is left that the diagnosis does not explain; it is not in this."
    if diagnosis.verdict == "not_testable":
        yield "The vehicle neither turns nor tilts in this recording: what is wrong with it is not in this."
    if len(kind.stances) < usual.rehearsal.few_stances:
        yield f"The recording shows only {len(kind.stances)} calm stretches: how it stands is hardly known."
    if kind.earth is None:
        yield "The place is unknown: nothing is taken from the world's magnetic model."
