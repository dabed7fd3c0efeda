"""What the watch over a compass in service finds, and what it lets pass."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.earth_field import EarthField
from mavcompass.frames import euler_to_matrix
from mavcompass.heading.live import Heading
from mavcompass.messages import Incoming, RawImu, ScaledImu2
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import WatchConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import CompassWatch, Glance

WORLD = EarthField((206.155, 0.0, 400.0))
DEG = math.pi / 180.0


def heading(
    time_s: float,
    magnetic_rad: float,
    instance: int = 1,
    scale: float = 1.0,
    dip_deg: float = 0.0,
    turned_rad: float = 0.0,
) -> Heading:
    dip = WORLD.inclination_rad + dip_deg * DEG
    total = WORLD.total_mgauss * scale
    level = (
        total * math.cos(dip) * math.cos(magnetic_rad),
        -total * math.cos(dip) * math.sin(magnetic_rad),
        total * math.sin(dip),
    )
    wrapped = magnetic_rad % (2.0 * math.pi)
    return Heading(time_s, time_s, instance, wrapped, wrapped, 0.01, level, turned_rad)


def found(
    see: Callable[[float], Glance], seconds: float = 60.0, watch: CompassWatch | None = None
) -> set[str]:
    watch = watch or CompassWatch(WatchConfig())
    for k in range(int(seconds * 10)):
        watch.update(see(0.1 * k))
    return {f"{finding.id}{finding.instance}" for finding in watch.findings}


def test_two_looks_at_all_but_the_same_moment_are_let_pass() -> None:
    watch = CompassWatch(WatchConfig())
    for time_s in (1.0, math.nextafter(1.0, 2.0)):
        assert watch.update(replace(glance(time_s, heading(time_s, 0.2)), current_a=4.0)) == ()


def glance(time_s: float, *headings: Heading) -> Glance:
    return Glance(
        time_s, {h.instance: h for h in headings}, WORLD, 0.0, 0.0, False, 0.0, "unknown", None, 0.0, None
    )


def test_a_good_compass_is_let_pass_standing_turning_and_driving() -> None:
    def see(t: float) -> Glance:
        turned = 0.3 * t
        first = heading(t, turned, turned_rad=turned)
        quiet = glance(t, first, heading(t, turned + 2.0 * DEG, 2, turned_rad=turned))
        return replace(quiet, rate_radps=0.3, kind="boat", speed_mps=3.0, current_a=10 + 5 * math.sin(t))

    assert found(see) == set()


@pytest.mark.parametrize(
    ("scale", "dip_deg", "expected"),
    [(1.12, 0.0, {"field1"}), (0.85, 0.0, {"field1"}), (1.0, 6.0, {"dip1"}), (1.05, 3.0, set())],
)
def test_a_field_that_the_world_does_not_have_is_found(
    scale: float, dip_deg: float, expected: set[str]
) -> None:
    assert found(lambda t: glance(t, heading(t, 1.0, 1, scale, dip_deg))) == expected


@pytest.mark.parametrize(
    ("level_deg", "dip_deg", "course_deg", "expected"),
    [
        (2.0, 5.5, 0.0, set()),  # hypot(4, 2 x 2) = 5.66
        (2.0, -5.8, 0.0, {"dip1"}),
        (3.0, 0.0, 16.5, set()),  # hypot(12, 2 x 3 x 1.94) = 16.7
        (3.0, 0.0, -17.0, {"course1"}),
    ],
)
def test_two_sigmas_of_the_level_excuse_the_dip_and_a_heading_as_often_as_the_field_is_steep(
    level_deg: float, dip_deg: float, course_deg: float, expected: set[str]
) -> None:
    def see(t: float) -> Glance:
        ahead = replace(glance(t, heading(t, 1.0, dip_deg=dip_deg)), kind="boat", speed_mps=3.0)
        return replace(ahead, tilt_sigma_rad=level_deg * DEG, course_rad=1.0 + course_deg * DEG)

    assert found(see) == expected


def test_compasses_that_disagree_are_found() -> None:
    assert found(lambda t: glance(t, heading(t, 6.2), heading(t, 0.2, 2))) == {"agreement2"}


def test_the_compass_that_two_others_outvote_is_the_one_found() -> None:
    watch = CompassWatch(WatchConfig())
    see = [heading(0.0, 1.0 + 26.0 * DEG), heading(0.0, 1.0, 2), heading(0.0, 1.0 + 0.5 * DEG, 3)]
    at = lambda t: glance(t, *(replace(h, time_s=t) for h in see))  # noqa: E731
    assert found(at, watch=watch) == {"agreement1"}
    (finding,) = watch.findings
    assert finding.text == "Compass 1 is 26 deg from compasses 2 and 3, which agree."
    assert finding.short == "Compass 1: +26 deg off the others"


def test_a_heading_that_does_not_follow_the_gyro_is_found_after_a_turn() -> None:
    def see(t: float) -> Glance:
        turned = 0.3 * t
        bent = turned + 20.0 * DEG * math.sin(turned)
        return replace(glance(t, heading(t, bent, turned_rad=turned)), rate_radps=0.3)

    assert found(see) == {"gyro1"}
    assert found(lambda t: see(t) if t < 0.1 else see(0.0), 30.0) == set()
    # Nor is a compass blamed for what the level may be off by: three degrees, twice as much by the dip.
    assert found(lambda t: replace(see(t), tilt_sigma_rad=3.5 * DEG)) == set()


def tossed_about(late_s: float, lean_deg: float, iron_mgauss: float = 0.0) -> tuple[set[str], float]:
    """Fly jerky turns while leaning to and fro; what was found, and the heading's error, rms degrees.

    A compass is read ten times a second, some time late, and its reading repeated, as autopilots do.
    """
    chance, step_s, lean = np.random.default_rng(7), 0.0125, lean_deg * DEG
    times = np.arange(int(90.0 / step_s)) * step_s
    yaws = np.cumsum(np.repeat(chance.uniform(-2.5, 2.5, -(-times.size // 64)), 64)[: times.size] * step_s)
    stood = euler_to_matrix(lean * np.sin(4.0 * times), lean * np.sin(3.1 * times + 1.0), yaws)
    turned = np.swapaxes(np.concatenate([np.eye(3)[np.newaxis], stood[:-1]]), 1, 2) @ stood / step_s
    # How each saw the Earth's field, felt gravity's force and turned.
    fields, forces = stood.swapaxes(1, 2) @ WORLD.ned_mgauss, -1000.0 * stood[:, 2]
    rates = 1e3 * turned[:, [2, 0, 1], [1, 2, 0]]
    seen = VehicleView(VehicleIdentity(1, 1, "ardupilot", "copter"), "key", 2026.0)
    watch, said, off, mag = CompassWatch(WatchConfig()), set(), [], dict[str, int]()
    for k, (t, yaw) in enumerate(zip(times.tolist(), yaws.tolist(), strict=True)):
        if k % 8 == 0:
            field = fields[k - min(round(late_s / step_s), k)] + (iron_mgauss, 0.0, 0.0)
            mag = dict(zip(("xmag", "ymag", "zmag"), map(int, field), strict=True))
        if k % 2 == 0:
            imu = dict(zip(("xacc", "yacc", "zacc"), map(int, forces[k]), strict=True))
            imu |= dict(zip(("xgyro", "ygyro", "zgyro"), map(int, rates[k]), strict=True))
            seen.hear(Incoming(t, 1, 1, RawImu(time_usec=int(t * 1e6), **imu, **mag)))
        if k % 8 == 5:
            seen.hear(Incoming(t, 1, 1, ScaledImu2(time_boot_ms=int(t * 1e3), **mag)))
            said |= {finding.id for finding in watch.update(replace(seen.glance(t), world=WORLD))}
            if t > 10.0:
                off.append(math.remainder(seen.compasses[1].latest.magnetic_rad - yaw, 2.0 * math.pi) / DEG)
    return said, float(np.sqrt(np.mean(np.square(off))))


@pytest.mark.parametrize("late_s", [0.0125, 0.075, 0.1625])
def test_how_late_a_reading_is_in_sharp_bends_is_not_blamed_on_the_compass(late_s: float) -> None:
    said, off_deg = tossed_about(late_s, 15.0)
    # At 83 degrees a second, rms, a tenth of a second is 8 degrees.
    assert said == set() and off_deg < 10.0
    assert tossed_about(late_s, 0.0, iron_mgauss=60.0)[0] >= {"gyro"}


def test_what_a_gyro_drifts_by_on_long_straight_legs_is_not_blamed_on_the_compass_in_the_next_bend() -> None:
    def see(t: float) -> Glance:
        bend, leg = divmod(t, 60.0)
        truly = bend * 90.0 * DEG + max(leg - 57.0, 0.0) * 30.0 * DEG
        return glance(t, heading(t, truly, turned_rad=truly + 0.2 * DEG * t))

    watch, said = CompassWatch(WatchConfig()), set()
    for k in range(6000):
        said |= {f.id for f in watch.update(see(0.1 * k))}
    assert said == set()


@pytest.mark.parametrize(("iron_deg", "expected"), [(0.0, set()), (20.0, {"gyro1"})])
@pytest.mark.parametrize("noise_deg", [0.0, 5.4])  # as that of PX4's own simulator
@pytest.mark.parametrize(("rate_radps", "drift_deg"), [(0.3, 0.05), (0.1, 0.25), (0.2, -0.35), (0.04, 0.0)])
def test_a_gyro_drift_or_noise_is_not_blamed_on_the_compass_however_gently_it_turns(
    rate_radps: float, drift_deg: float, noise_deg: float, iron_deg: float, expected: set[str]
) -> None:
    chance = np.random.default_rng(3)

    def see(t: float) -> Glance:
        truly = 1.2 * math.sin(rate_radps * t) + 0.02 * noise_deg * DEG * chance.normal()
        bent = truly + iron_deg * DEG * math.cos(truly + 0.5) + noise_deg * DEG * chance.normal()
        return glance(t, heading(t, bent, turned_rad=truly + drift_deg * DEG * t))

    assert found(see, 240.0) == expected


@pytest.mark.parametrize(
    ("kind", "off_deg", "speed_mps", "expected"),
    [
        ("boat", 20.0, 3.0, {"course1"}),
        ("boat", 5.0, 3.0, set()),
        ("boat", 20.0, 1.6, {"course1"}),
        ("boat", 20.0, 1.4, set()),
        ("boat", 180.0, 3.0, set()),  # it drives backwards
        ("copter", 60.0, 8.0, set()),  # flies sideways as it likes
        ("sub", 60.0, 1.6, set()),
    ],
)
def test_a_heading_off_the_course_of_a_vehicle_that_drives_ahead_is_found(
    kind: str, off_deg: float, speed_mps: float, expected: set[str]
) -> None:
    def see(t: float) -> Glance:
        course = 1.0 + off_deg * DEG
        return replace(glance(t, heading(t, 1.0)), kind=kind, course_rad=course, speed_mps=speed_mps)

    assert found(see) == expected


@pytest.mark.parametrize("axis", [0, 2], ids=["ahead", "below"])
@pytest.mark.parametrize(("mgauss_per_a", "expected"), [(2.5, {"current1"}), (0.2, set())])
def test_a_field_that_goes_with_the_current_is_found(
    mgauss_per_a: float, expected: set[str], axis: int
) -> None:
    def see(t: float) -> Glance:
        current = 15.0 + 10.0 * math.sin(0.8 * t)
        h = heading(t, 0.0)
        forward, right, down = (
            field + mgauss_per_a * (current - 15.0) * (k == axis) for k, field in enumerate(h.level_mgauss)
        )
        disturbed = replace(h, level_mgauss=(forward, right, down))
        return replace(glance(t, disturbed), current_a=current)

    assert found(see, 90.0) - {"dip1", "field1"} == expected


@pytest.mark.parametrize(("mgauss_per_a", "told"), [(0.0, False), (2.5, True)])
def test_iron_is_not_told_for_a_current_that_goes_with_the_way(mgauss_per_a: float, told: bool) -> None:
    def see(t: float) -> Glance:
        turned = 2.0 * math.sin(0.15 * t)
        current = 15.0 + 8.0 * math.sin(turned) + 4.0 * math.sin(0.8 * t)  # against the wind it takes more
        h = heading(t, turned, turned_rad=turned)
        ahead, right, down = h.level_mgauss
        bent = replace(h, level_mgauss=(ahead + 60.0, right - 80.0, down + mgauss_per_a * (current - 15.0)))
        return replace(glance(t, bent), current_a=current)

    assert ("current1" in found(see, 90.0)) is told


def test_a_short_disturbance_is_not_a_finding_and_a_finding_goes_when_its_cause_goes() -> None:
    watch = CompassWatch(WatchConfig())

    def see(t: float) -> Glance:
        bad = 10.0 <= t < 12.0 or 40.0 <= t < 100.0
        return glance(t, heading(t, 1.0, scale=1.3 if bad else 1.0))

    told = [[finding.value for finding in watch.update(see(0.1 * k))] for k in range(2000)]
    assert not any(told[:400]) and all(told[600:1000]) and not any(told[1600:])
    # What is about to go is told as it was while it stood, not as next to nothing.
    assert min(value for values in told for value in values) > 0.6 * watch.limits.field_percent


def test_a_finding_says_what_to_do_and_fits_a_statustext() -> None:
    watch = CompassWatch(WatchConfig())
    found(lambda t: glance(t, heading(t, 1.0, scale=1.5)), 60.0, watch)
    finding = watch.findings[0]
    assert "50 % stronger" in finding.text
    assert finding.remedy
    assert len(finding.short) <= 50


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("limits", "severity"), [(2.4, "warning"), (2.6, "bad")])
def test_two_and_a_half_times_the_limit_is_bad(limits: float, severity: str, sign: float) -> None:
    watch = CompassWatch(WatchConfig())
    scale = 1.0 + sign * 0.01 * limits * watch.limits.field_percent
    assert found(lambda t: glance(t, heading(t, 1.0, scale=scale)), watch=watch) == {"field1"}
    assert watch.findings[0].severity == severity


def test_nothing_is_learnt_across_a_silence() -> None:
    watch = CompassWatch(WatchConfig())
    watch.update(glance(0.0, heading(0.0, 1.0, scale=2.0)))
    watch.update(glance(500.0, heading(500.0, 1.0, scale=2.0)))
    assert watch.findings == ()


def test_a_compass_that_fell_silent_is_not_judged_on_old_readings() -> None:
    assert found(lambda t: glance(t, heading(0.0, 1.0, scale=2.0))) == set()
