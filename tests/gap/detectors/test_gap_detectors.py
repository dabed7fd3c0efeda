"""What single readings tell: toggling, lines, scatter and steps, each beside what it is not."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.correction import FieldCorrection
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.detect import _overdue_share, detect, names_stale, stale_share
from mavcompass.gap.detectors.rapid import excess_variance, find_rapid, quiet_doubt, quiet_scatter
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay.integrity import Readings, Trace, coarse_step, inspect
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.gap.trial.vehicles.cases import make_case
from mavcompass.simulation.effects import catalogue
from mavcompass.simulation.effects.effect import Misfit, Signals
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.track import Series, Track

B = np.array([6.0, -9.0, 4.0])
NOISE = 2.0


def readings(error: FloatArray, time_s: FloatArray) -> Readings:
    """Return readings of a vehicle that turns half of the time, with an error beside its nominal field."""
    turning = np.where(np.sin(0.1 * time_s) > 0.0, 1.0, 0.05)
    yaw = np.cumsum(turning) * 0.02
    nominal = 300.0 * np.stack([np.cos(yaw), -np.sin(yaw), 0.0 * yaw], axis=1)
    return Readings.of(time_s, nominal + error, nominal, np.ones(time_s.size, dtype=np.bool_))


def noisy(time_s: FloatArray, seed: int, sigma: float = NOISE) -> FloatArray:
    """Return white noise on an error that wanders for seconds, as an attitude's does, (N, 3)."""
    rng = np.random.default_rng(seed)
    wandering = 5.0 * np.sin(0.21 * time_s[:, None] + rng.uniform(0.0, 6.0, 3))
    return wandering + sigma * rng.standard_normal((time_s.size, 3))


T = np.arange(0.0, 120.0, 0.04)
HEALTHY = readings(noisy(T, 1), T)


