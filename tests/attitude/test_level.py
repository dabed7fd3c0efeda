"""Roll and pitch, reading by reading: at rest, turning, silent, and by what a live vehicle says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from driven import driven

from mavcompass import messages as mav
from mavcompass.attitude import Level
from mavcompass.attitude.recorded import hear
from mavcompass.attitude.standing import LOOK_S, Standing
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS, STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
DEG = math.radians(1.0)
Vector = tuple[float, float, float]


def in_body(roll: float, pitch: float, yaw: float, ned: Vector) -> Vector:
    x, y, z = euler_to_matrix(roll, pitch, yaw).T @ np.array(ned)
    return float(x), float(y), float(z)


def leaning(roll: float, pitch: float, vehicle: str = "unknown") -> Level:
    level = Level(vehicle)
    level.update(0.0, in_body(roll, pitch, 0.0, (0.0, 0.0, -G)), (0.0, 0.0, 0.0))
    return level


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.5, -0.4), (-1.2, 0.7), (2.8, 0.2), (0.3, 1.5)])
def test_the_first_reading_is_taken_for_gravity_and_doubted(roll: float, pitch: float) -> None:
    level = leaning(roll, pitch)
    assert (level.roll_rad, level.pitch_rad) == pytest.approx((roll, pitch))
    assert level.sigma_rad == pytest.approx(8.0 * DEG, rel=0.01)


def test_what_stands_still_is_known_to_a_tenth_of_a_degree_in_seconds() -> None:
    level, chance = leaning(0.2, -0.1, "rover"), np.random.default_rng(3)
    force = np.array(in_body(0.2, -0.1, 0.0, (0.0, 0.0, -G)))
    for k in range(1, 200):
        x, y, z = force + chance.normal(0.0, 0.03, 3)
        level.update(0.05 * k, (x, y, z), (0.0, 0.0, 0.0))
    assert level.sigma_rad < 0.12 * DEG
    assert (level.roll_rad, level.pitch_rad) == pytest.approx((0.2, -0.1), abs=0.3 * DEG)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_gyro_carries_down_along(axis: int, sign: float) -> None:
    level = leaning(0.3, -0.2, "copter")
    start, step_s, turned = np.array(level.down), 0.001, 0.2
    rate = [0.0, 0.0, 0.0]
    rate[axis] = sign
    level.update(1e-9, (0.0, 0.0, 0.0), (rate[0], rate[1], rate[2]))
    for k in range(1, round(turned / step_s) + 1):
        level.update(k * step_s, (0.0, 0.0, 0.0), (rate[0], rate[1], rate[2]))  # falling: no accelerometer
    # A direction that stands still in the world turns the other way in the body.
    x, y, z = np.eye(3)[axis] * sign
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    expected = start - math.sin(turned) * cross @ start + (1.0 - math.cos(turned)) * cross @ cross @ start
    assert level.down == pytest.approx(tuple(expected), abs=3e-4)
    assert math.hypot(*level.down) == pytest.approx(1.0)


def test_the_turned_angle_follows_a_tilted_vehicle_around() -> None:
    level, step_s, rate = Level(), 0.01, 0.6
    for k in range(2000):
        attitude = euler_to_matrix(0.2, -0.1, rate * k * step_s)
        level.update(
            k * step_s,
            tuple(rotate_back(attitude, [0.0, 0.0, -G])),
            tuple(rotate_back(attitude, [0.0, 0.0, rate])),
        )
    assert level.turned_rad == pytest.approx(rate * 1999 * step_s, rel=0.002)
    assert level.at(19.89)[1] == pytest.approx(rate * 19.89, rel=0.002)
    assert level.roll_rad == pytest.approx(0.2, abs=0.002)
    assert level.pitch_rad == pytest.approx(-0.1, abs=0.002)


def test_the_bias_about_the_vertical_is_what_rest_shows() -> None:
    level = Level()
    for k in range(6000):
        level.update(k * 0.01, (0.0, 0.0, -G), (0.0, 0.0, 0.01))
    before = level.turned_rad
    for k in range(6000, 7000):
        level.update(k * 0.01, (0.0, 0.0, -G), (0.0, 0.0, 0.01))
    assert abs(level.turned_rad - before) < 0.002


def test_a_slow_bend_of_what_drives_is_no_bias() -> None:
    level = Level("rover")
    for k in range(9000):
        drives, rate = k > 1000, 0.01 * (k > 1000) + 0.003
        level.update(k * 0.01, (0.0, 2.0 * 0.01 * drives, -G), (0.0, 0.0, rate))
        if k % 20 == 0:
            level.hear_velocity(
                k * 0.01, 2.0 * drives * math.cos(k * 1e-4), 2.0 * drives * math.sin(k * 1e-4)
            )
    assert level.bias_radps == pytest.approx(0.003, abs=0.0015)
    assert level.turned_rad == pytest.approx(0.8, abs=0.1)


def test_a_push_that_hardly_changes_is_no_lean_where_a_receiver_sees_it_travel() -> None:
    level, speed_mps = leaning(0.0, 0.0, "rover"), 0.0
    for k in range(1, 800):  # it pulls away for eight seconds, without a tremor, and drives on
        push_mps2 = 0.0 if k < 200 else 1.0 * math.exp(-(k - 200) / 160.0)
        speed_mps += 0.05 * push_mps2
        level.update(0.05 * k, (push_mps2, 0.0, -G), (0.0, 0.0, 0.0))
        if k % 4 == 0:
            level.hear_velocity(0.05 * k, speed_mps, 0.0)
        assert abs(level.pitch_rad) < 3.0 * level.sigma_rad, k
    assert level.sigma_rad < 0.3 * DEG


def hovering(time_s: float, yaw: float) -> tuple[FloatArray, Vector, Vector]:
    """Return body to world, what is felt, and the velocity of a copter that leans as it is pushed."""
    north, east = 1.2 * math.sin(0.7 * time_s), 0.9 * math.sin(0.5 * time_s + 1.0)
    ahead = math.cos(yaw) * north + math.sin(yaw) * east
    right = math.cos(yaw) * east - math.sin(yaw) * north
    thrust = math.sqrt(north**2 + east**2 + G**2)
    to_world = euler_to_matrix(math.asin(right / thrust), math.atan2(-ahead, G), yaw)
    moves = (-1.2 / 0.7 * math.cos(0.7 * time_s), -0.9 / 0.5 * math.cos(0.5 * time_s + 1.0), 0.0)
    return np.asarray(to_world), (0.0, 0.0, -thrust), moves


def hovers(rate_hz: float, chance: np.random.Generator) -> list[float]:
    """Return how far off the level of a copter is that is yawed by jerks at any moment, in its sigmas."""
    level, left_s, off = Level("copter"), 1.0 / rate_hz, list[float]()
    time_s, yaw, yaw_radps, until_s = 0.0, 0.0, 0.0, 0.0
    while time_s < 120.0:
        to_world, felt, (north, east, _) = hovering(time_s, yaw)
        soon, _, _ = hovering(time_s + 1e-4, yaw + 1e-4 * yaw_radps)
        spin = to_world.T @ (soon - to_world) / 1e-4
        level.update(time_s, felt, (float(spin[2, 1]), float(spin[0, 2]), float(spin[1, 0])))
        x, y, z = to_world[2].tolist()
        level.hear_attitude(time_s, math.atan2(y, z), -math.asin(x))
        level.hear_velocity(time_s, north + chance.normal(0.0, 0.05), east + chance.normal(0.0, 0.05))
        if time_s > 5.0:
            off.append(math.acos(min(float(to_world[2] @ level.down), 1.0)) / level.sigma_rad)
        while until_s < time_s + left_s:
            yaw, left_s, time_s = yaw + yaw_radps * (until_s - time_s), left_s - (until_s - time_s), until_s
            yaw_radps, until_s = float(chance.uniform(-1.0, 1.0)), until_s + float(chance.uniform(0.5, 3.0))
        yaw, time_s, left_s = yaw + yaw_radps * left_s, time_s + left_s, 1.0 / rate_hz
    return off


@pytest.mark.parametrize("rate_hz", [4.0, 40.0])
def test_what_turns_between_two_readings_is_doubted(rate_hz: float) -> None:
    off = [ratio for seed in range(3) for ratio in hovers(rate_hz, np.random.default_rng(seed))]
    assert math.sqrt(float(np.mean(np.square(off))) / 2.0) < 1.7


def test_late_readings_do_nothing_and_after_a_silence_it_begins_anew() -> None:
    level = Level()
    level.update(1.0, (0.0, 0.0, -G), (0.0, 0.0, 1.0))
    level.update(0.9, (G, 0.0, 0.0), (9.0, 9.0, 9.0))
    assert level.down == (0.0, 0.0, 1.0)
    level.update(30.0, in_body(0.1, 0.0, 0.0, (0.0, 0.0, -G)), (0.0, 0.0, 1.0))
    assert level.turned_rad == 0.0 and level.roll_rad == pytest.approx(0.1)
    level.restart()
    level.update(5.0, (0.0, 0.0, -G), (0.0, 0.0, 0.4))  # an earlier time, of another clock
    assert level.down == (0.0, 0.0, 1.0) and level.rate_radps == pytest.approx(0.4)


@pytest.mark.parametrize(("acc_mps2", "is_felt"), [(0.9, False), (1.1, True)])
def test_what_falls_does_not_feel_which_way_is_down(acc_mps2: float, is_felt: bool) -> None:
    level = Level()
    level.update(9.0, (0.0, -acc_mps2, 0.0), (0.0, 0.0, 0.0))
    assert (level.roll_rad != 0.0) is is_felt


@pytest.mark.parametrize("says", [(), ("attitude",), ("velocity",), ("attitude", "velocity")], ids="+".join)
def test_message_by_message_a_rover_that_weaves_is_level(says: tuple[str, ...]) -> None:
    track, true = driven("weave", 2)
    acc, gyro, told, moved = track.acc_mps2, track.gyro_radps, track.attitude_rad, track.receiver_velocity_mps
    assert acc is not None and gyro is not None and told is not None and moved is not None
    level, off = Level("rover"), []
    attitudes, velocities = iter(told.values.tolist()), list(zip(moved.time_s, moved.values, strict=True))
    for k, time_s in enumerate(acc.time_s.tolist()):
        f, w = acc.values[k] / MPS2_PER_MILLI_G, gyro.values[k] / RADPS_PER_MILLIRADPS
        numbers = [int(v) for v in (*f, *w)]  # cut toward zero, as the wire does it
        hear(level, mav.RawImu(round(time_s * 1e6), *numbers))
        hear(level, mav.ScaledImu3(round(time_s * 1e3), 0, 0, 0))  # has no accelerometer
        if k % 3 == 0:
            roll, pitch, yaw = next(attitudes)
            if "attitude" in says:
                hear(level, mav.Attitude(round(time_s * 1e3), roll, pitch, yaw))
        while velocities and velocities[0][0] <= time_s:
            at, (north, east, _) = velocities.pop(0)
            if "velocity" in says:
                course = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
                speed = round(math.hypot(north, east) * 100.0)
                hear(level, mav.GpsRawInt(round(at * 1e6), fix_type=3, vel=speed, cog=course))
        if time_s > 20.0:
            off.append((np.linalg.norm(np.array(level.down) - true[k]) / math.sqrt(2.0), level.sigma_rad))
    error, sigma = np.array(off).T
    felt = 1.05 / G  # what the accelerometer leans by in a bend
    assert math.sqrt((error**2).mean()) < (0.25 * DEG if "velocity" in says else 0.15 * felt)
    assert math.sqrt((error**2 / sigma**2).mean()) < 1.8


@pytest.mark.parametrize(
    ("bank_deg", "attitude", "velocity"),
    [(30.0, True, True), (60.0, True, True), (60.0, True, False), (30.0, False, True), (45.0, False, False)],
)
def test_begun_in_a_bend_it_claims_no_more_than_it_knows(
    bank_deg: float, attitude: bool, velocity: bool
) -> None:
    bank, speed_mps, level = bank_deg * DEG, 20.0, Level("plane")
    turn_radps = G * math.tan(bank) / speed_mps  # a coordinated turn: what is felt lies along body z
    floor: Vector = (0.0, 0.0, -G / math.cos(bank))
    rate: Vector = (0.0, turn_radps * math.sin(bank), turn_radps * math.cos(bank))
    down, ratio = np.array([0.0, math.sin(bank), math.cos(bank)]), []
    for k in range(600):
        time_s = 0.05 * k
        level.update(time_s, floor, rate)
        if attitude and k % 2 == 0 and k > 2:
            level.hear_attitude(time_s, bank, 0.0)
        if velocity and k % 4 == 0:
            course = turn_radps * (time_s - 0.2)
            level.hear_velocity(time_s - 0.2, speed_mps * math.cos(course), speed_mps * math.sin(course))
        ratio.append(math.acos(min(float(down @ level.down), 1.0)) / level.sigma_rad)
    assert max(ratio) < 3.0
    if attitude:
        assert math.acos(min(float(down @ level.down), 1.0)) < 1.0 * DEG


def test_what_a_wire_may_bring_does_no_harm() -> None:
    level = leaning(0.0, 0.0)
    for message in (
        mav.Attitude(0, math.nan, 0.0, 0.0),
        mav.Attitude(0, 0.0, math.inf, 0.0),
        mav.GpsRawInt(0, fix_type=3, vel=65535, cog=0),
        mav.GpsRawInt(0, fix_type=1, vel=500, cog=0),
        mav.GpsRawInt(2**60, fix_type=3, vel=65534, cog=0),
        mav.RawImu(2**60, 0, 0, 0, 0, 0, 0),
        mav.Heartbeat(),
    ):
        hear(level, message)
        hear(level, mav.RawImu(50_000, 0, 0, -1000))
    spins = [(0, 0, 0, 0, 0, 0), (32767, -32768, 32767, -32768, 32767, -32768), (0, 0, -1000, 0, 0, 0)]
    for k in range(300):
        hear(level, mav.RawImu(100_000 + 50_000 * k, *spins[k // 100]))
        hear(level, mav.Attitude(100 + 50 * k, -3e38, 3e38, 0.0))
        hear(level, mav.GpsRawInt(2**40, fix_type=3, vel=30000, cog=(k * 9973) % 36000))
    assert math.isfinite(level.sigma_rad) and math.hypot(*level.down) == pytest.approx(1.0)


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (-321.0, -321.0, -321.0), (0.0, 0.0, 157.0)])
def test_what_shows_no_gravity_tells_no_level(force: Vector) -> None:
    level, sound = Level("rover"), Level("rover")
    for k in range(100):
        level.update(0.1 * k, force, (0.0, 0.0, 0.0))
        level.hear_attitude(0.1 * k, 0.0, 0.0)  # of the same sensor, for all one knows
        sound.update(0.1 * k, (0.0, 0.0, -G), (0.0, 0.0, 0.0))
    assert level.sigma_rad > 30.0 * DEG > 100.0 * sound.sigma_rad
    # A silence, or a start of the autopilot, mends no sensor; gravity that is felt again does.
    level.update(60.0, force, (0.0, 0.0, 0.0))
    assert level.sigma_rad > 30.0 * DEG
    for k in range(600):
        level.update(60.0 + 0.1 * k, (0.0, 0.0, -G), (0.0, 0.0, 0.0))
    assert level.sigma_rad < 1.0 * DEG


def test_a_curve_a_dive_and_a_hard_ride_show_gravity() -> None:
    chance, level = np.random.default_rng(1), Level("copter")
    for k in range(1, 400):
        z = -2.0 * G if 100 < k < 110 else 0.0 if 200 < k < 220 else -G  # for one and two seconds
        x, y, z = chance.normal((0.0, 0.5 * G, z), 0.5 * G)
        level.update(0.1 * k, (x, y, z), (0.0, 0.0, 0.0))
        level.hear_attitude(0.1 * k, 0.0, 0.0)
        assert level.sigma_rad < 10.0 * DEG


# --- How much of what a standing vehicle feels is gravity: a push that fades, noise, and a frame that turns


STEP_S = 0.05
LOOKS = round(LOOK_S / STEP_S)


def looks_at(forces: list[complex], noise2: float = 0.0) -> list[tuple[complex, float]]:
    """Feel forces, one a step, and look whenever it is time."""
    standing, found = Standing(), []
    for force in forces:
        standing = standing.feeling(force, STEP_S)
        if standing.felt_s > LOOK_S - 0.5 * STEP_S:
            found.append(standing.gravity(noise2))
            standing = standing.looked()
    return found


def test_one_look_alone_tells_nothing_and_the_second_that_it_stands() -> None:
    first, second = looks_at([0.3 - 0.1j] * 2 * LOOKS)
    assert first[1] == math.inf
    assert second[0] == pytest.approx(0.3 - 0.1j) and math.sqrt(second[1]) == pytest.approx(0.01)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("fades_s", [0.7, 1.5, 2.0])
def test_a_push_that_fades_within_two_seconds_is_within_what_is_said_of_it(
    fades_s: float, backward: bool
) -> None:
    pushes = [0.5 * (0.8 + 0.6j) * math.exp(-STEP_S * k / fades_s) for k in range(6 * LOOKS)]
    found = looks_at(pushes[::-1] if backward else pushes)[1:]
    for mean, variance in found:
        assert abs(mean) < 1.4 * math.sqrt(2.0 * variance)
    assert found[0 if backward else -1][1] < 0.25 * max(variance for _, variance in found)


def test_standing_long_leaves_little_more_than_noise() -> None:
    rng, noise = np.random.default_rng(4), 0.05
    noise2, late = noise**2 / LOOKS, []
    for _ in range(50):
        forces = rng.normal(0.0, noise, (20 * LOOKS, 2)) @ (1.0, 1.0j)
        late += [variance for _, variance in looks_at(list(forces), noise2)[5:]]
    assert noise2 < np.mean(late) < 4.0 * noise2


def test_what_was_felt_leans_with_the_frame() -> None:
    standing = Standing()
    for _ in range(LOOKS):
        standing = standing.feeling(0.2 + 0.0j, STEP_S)
    leant = standing.looked().feeling(0.2 + 0.0j, 0.4).leant(-0.2j)
    mean, variance = leant.gravity(0.0)
    assert mean == pytest.approx(0.2 - 0.2j) and math.sqrt(variance) == pytest.approx(0.01)
