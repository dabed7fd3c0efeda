"""Readings that are late, or turned, beside the truth in closed form."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from mavcompass.frames import rotate_back
from mavcompass.simulation.effects import catalogue
from mavcompass.simulation.effects.causes.timing import late_field
from mavcompass.simulation.effects.effect import Misfit, Signals
from mavcompass.simulation.effects.sampling import (
    at_times,
    first_order_lag,
    rotation_at,
    smoothed_at,
    thinned,
)
from mavcompass.simulation.physics.signals import Reading, RecordedStimulus, Stimulus, Turning

FIELD = np.array([220.0, 15.0, 430.0])


def about_down(yaw: np.ndarray) -> np.ndarray:
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros(yaw.size)
    rows = np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], axis=1)
    return rows.reshape(-1, 3, 3)


def swinging(time_s: np.ndarray, iron_mgauss: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Signals:
    """Swing by 0.3 rad at 1.2 Hz, three readings a swing, while turning on."""
    speed = 2.0 * np.pi * 1.2
    yaw = 0.2 * time_s + 0.3 * np.sin(speed * time_s)
    rate = np.stack([0 * yaw, 0 * yaw, 0.2 + 0.3 * speed * np.cos(speed * time_s)], axis=1)
    rotation, n = about_down(yaw), time_s.size
    field, none = np.tile(FIELD, (n, 1)), np.zeros((n, 3))
    stimulus = Stimulus.posed(time_s, rotation, field, rate_radps=rate)
    return Signals(stimulus, Reading(rotate_back(rotation, field) + np.array(iron_mgauss), none, none))


@pytest.mark.parametrize("late_s", [0.04, 0.15, 0.2])
@pytest.mark.parametrize("yaw_off_rad", [0.0, 0.3])
def test_late_readings_of_a_recording_turn_as_it_tells_between_them(
    late_s: float, yaw_off_rad: float
) -> None:
    """Readings far apart beside an attitude that is known more finely, whose yaw is off besides."""
    matrix = np.array([[0.0, 1.1, 0.0], [-0.8, 0.0, 0.0], [0.0, 0.05, 1.0]])
    fine, picked = np.arange(0.0, 30.0, 0.05), slice(2, None, 6)
    told, time = swinging(fine).stimulus, fine[picked]
    off = about_down(np.full(time.size, yaw_off_rad))

    def seen(when_s: np.ndarray) -> np.ndarray:
        rotation = off[: when_s.size] @ swinging(when_s).stimulus.rotation
        return rotate_back(rotation, np.tile(FIELD, (when_s.size, 1))) @ matrix.T + 40.0

    plain = swinging(time).stimulus
    moved = {**{f.name: getattr(plain, f.name) for f in fields(plain)}, "rotation": off @ plain.rotation}
    turning = Turning(fine, told.rotation, told.rate_radps, plain.rotation)
    recorded = RecordedStimulus(**moved, turning=turning)
    reading = Reading(seen(time), np.zeros((time.size, 3)), np.zeros((time.size, 3)))
    true = seen(time - late_s)
    finely, coarsely = (
        np.sqrt(np.mean((late_field(Signals(stimulus, reading), time - late_s) - true)[2:-2] ** 2))
        for stimulus in (recorded, Stimulus(**moved))
    )
    assert finely < 0.1 and (late_s < 0.1 or coarsely > 20.0 * finely)


@pytest.mark.parametrize("time_constant_s", [0.01, 0.06, 0.4])
@pytest.mark.parametrize("late_s", [0.0, 0.07])
def test_smoothed_readings_of_a_recording_turn_as_it_tells_between_them(
    time_constant_s: float, late_s: float
) -> None:
    """Readings three a swing beside an attitude of eight times as many, and what a low pass makes of a
    thousand a second."""
    every, fine, picked = np.arange(0.0, 30.0, 0.001), np.arange(0.0, 30.0, 0.03), slice(2, None, 9)
    matrix = np.array([[0.0, 1.1, 0.0], [-0.8, 0.0, 0.0], [0.0, 0.05, 1.0]])
    told, time = swinging(fine).stimulus, fine[picked]
    seen = swinging(every).reading.mag_mgauss @ matrix.T + 40.0
    low_passed, _ = first_order_lag(every, seen, time_constant_s)
    true = at_times(every, low_passed, time - late_s)
    plain = swinging(time)
    now = {f.name: getattr(plain.stimulus, f.name) for f in fields(plain.stimulus)}
    turning = Turning(fine, told.rotation, told.rate_radps, plain.stimulus.rotation)
    reading = replace(plain.reading, mag_mgauss=plain.reading.mag_mgauss @ matrix.T + 40.0)
    recorded = Signals(RecordedStimulus(**now, turning=turning), reading)
    made = late_field(recorded, time - late_s, time_constant_s=time_constant_s)
    rows = time > 8.0 * time_constant_s + 0.2
    off, coarsely = (
        np.sqrt(np.mean((found - true)[rows] ** 2))
        for found in (
            made,
            first_order_lag(time, at_times(time, reading.mag_mgauss, time - late_s), time_constant_s)[0],
        )
    )
    assert off < 0.05 and coarsely > 20.0 * off
    if not late_s:
        low_pass = catalogue()["low_pass"].forward(recorded, np.array([time_constant_s]), {}, None)
        np.testing.assert_array_equal(low_pass.reading.mag_mgauss, made)


@pytest.mark.parametrize("time_constant_s", [1e-6, 0.02, 0.3, 20.0])
def test_low_pass_of_cubic_pieces_is_exact(time_constant_s: float) -> None:
    """Of x = t^3 beside x = 1 it is x - tau dx + tau^2 d2x - tau^3 d3x, and what it began with fades."""
    time = np.array([0.0, 0.03, 0.2, 0.24, 0.9, 1.0, 1.7, 2.0])
    values = np.stack([time**3, np.ones(time.size)], axis=1)
    slopes = np.stack([3.0 * time**2, np.zeros(time.size)], axis=1)
    wanted, tau = np.linspace(0.0, 2.0, 41), time_constant_s
    settled = wanted**3 - 3.0 * tau * wanted**2 + 6.0 * tau**2 * wanted - 6.0 * tau**3
    true = settled + 6.0 * tau**3 * np.exp(-wanted / tau)
    found = smoothed_at(time, values, wanted, slopes, tau)
    np.testing.assert_allclose(found[:, 0], true, atol=1e-9)
    np.testing.assert_allclose(found[:, 1], 1.0, atol=1e-9)


def test_low_pass_holds_its_input_outside() -> None:
    time = np.array([0.0, 0.1, 0.2])
    values, flat = np.array([[5.0], [5.0], [5.0]]), np.zeros((3, 1))
    assert smoothed_at(time, values, np.array([-1.0, 0.15, 9.0]), flat, 0.05) == pytest.approx(5.0)
    assert smoothed_at(time[:1], values[:1], np.array([3.0]), flat[:1], 0.05) == pytest.approx(5.0)


@pytest.mark.parametrize(("step_s", "every"), [(0.01, 4), (0.02, 4), (0.05, 2), (0.1, 1)])
def test_rotations_are_left_out_where_the_others_and_their_rates_tell_them(step_s: float, every: int) -> None:
    """A swing of 0.83 s: a cubic between samples errs by the fourth power of their distance."""
    time = np.arange(0.0, 30.0, step_s)
    told = swinging(time).stimulus
    whole = Turning(time, told.rotation, told.rate_radps, told.rotation)
    fewer = thinned(whole)
    assert fewer.time_s.size == pytest.approx(time.size / every, abs=2)
    assert (fewer.time_s[0], fewer.time_s[-1]) == (time[0], time[-1])
    wanted = time[:-1] + 0.3 * step_s
    field = rotate_back(rotation_at(fewer, wanted), np.broadcast_to(FIELD, (wanted.size, 3)))
    coarsely = rotate_back(rotation_at(whole, wanted), np.broadcast_to(FIELD, (wanted.size, 3)))
    assert np.abs(field - coarsely).max() < 0.5
    # One sample that stands apart is left in, with all others.
    jolted = told.rotation.copy()
    jolted[time.size // 2 + 1] = about_down(np.array([0.5]))[0]
    assert thinned(replace(whole, rotation=jolted)).time_s.size == time.size


@pytest.mark.parametrize("offset_mgauss", [0.0, 300.0])
def test_late_readings_of_a_turned_compass_turn_as_the_field_does(offset_mgauss: float) -> None:
    """A quarter turn of the mounting, gains of 0.8 and 1.1, and iron that never turns."""
    matrix = np.array([[0.0, 1.1, 0.0], [-0.8, 0.0, 0.0], [0.0, 0.05, 1.0]])
    time, late_s = np.arange(0.0, 30.0, 0.27), 0.04

    def seen(when_s: np.ndarray) -> np.ndarray:
        return swinging(when_s).reading.mag_mgauss @ matrix.T + offset_mgauss

    upright = swinging(time)
    off, usual = (
        np.sqrt(np.mean((found - seen(time - late_s))[2:-2] ** 2))
        for found in (
            late_field(upright.with_mag(seen(time)), time - late_s),
            at_times(time, seen(time), time - late_s),
        )
    )
    assert off < 1.5 and usual > 5.0 * off


def test_late_readings_are_the_same_however_time_is_cut() -> None:
    time = np.arange(0.0, 20.0, 0.05)
    lag = catalogue()["transport_lag"]
    theta = np.array([0.11])
    whole = lag.forward(swinging(time), theta, {}, None).reading.mag_mgauss
    memory: dict[str, object] = {}
    pieces = [
        lag.forward(swinging(piece), theta, memory, None).reading.mag_mgauss
        for piece in np.array_split(time, 7)
    ]
    np.testing.assert_allclose(np.concatenate(pieces), whole, atol=1e-9)


@pytest.mark.parametrize("number", [4, 12, 16, 25])
@pytest.mark.parametrize("yaw_off_rad", [0.0, 2.2])
def test_orientation_is_guessed_beside_strong_iron_and_an_unknown_yaw(
    number: int, yaw_off_rad: float
) -> None:
    """Where only turns about the vertical are seen, turns about it are told apart by the iron alone."""
    signals = swinging(np.arange(0.0, 60.0, 0.2), (-240.0, 130.0, 20.0))
    orientation = catalogue()["orientation"]
    measured = orientation.forward(signals, np.array([float(number)]), {}, None).reading.mag_mgauss
    turned = about_down(np.full(signals.stimulus.time_s.size, yaw_off_rad)) @ signals.stimulus.rotation
    iron = signals.reading.mag_mgauss - rotate_back(
        signals.stimulus.rotation, signals.stimulus.field_ned_mgauss
    )
    believed = Signals(
        replace(signals.stimulus, rotation=turned),
        replace(signals.reading, mag_mgauss=rotate_back(turned, signals.stimulus.field_ned_mgauss) + iron),
    )
    left = replace(signals.reading, mag_mgauss=measured - believed.reading.mag_mgauss)
    rows = np.ones(signals.stimulus.time_s.size, dtype=bool)
    assert orientation.starts is not None
    first = orientation.starts(Misfit(believed, left, rows, np.ones(3), yaw_unknown=yaw_off_rad != 0.0))[0]
    assert float(first[0]) == number