@given(st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_toggling_offset_is_found_though_readings_were_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heard = rng.random(T.size) > 0.05
    sign = np.where(np.arange(T.size) % 2 == 0, 1.0, -1.0)
    found = find_rapid(readings((noisy(T, seed) + sign[:, None] * B)[heard], T[heard]), HEALTHY, 1.0)
    assert found is not None and found.effect == "set_reset_offset"
    offset = np.array([found.parameters[axis] for axis in "xyz"])
    offset *= np.sign(offset[0])
    doubt = np.array([found.sigma[axis] for axis in "xyz"])
    assert (np.abs(offset - B) < 5.0 * doubt).all() and doubt == pytest.approx(
        np.full(3, NOISE / math.sqrt(heard.sum())), rel=0.2
    )


@pytest.mark.parametrize("hertz", [0.6, 0.8, 3.7, 11.9])
def test_line_is_found_with_its_frequency_and_its_phase(hertz: float) -> None:
    phase = 2.0 * np.pi * hertz * T
    waves = np.outer(np.sin(phase), B) + np.outer(np.cos(phase), 0.5 * B[::-1])
    found = find_rapid(readings(noisy(T, 2) + waves, T), HEALTHY, 1.0)
    assert found is not None and found.effect == "ac_interference"
    assert found.parameters["frequency_hz"] == pytest.approx(hertz, abs=1e-3)
    assert np.sqrt(np.mean((found.change_mgauss - waves) ** 2)) < 0.3


def swinging(seed: int, size: float) -> FloatArray:
    """Return what a vehicle that rolls about once a second, never quite alike, leaves: (N, 3), rms `size`."""
    rng = np.random.default_rng(seed)
    pole = 0.97 * np.exp(2j * np.pi * 1.0 * 0.04)
    waves = np.zeros((T.size, 3), np.complex128)
    for k in range(1, T.size):
        waves[k] = pole * waves[k - 1] + rng.standard_normal(3)
    return np.asarray(size * waves.real / waves.real.std())


def test_line_is_told_from_louder_swings() -> None:
    line = np.outer(np.sin(2.0 * np.pi * 1.9 * T), B)
    swings = swinging(5, 1.2 * float(np.sqrt(np.mean(line**2))))
    found = find_rapid(readings(noisy(T, 6) + swings + line, T), HEALTHY, 1.0)
    assert found is not None and found.effect == "ac_interference"
    assert found.parameters["frequency_hz"] == pytest.approx(1.9, abs=1e-3)
    assert find_rapid(readings(noisy(T, 6) + swings, T), HEALTHY, 1.0) is None


def test_line_is_told_beside_an_error_that_is_far_louder() -> None:
    """As a compass in another orientation leaves it; its own size is no matter there."""
    line = np.outer(np.sin(2.0 * np.pi * 1.4 * T), B)
    wide = swinging(7, 0.3 * float(np.sqrt(np.mean(line**2))))
    wide += 20.0 * np.sign(np.sin(0.9 * T + 3.0 * np.sin(0.11 * T)))[:, None]
    found = find_rapid(readings(noisy(T, 8) + wide + line, T), HEALTHY, 1.0)
    assert found is not None and found.effect == "ac_interference"
    assert found.parameters["frequency_hz"] == pytest.approx(1.4, abs=2e-3)
    restless = readings(noisy(T, 9) + swinging(10, 12.0), T)  # a baseline that is louder than the recording
    found = find_rapid(readings(noisy(T, 8) + line, T), restless, 1.0)
    assert found is not None and found.parameters["frequency_hz"] == pytest.approx(1.4, abs=1e-3)
    toggling = np.where(np.arange(T.size) % 2 == 0, 1.0, -1.0)[:, None] * B
    found = find_rapid(
        readings(noisy(T, 8) + toggling, T), restless, 1.0
    )  # as a line of half the rate would be
    assert found is not None and found.effect == "set_reset_offset"
    found = find_rapid(readings(noisy(T, 8) + wide + toggling, T), HEALTHY, 1.0)
    assert found is not None and found.effect == "set_reset_offset"


def test_the_loudest_line_is_told_not_its_image_in_a_quiet_band() -> None:
    """A line's skirts are its neighbours: a weak one in a quiet band stands out as much."""
    strong = np.outer(np.sin(2.0 * np.pi * 4.3 * T), 8.0 * B)
    image = np.outer(np.sin(2.0 * np.pi * 8.2 * T), B)
    found = find_rapid(readings(noisy(T, 12, 0.1) + strong + image, T), HEALTHY, 1.0)
    assert found is not None and found.parameters["frequency_hz"] == pytest.approx(4.3, abs=1e-3)


def test_laps_driven_alike_are_no_line() -> None:
    """What a vehicle's own motion holds at a frequency, an error that follows it holds, too."""
    waves = np.sin(2.0 * np.pi * 0.9 * T)
    laps = 300.0 * np.stack([np.cos(waves), -np.sin(waves), 0.0 * T], axis=1)
    clipped = np.minimum(laps, 280.0) - laps
    known = np.ones(T.size, dtype=np.bool_)
    assert find_rapid(Readings.of(T, laps + clipped + noisy(T, 13), laps, known), HEALTHY, 1.0) is None
    other = np.outer(np.sin(2.0 * np.pi * 2.3 * T), B)
    found = find_rapid(Readings.of(T, laps + clipped + noisy(T, 13) + other, laps, known), HEALTHY, 1.0)
    assert found is None or found.parameters["frequency_hz"] == pytest.approx(2.3, abs=1e-3)


def test_what_repeats_evenly_has_several_lines_and_is_no_alternating_current() -> None:
    pulses = np.outer(np.where(np.mod(1.7 * T, 1.0) < 0.25, 1.0, 0.0), 2.0 * B)
    restless = readings(noisy(T, 9) + swinging(10, 12.0), T)
    assert find_rapid(readings(noisy(T, 16) + pulses, T), restless, 1.0) is None


def test_a_line_of_the_vehicles_own_is_in_its_baseline() -> None:
    line = np.outer(np.sin(2.0 * np.pi * 1.4 * T), B)
    baseline = readings(noisy(T, 14) + line, T)
    assert find_rapid(readings(noisy(T, 15) + line, T), baseline, 1.0) is None
    found = find_rapid(readings(noisy(T, 15) + 3.0 * line, T), baseline, 1.0)
    assert found is not None and found.effect == "ac_interference"


def test_toggling_is_found_beside_noise_and_beside_a_line() -> None:
    sign = np.where(np.arange(T.size) % 2 == 0, 1.0, -1.0)
    toggling = sign[:, None] * B
    noise = readings(noisy(T, 10, sigma=6.0) + toggling, T)
    found = find_rapid(noise, HEALTHY, 1.0)
    assert found is not None and found.effect == "set_reset_offset"
    rest = noise.without(found.change_mgauss)
    assert math.sqrt(excess_variance(rest, HEALTHY)) == pytest.approx(math.sqrt(6.0**2 - NOISE**2), rel=0.05)

    both = readings(noisy(T, 11) + toggling + np.outer(np.sin(2.0 * np.pi * 5.3 * T), 3.0 * B), T)
    line = find_rapid(both, HEALTHY, 1.0)
    assert line is not None and line.effect == "ac_interference"
    found = find_rapid(both.without(line.change_mgauss), HEALTHY, 1.0)
    assert found is not None and found.effect == "set_reset_offset"


def test_noise_alone_is_neither_toggling_nor_a_line() -> None:
    assert find_rapid(readings(noisy(T, 3, sigma=15.0), T), HEALTHY, 1.0) is None
    assert find_rapid(HEALTHY, HEALTHY, 1.0) is None


def test_white_scatter_is_measured_and_what_is_no_noise_is_not() -> None:
    found = excess_variance(readings(noisy(T, 4, sigma=7.0), T), HEALTHY)
    assert math.sqrt(found) == pytest.approx(math.sqrt(7.0**2 - NOISE**2), rel=0.05)
    rng = np.random.default_rng(5)
    bursts = np.where((T % 30.0 < 3.0)[:, None], 40.0, 0.0) * rng.standard_normal((T.size, 3))
    smooth = 12.0 * np.sin(2.0 * np.pi * 2.0 * T + 3.0 * np.sin(0.3 * T))[:, None] * np.ones(3)
    # A vehicle that swings, seen by a slow compass: three readings are a swing.
    third = np.arange(T.size) * 2.0 * np.pi / 3.0 + 2.0 * np.sin(0.2 * T)
    swing = 6.0 * np.stack([np.sin(third), np.cos(third), 0.5 * np.sin(third)], axis=1)
    assert quiet_scatter(readings(noisy(T, 6) + swing, T)) > 2.0 * NOISE
    # An offset whose sign is anybody's guess, as where readings repeat by chance: all axes at once.
    thrown = rng.choice([-1.0, 1.0], T.size)[:, None] * np.array([8.0, -12.0, 6.0])
    for other in (bursts, smooth, swing, thrown):
        assert excess_variance(readings(noisy(T, 6) + other, T), HEALTHY) == 0.0
    assert excess_variance(readings(noisy(T, 7, sigma=1.3 * NOISE), T), HEALTHY) == 0.0


@pytest.mark.parametrize("share", [0.03, 0.1])
def test_white_scatter_of_few_quiet_readings_is_noise_too(share: float) -> None:
    """Of few pairs of readings some seem to follow each other by chance."""
    told = 0
    for seed in range(40):
        flight = readings(noisy(T, 100 + seed, sigma=7.0), T)
        some = np.arange(T.size) % 100 < round(100.0 * share) + 4
        told += excess_variance(replace(flight, quiet=flight.quiet & some), HEALTHY) > 0.0
    assert told >= 36


def test_what_wanders_in_the_baseline_takes_little_off_the_scatter() -> None:
    """The larger one of two estimates is nearer: readings further apart hold more of a wander."""
    swinging = 30.0 * np.sin(2.0 * np.pi * 1.5 * T)[:, None] * np.ones(3)
    before = readings(noisy(T, 1) + swinging, T)
    assert quiet_scatter(before, 2) > 1.5 * quiet_scatter(before)
    found = excess_variance(readings(noisy(T, 4, sigma=14.0), T), before)
    assert math.sqrt(found) == pytest.approx(math.sqrt(14.0**2 - NOISE**2), rel=0.05)


def test_vehicle_that_is_never_quiet_needs_more_scatter_for_noise() -> None:
    even = np.arange(T.size) % 12 < 1
    for sigma, told in ((1.8 * NOISE, False), (3.0 * NOISE, True)):
        flight = readings(noisy(T, 8, sigma=sigma), T)
        assert excess_variance(flight, HEALTHY) > 0.0
        assert (excess_variance(replace(flight, quiet=flight.quiet & even), HEALTHY) > 0.0) == told
        # Readings that repeat come at uneven times.
        assert (excess_variance(flight, HEALTHY, repeats=True) > 0.0) == told


@given(st.floats(6.0, 60.0), st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_steps_of_a_sensor_are_seen_behind_its_calibration_and_the_messages_rounding(
    step: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(0.02 * np.sin(0.002 * np.arange(3000)))
    field = 350.0 * np.stack([np.cos(yaw), -np.sin(yaw), 0.4 + 0.0 * yaw], axis=1)
    fine = field + rng.uniform(-200.0, 200.0, 3) + NOISE * rng.standard_normal(field.shape)
    calibration = FieldCorrection(offsets_mgauss=(50.0, -80.0, 20.0), diagonals=(1.1, 0.9, 1.05))
    for raw, is_coarse in ((step * np.round(fine / step), True), (fine, False)):
        told = np.trunc(calibration.apply(raw))
        undone = (told + 0.5 * np.sign(told)) @ np.linalg.inv(
            calibration.matrix
        ).T - calibration.offsets_mgauss
        found = coarse_step(undone, np.ones(len(raw), dtype=np.bool_))
        assert found == (pytest.approx(step, rel=0.02) if is_coarse else 0.0)


def test_readings_that_stand_still_lie_on_no_step() -> None:
    rng = np.random.default_rng(8)
    still = np.array([120.0, -40.0, 400.0]) + 0.3 * rng.standard_normal((2000, 3))
    positions = np.repeat(
        np.array([[120.0, 40.0], [-40.0, 120.0], [-120.0, -40.0], [40.0, -120.0]]), 500, axis=0
    )
    dwells = np.column_stack([positions, np.full(2000, 400.0)]) + 0.3 * rng.standard_normal((2000, 3))
    everything = np.ones(2000, dtype=np.bool_)
    assert coarse_step(still, everything) == coarse_step(dwells, everything) == 0.0


def test_a_step_that_no_axis_shows_often_is_seen_on_all_together() -> None:
    """A rover turns on the level, and stands for two thirds of the time: five levels, four and two."""
    rng = np.random.default_rng(9)
    yaw = np.concatenate([np.linspace(0.0, 2.0 * np.pi, 1000), np.zeros(2000)])
    field = np.stack([134.0 * np.cos(yaw), -100.0 * np.sin(yaw), 265.0 + 20.0 * np.sin(yaw)], axis=1)
    fine = field + 2.0 * rng.standard_normal(field.shape)
    everything = np.ones(len(fine), dtype=np.bool_)
    assert coarse_step(np.round(60.0 * np.round(fine / 60.0) + 0.3), everything) == pytest.approx(
        60.0, rel=0.01
    )
    assert coarse_step(np.round(fine), everything) == 0.0
    # Places to stand are no levels.
    for _ in range(30):
        places = np.repeat(rng.uniform(-300.0, 300.0, (6, 3)), 400, axis=0)
        still = np.round(places + 0.5 * rng.standard_normal(places.shape))
        assert coarse_step(still, np.ones(len(still), dtype=np.bool_)) == 0.0


def test_step_is_looked_for_beside_a_constant() -> None:
    # What is there all the time must not hide when something more came.
    time = np.arange(0.0, 60.0, 0.1)
    residual = np.tile([30.0, -20.0, 10.0], (time.size, 1)) + np.where(time >= 21.0, 1.0, 0.0)[:, None] * B
    none = np.zeros_like(residual)
    stimulus = Stimulus.posed(time, np.tile(np.eye(3), (time.size, 1, 1)), none)
    misfit = Misfit(
        Signals(stimulus, Reading(none, none, none)), Reading(residual, none, none),
        np.ones(time.size, dtype=np.bool_), np.full(3, NOISE), False,
    )  # fmt: skip
    starts = catalogue()["hard_iron_step"].starts
    assert starts is not None
    best = min(starts(misfit), key=lambda s: abs(s[3] - 21.0))
    assert best[3] == pytest.approx(21.0, abs=0.1) and best[:3] == pytest.approx(B, abs=1e-6)


def test_what_may_not_be_named_is_not_taken_for_noise_and_stays_in_the_readings() -> None:
    case = make_case(304241175, "single")
    assert [effect for effect, _ in case.effects] == ["set_reset_offset"]
    now, before = (replay(t, 1, "auto", 0.3) for t in (case.track, case.baseline) if t is not None)
    traces, left = detect(now, before, 2.0, 2.6, frozenset({"noise_excess"}), exact=False)
    assert not traces.causes and traces.excess_mgauss2 == 0.0 and left is now


def test_replay_without_an_effect_is_that_of_rows_and_readings_without_it() -> None:
    case = make_case(304241175, "single")
    plain = replay(case.track, 1, "auto", 0.3)
    change = np.random.default_rng(9).standard_normal(plain.readings.error_mgauss.shape)
    mended = plain.without(change)
    assert plain.averaged == 5
    assert plain.corrected_mgauss is not None and mended.corrected_mgauss is not None
    assert mended.readings.error_mgauss == pytest.approx(plain.readings.error_mgauss - change)
    of_rows = plain.measured.mag_mgauss - mended.measured.mag_mgauss
    assert of_rows[7] == pytest.approx(change[35:40].mean(axis=0))
    of_corrected = plain.corrected_mgauss - mended.corrected_mgauss
    assert of_corrected == pytest.approx(of_rows @ plain.iron.correction.matrix.T)


def test_how_far_a_gyro_turns_while_a_reading_stays() -> None:
    time_s = np.arange(0.0, 20.0, 0.1)
    field = np.stack([np.arange(time_s.size) * 1.0] * 3, axis=1)
    field[50:100] = field[50]
    rate = np.zeros((time_s.size, 3))
    rate[:, 1] = 0.009  # a bias
    rate[60:70, 2] = 0.5
    trace = inspect(field, np.ones(time_s.size, dtype=np.bool_), time_s, Series.of(time_s, rate))
    hold = int(np.argmax(trace.held_s))
    assert trace.held_s[hold] == pytest.approx(4.9)
    assert trace.turned_rad[hold] == pytest.approx(0.5, abs=0.03)
    assert trace.turned_rad[0] == trace.turned_rad[-1] == 0.0
    assert np.isinf(inspect(field, np.ones(time_s.size, dtype=np.bool_), time_s).turned_rad[hold])


@pytest.mark.parametrize(
    ("held_s", "jump_mgauss", "step_mgauss", "turned_deg", "frozen"),
    [
        (1.4, 58.0, 58.0, 30.0, False),  # coarse numbers stay until the field has moved by a step
        (1.4, 174.0, 58.0, 30.0, True),
        (1.4, 6.0, 1.0, 3.0, True),
        (1.4, 4.0, 1.0, 3.0, False),
        (6.0, math.inf, 1.0, 3.0, True),  # it has not woken yet
        (6.0, 58.0, 58.0, 30.0, False),
        (6.0, math.inf, 58.0, 30.0, False),  # nor need coarse numbers have moved before the end
        (0.2, 60.0, 1.0, 30.0, False),
        # A compass without noise stands still, to the end or until the vehicle turns away.
        (6.0, math.inf, 1.0, 0.0, False),
        (6.0, 30.0, 1.0, 1.0, False),
        (6.0, 2.0, 1.0, 3.0, False),
    ],
)
def test_a_frozen_compass_misses_a_turn_and_jumps_when_it_wakes(
    held_s: float, jump_mgauss: float, step_mgauss: float, turned_deg: float, frozen: bool
) -> None:
    time_s = np.arange(0.0, 60.0, 0.2)
    held, jump = np.zeros(time_s.size), np.full(time_s.size, 3.0)
    turned = np.zeros(time_s.size)
    held[100], jump[100], turned[100] = held_s, jump_mgauss, math.radians(turned_deg)
    trace = Trace(0.0, np.zeros(time_s.size, dtype=np.bool_), held, time_s, jump, turned, step_mgauss)
    still = SimpleNamespace(nominal_mgauss=np.zeros((time_s.size, 3)))
    alike = {"telemetry": True, "time_s": time_s, "readings": still, "resolution_mgauss": 0.3}
    flight: Any = SimpleNamespace(trace=trace, **alike)
    baseline: Any = SimpleNamespace(trace=replace(trace, held_s=np.zeros(time_s.size)), **alike)
    assert names_stale(flight, baseline) is frozen
    assert stale_share(flight, baseline) == pytest.approx(held_s / 59.8 if frozen else 0.0)


def told(
    stale: float,
    seed: int,
    *,
    reading_s: float = 0.1,
    lost: float = 0.0,
    whole: bool = False,
    turning: bool = True,
    after_s: float | None = None,
) -> Any:
    """Read a compass every so often, some readings again, and report it every 40 ms, as a replay sees it.

    At any time after a reading, or at one, give or take a millisecond.
    """
    rng = np.random.default_rng(seed)
    message_s = (rng.uniform(0.0, 0.04) if after_s is None else after_s) + np.arange(0.0, 120.0, 0.04)
    if after_s is not None:
        message_s = np.maximum(message_s + 1e-3 * rng.standard_normal(message_s.size), 0.0)
    message_s = message_s[rng.random(message_s.size) >= lost]
    field = 200.0 * np.stack([f(0.5 * turning * message_s) for f in (np.cos, np.sin, np.ones_like)], axis=1)
    tick = np.floor(message_s / reading_s).astype(np.int64)
    taken = rng.random(tick[-1] + 1) >= stale
    taken[0] = True
    of = np.maximum.accumulate(np.where(taken, np.arange(taken.size), 0))[tick]
    noise = rng.standard_normal((taken.size, 3))
    first = np.searchsorted(tick, of)
    seen = field[first] + 0.3 * noise[of]
    trace = inspect(np.round(seen) if whole else seen, np.ones(message_s.size, dtype=np.bool_), message_s)
    fresh = np.searchsorted(message_s, trace.fresh_s)
    return SimpleNamespace(
        telemetry=True,
        trace=replace(trace, step_mgauss=float(whole)),
        time_s=trace.fresh_s,
        readings=SimpleNamespace(nominal_mgauss=field[fresh]),
        resolution_mgauss=1.0 / math.sqrt(12.0) if whole else 0.0,
    )


@pytest.mark.parametrize("reading_s", [0.1, 0.04])
@pytest.mark.parametrize("lost", [0.0, 0.03])
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_readings_that_do_not_come_are_missed(
    share: float, whole: bool, lost: float, reading_s: float
) -> None:
    """A compass that is read more slowly than it is reported repeats itself, but evenly."""
    alike: Any = {"reading_s": reading_s, "lost": lost, "whole": whole}
    baseline = told(0.0, 1, **alike)
    flight = told(share, 2, **alike)
    assert names_stale(flight, baseline) is (share > 0.0)
    found = stale_share(flight, baseline)
    assert found == pytest.approx(share, abs=0.02, rel=0.25)


def test_messages_as_often_as_readings_may_fall_on_either_side_of_them() -> None:
    baseline, flight = told(0.0, 1, reading_s=0.04, after_s=0.02), told(0.0, 2, reading_s=0.04, after_s=0.001)
    assert np.mean(np.diff(flight.trace.fresh_s) > 0.06) > 0.1
    assert stale_share(flight, baseline) == 0.0
    missed = told(0.2, 3, reading_s=0.04, after_s=0.001)
    assert names_stale(missed, baseline)


def test_whole_numbers_of_a_vehicle_that_stands_still_repeat_by_chance() -> None:
    baseline = told(0.0, 1, reading_s=0.04, whole=True)
    assert stale_share(told(0.0, 2, reading_s=0.04, whole=True, turning=False), baseline) == 0.0


def test_messages_in_another_rhythm_tell_nothing_of_readings_that_do_not_come() -> None:
    baseline, flight = told(0.0, 1), told(0.3, 2)
    slower = replace(baseline.trace, fresh_s=2.0 * baseline.trace.fresh_s, held_s=2.0 * baseline.trace.held_s)
    baseline.trace = slower
    assert _overdue_share(flight, baseline) == 0.0
    assert _overdue_share(flight, None) == 0.0


# --- how much noise there is -----------------------------------------------------------------------------


def test_the_doubt_of_the_quiet_scatter_is_what_it_scatters_by() -> None:
    told = [readings(noisy(T, seed, 6.0), T) for seed in range(60)]
    squares = np.array([quiet_scatter(one) ** 2 for one in told])
    doubt = quiet_doubt(told[0])
    assert squares.std() / squares.mean() == pytest.approx(doubt, rel=0.3)
    assert squares.mean() == pytest.approx(36.0, rel=3.0 * doubt / math.sqrt(60.0) + 0.02)


def freezing(from_s: int) -> tuple[Track, Track]:
    """Return a flight of a minute, and the same with a compass that says one thing from a moment on."""
    live = make_track(Recipe("figure-8", duration_s=60.0, rate_hz=10.0, seed=2))
    live = replace(live, autopilot="ardupilot")
    values = np.array(live.compasses[1].reported.values)
    values[10 * from_s :] = values[10 * from_s]
    compass = replace(live.compasses[1], reported=Series.of(live.compasses[1].time_s, values))
    return live, replace(live, compasses={1: compass})


@pytest.mark.parametrize("beside_a_baseline", [True, False])
def test_a_compass_that_says_the_same_throughout_is_frozen(beside_a_baseline: bool) -> None:
    """It was refused for too few readings, which a person would answer by recording once more."""
    live, frozen = freezing(0)
    diagnosis = diagnose_gap(frozen, live if beside_a_baseline else None)
    assert diagnosis.effects == {"stale_samples"} and diagnosis.verdict == "named_with_remainder"
    assert diagnosis.causes[0].parameters["fraction"] > 0.97


@pytest.mark.parametrize("from_s", [20, 40])
def test_a_compass_that_freezes_on_the_way_is_told_without_a_baseline(from_s: int) -> None:
    """It was "nothing to do": repeats are telemetry's nature, but not for as long while the vehicle turns."""
    diagnosis = diagnose_gap(freezing(from_s)[1])
    assert diagnosis.effects == {"stale_samples"}
    assert diagnosis.causes[0].parameters["fraction"] == pytest.approx(1.0 - from_s / 60.0, abs=0.05)


def test_a_compass_of_a_vehicle_that_stands_still_may_say_the_same() -> None:
    frozen = freezing(0)[1]
    assert frozen.gyro_radps is not None
    resting = Series.of(frozen.gyro_radps.time_s, np.zeros_like(frozen.gyro_radps.values))
    with pytest.raises(BadRecording, match="too few"):
        diagnose_gap(replace(frozen, gyro_radps=resting))
