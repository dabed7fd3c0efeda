"""Rehearse the calibration of a diagnosed vehicle: what heading error to expect, why, and what lowers it.

Vehicles of its kind are drawn from what the diagnosis believes, each is calibrated in the simulation, and the
correction is judged against the truth. Then the same vehicles again, without one effect or source of error
after the other, and by other protocols: with the same chances, so that a few tell the difference.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.gap.attitude import Choice
from mavcompass.gap.rehearsal.draws import MOTORS, Draws
from mavcompass.gap.rehearsal.judging import TILT_RAD
from mavcompass.gap.rehearsal.kind import Kind, kind_of
from mavcompass.gap.rehearsal.procedure import FIELD, GYRO, NOISE, QUANTISATION, TILT, Protocol
from mavcompass.gap.rehearsal.result import Part, Rehearsal, Remedy
from mavcompass.gap.rehearsal.runs import Run, calibrations
from mavcompass.gap.rehearsal.stored import Stored
from mavcompass.gap.result import Diagnosis
from mavcompass.simulation.effects import get
from mavcompass.simulation.effects.effect import PLACED
from mavcompass.track import Track

SOURCES = (NOISE, QUANTISATION, TILT, GYRO, FIELD, MOTORS)
# So many vehicles tell a difference, since they meet the same chances.
_COMPARED_SHARE, _FEWEST_COMPARED = 0.06, 40
_AWAY_M = 10.0
_LOADS = frozenset({"current", "motors", "throttle|current|motors"})
_FEW_STANCES = 5


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
        compared = min(draws, max(round(_COMPARED_SHARE * draws), _FEWEST_COMPARED))
        names = [*SOURCES, *kind.effects]
        protocols = list(_protocols(kind))
        bar = _Bar(progress, draws + compared * (len(names) + len(protocols)))
        vehicles = Draws(kind, seed)
        whole = calibrations(kind, vehicles, draws, done=bar.step)
        if not np.isfinite(whole.errors_deg).any() and whole.refusal is not None:
            raise whole.refusal
        few = whole.first(compared)
        parts = [
            _part(name, calibrations(kind, vehicles, compared, without={name}, done=bar.step), few, kind)
            for name in names
        ]
        remedies = [
            _remedy(words, calibrations(kind, vehicles, compared, protocol, done=bar.step), few)
            for words, protocol in protocols
        ]
    return Rehearsal(
        source=track.source,
        compass=diagnosis.compass,
        effects=kind.effects,
        errors=whole.errors,
        parts=tuple(sorted(parts, key=lambda part: -part.share)),
        remedies=tuple(sorted(remedies, key=lambda remedy: remedy.change)),
        draws=draws,
        compared=compared,
        refused=int(np.isnan(whole.claimed_deg).sum()),
        positions=float(np.nanmean(whole.positions)),
        claimed_deg=float(np.sqrt(np.nanmean(whole.claimed_deg**2))),
        stances=len(kind.stances),
        seed=seed,
        seconds=time.perf_counter() - started,
        notes=tuple(_notes(kind, diagnosis)),
    )


class _Bar:
    """Count calibrations."""

    def __init__(self, progress: Callable[[int, int], None], of: int) -> None:
        self._progress, self._of, self._done = progress, of, 0

    def step(self) -> None:
        self._done += 1
        self._progress(self._done, self._of)


def _part(name: str, without: Run, usual: Run, kind: Kind) -> Part:
    level, tilted = without.change_from(usual)
    return Part(name, name in kind.effects, without.errors, 1.0 - level**2, 1.0 - tilted**2)


def _remedy(words: str, otherwise: Run, usual: Run) -> Remedy:
    return Remedy(words, otherwise.errors, *otherwise.change_from(usual))


def _protocols(kind: Kind) -> Iterator[tuple[str, Protocol]]:
    """List what a person could do instead, with its words."""
    yield "two more stops (--positions 6)", Protocol(positions=6)
    yield "four more stops (--positions 8)", Protocol(positions=8)
    leaning = ((TILT_RAD, 0.0), (0.0, TILT_RAD))
    yield (
        "two more stops leaning by 15 deg, right and nose up (by hand: --motion hand)",
        Protocol(leaning_rad=leaning),
    )
    needs = {need for effect in kind.effects for need in get(effect).needs}
    if needs & _LOADS or np.any(kind.motor_mgauss):
        yield "motors off while calibrating (by hand: --motion hand)", Protocol(motors_off=True)
    if "motor_current" in kind.effects:
        x, y, z = _motor_mean(kind).tolist()
        yield (
            "the motor compensation set to what was found (COMPASS_MOT), then calibrated",
            Protocol(motor_mgauss=(x, y, z)),
        )
    if needs & PLACED:
        if kind.vehicle == "copter":
            yield f"calibrated while hovering {_AWAY_M:.0f} m higher", Protocol(away_m=(0.0, 0.0, -_AWAY_M))
        yield f"calibrated {_AWAY_M:.0f} m away", Protocol(away_m=(_AWAY_M, 0.0, 0.0))


def _motor_mean(kind: Kind) -> np.ndarray:
    """Return the motors' raw field per ampere, (3,), as the likeliest explanation with it has it."""
    best = max((b for b in kind.beliefs if "motor_current" in b.effects), key=lambda b: b.weight)
    at = best.places[best.effects.index("motor_current")]
    return kind.motor_mgauss + best.mean[15:18] + best.mean[at : at + 3]


def _notes(kind: Kind, diagnosis: Diagnosis | Stored) -> Iterator[str]:
    if diagnosis.verdict in ("unknown", "named_with_remainder"):
        yield "Something is left that the diagnosis does not explain; it is not in this."
    if diagnosis.verdict == "not_testable":
        yield "The vehicle neither turns nor tilts in this recording: what is wrong with it is not in this."
    if len(kind.stances) < _FEW_STANCES:
        yield f"The recording shows only {len(kind.stances)} calm stretches: how it stands is hardly known."
    if kind.earth is None:
        yield "The place is unknown: nothing is taken from the world's magnetic model."
