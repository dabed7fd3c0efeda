"""What a replay makes of a recording's own clock, numbers and path."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap import diagnose_gap
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.detectors.detect import names_stale, names_step
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import Replay, replay, untestable_effects
from mavcompass.gap.replay.nuisance import WORLD_FIELD, Prior, reference_attitude_error
from mavcompass.gap.replay.rows import compass_rows
from mavcompass.gap.replay.surroundings import without_scatter
from mavcompass.gap.residual.floor import from_recording, with_predictive_variance
from mavcompass.gap.selection.split import split_blocks
from mavcompass.gap.trial.cases import PLACE, Recipe, make_track
from mavcompass.simulation.effects import catalogue
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

_FIELD_MGAUSS = np.array([180.0, 20.0, 480.0])
_METRES_PER_DEG = 111_195.0


def driven(t: FloatArray, radius_m: float, every: int = 1) -> Track:
    """Drive circles with a receiver of 0.3 m, the compass read at every so many rows and repeated."""
    rng = np.random.default_rng(8)
    turn = 0.25
    rotation = euler_to_matrix(0.03 * np.sin(0.9 * t), 0.02 * np.sin(0.7 * t), turn * t)
    nothing = np.zeros_like(t)
    path = radius_m * np.stack([np.sin(turn * t), 1.0 - np.cos(turn * t), nothing], axis=1)
    pull = radius_m * turn**2 * np.stack([-np.sin(turn * t), np.cos(turn * t), nothing], axis=1)
    force = rotate_back(rotation, pull - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    field = rotate_back(rotation, np.tile(_FIELD_MGAUSS, (t.size, 1)))
    field = field + 0.8 * rng.standard_normal(field.shape)
    field = field[np.arange(t.size) // every * every]
    heard = slice(None, None, 5)
    wander = 0.3 * np.convolve(rng.standard_normal(t[heard].size), np.ones(5) / 5.0, mode="same")
    north, east, down = (path[heard] + wander[:, None]).T
    lat = PLACE[0] + north / _METRES_PER_DEG
    lon = PLACE[1] + east / (_METRES_PER_DEG * np.cos(np.radians(PLACE[0])))
    return Track(
        compasses={1: MagSeries(1, Series.of(t, field))},
        acc_mps2=Series.of(t, force + 0.05 * rng.standard_normal(force.shape)),
        gyro_radps=Series.of(t, body_rate(t, rotation) + 0.002 * rng.standard_normal(force.shape)),
        place=Series.of(t[heard], np.stack([lat, lon, PLACE[2] - down], axis=1)),
    )


def test_magnet_at_a_place_is_testable_with_a_receivers_path() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    driving = untestable_effects(replay(driven(t, 8.0)), catalogue().values())
    standing = untestable_effects(replay(driven(t, 0.2)), catalogue().values())
    assert not {"spatial_dipole", "field_gradient"} & driving.keys()
    assert {"spatial_dipole", "field_gradient"} <= standing.keys()


def test_compass_read_more_slowly_than_logged_is_no_lag_and_no_repeats() -> None:
    t = np.arange(0.0, 90.0, 0.04)
    track = driven(t, 0.2, every=3)
    replayed = replay(track)
    assert replayed.telemetry and replayed.time_s.size == t.size // 3
    diagnosis = diagnose_gap(track)
    assert not diagnosis.effects & {"transport_lag", "low_pass", "stale_samples", "timestamp_jitter"}


def test_readings_lost_by_chance_are_no_slow_compass() -> None:
    track = make_track(Recipe("rich", duration_s=60.0, seed=4))
    field = track.compasses[1].reported.values.copy()
    lost = np.flatnonzero(np.random.default_rng(3).random(len(field)) < 0.4)
    for row in lost[lost > 0]:
        field[row] = field[row - 1]
    stale = replace(track, compasses={1: MagSeries(1, Series.of(track.compasses[1].time_s, field))})
    rows = compass_rows(stale, stale.compasses[1])
    assert not rows.telemetry and rows.trace.stale_share == pytest.approx(0.4, abs=0.05)


def with_curves(replayed: Replay, curves_rad: FloatArray) -> Replay:
    """Return a replay whose attitude is known but for a little yaw and some curves (N, 3, k)."""
    k = curves_rad.shape[2]
    unknown = Prior.of(reference_attitude_error(curves_rad), np.zeros(1 + k), np.array([0.01, *np.ones(k)]))
    field = replayed.prior
    others = Prior(field.effects[:1], field.mean[:3], field.precision[:3, :3])
    reference = replace(replayed.reference, curves_rad=curves_rad)
    return replace(replayed, reference=reference, prior=others.beside(unknown))


def test_floor_rises_with_what_the_training_rows_leave_unknown_and_not_with_what_they_fix() -> None:
    replayed = replay(driven(np.arange(0.0, 60.0, 0.05), 8.0))
    t, split = replayed.time_s, split_blocks(replayed.time_s, replayed.valid)
    size = math.radians(1.0)
    # A turn about north that only held-out rows have, and one of the same size that all rows show.
    hidden, shown = np.zeros((t.size, 3, 1)), np.zeros((t.size, 3, 1))
    hidden[split.test, 0, 0] = size
    shown[:, 0, 0] = size * np.where(np.sin(0.2 * t) > 0.0, 1.0, -1.0)

    def raised(curves_rad: FloatArray) -> tuple[float, float]:
        """Return what is with_predictive_variance beside the stated floor, milligauss and degrees."""
        leaning = with_curves(replayed, curves_rad)
        floor = from_recording(leaning)
        more = with_predictive_variance(floor, leaning, split.train, split.test)
        assert more.prior is floor.prior and more.noise is floor.noise
        return (
            math.sqrt(more.field_rms_mgauss**2 - floor.field_rms_mgauss**2),
            math.sqrt(more.heading_rms_deg**2 - floor.heading_rms_deg**2),
        )

    none, fixed, unknown = (raised(c) for c in (np.zeros((t.size, 3, 0)), shown, hidden))
    # East changes by the down component of the field that the training rows find, and down by the east one.
    floor = from_recording(replayed)
    null = Problem(replayed, floor.noise, split.train, floor.prior).null()
    assert replayed.prior.effects[0] is WORLD_FIELD
    north, east, down = replayed.signals.stimulus.field_ned_mgauss[0] + null.nuisances[:3]
    whole = float(size * np.hypot(east, down) / math.sqrt(3.0))
    heading = math.degrees(size * down / np.hypot(north, east))
    assert math.sqrt(unknown[0] ** 2 - none[0] ** 2) == pytest.approx(whole, rel=0.05)
    assert math.sqrt(unknown[1] ** 2 - none[1] ** 2) == pytest.approx(heading, rel=0.05)
    assert fixed[0] < none[0] + 0.1 * whole and fixed[1] < none[1] + 0.1 * heading


def test_doubt_that_no_curve_holds_raises_the_floor_by_what_it_moves() -> None:
    replayed = replay(driven(np.arange(0.0, 60.0, 0.05), 8.0))
    split = split_blocks(replayed.time_s, replayed.valid)
    size = 0.02
    floor = from_recording(replayed)
    calm, more = (
        with_predictive_variance(
            floor,
            replace(replayed, reference=replace(replayed.reference, rest_rad2=np.diag([0.0, east, 0.0]))),
            split.train,
            split.test,
        )
        for east in (0.0, size**2)
    )
    north, east, down = replayed.signals.stimulus.field_ned_mgauss[0]
    # A turn about the east moves what is north and down; of the north part heading sees what lies across.
    moved = size * math.hypot(north, down) / math.sqrt(3.0)
    across = math.degrees(size * abs(down * east) / (north**2 + east**2))
    assert math.sqrt(more.field_rms_mgauss**2 - calm.field_rms_mgauss**2) == pytest.approx(moved, rel=1e-6)
    assert math.sqrt(more.heading_rms_deg**2 - calm.heading_rms_deg**2) == pytest.approx(across, rel=1e-4)


def test_nothing_is_foreseen_without_held_out_rows() -> None:
    replayed = replay(driven(np.arange(0.0, 30.0, 0.05), 8.0))
    floor = from_recording(replayed)
    assert with_predictive_variance(floor, replayed, replayed.valid, np.zeros_like(replayed.valid)) is floor


def test_whole_milligauss_repeat_by_chance() -> None:
    track = driven(np.arange(0.0, 90.0, 0.05), 0.2)
    compass = track.compasses[1]
    slow = np.round(0.3 * compass.reported.values)
    counted = MagSeries(1, Series.of(compass.time_s, slow), quantum_mgauss=1.0)
    replayed = replay(replace(track, compasses={1: counted}))
    assert replayed.trace.stale_share > 0.003 and not names_stale(replayed, None)
    assert not names_step(replayed, None, 1.0)


def test_field_of_a_replay_is_that_of_the_place() -> None:
    track = make_track(Recipe("yaw-steps", duration_s=30.0, seed=3))
    replayed = replay(track)
    nominal = rotate_back(replayed.signals.stimulus.rotation, replayed.signals.stimulus.field_ned_mgauss)
    error = replayed.measured.mag_mgauss - nominal
    assert np.abs(error.mean(axis=0)).max() < 0.5 and 2.5 < error.std() < 3.5


def test_what_scatters_from_place_to_place_is_no_motion_and_what_lasts_is_none_of_its_scatter() -> None:
    t, rng = np.arange(0.0, 60.0, 0.1), np.random.default_rng(4)
    path = np.stack([4.0 * np.sin(0.5 * t), 3.0 * np.cos(0.4 * t), -5.0 - 0.02 * t**2], axis=1)
    white = 0.01 * rng.standard_normal(path.shape)
    smooth = without_scatter(Series.of(t, path + white)).values
    assert (smooth - path).std() < 0.5 * white.std()
    # A receiver's errors last: they stay, and what is not noise is not touched.
    lasting = lfilter([0.02], [1.0, -0.98], rng.standard_normal(path.shape), axis=0)
    assert (without_scatter(Series.of(t, path + lasting)).values - path).std() < 1.02 * lasting.std()
    for told in (path, np.where(t[:, None] < 30.0, path, np.nan)):
        np.testing.assert_array_equal(without_scatter(Series.of(t, told)).values, told)
