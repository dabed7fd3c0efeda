"""A field of each motor: found where the outputs tell them apart, and only there; undone, written, right."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.motion.observed import observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.compass_parameters import ardupilot_correction, values
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray
from mavcompass.procedure.script import Context, Machine, Script
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup, Surroundings
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters.undo import undo_saver
from mavcompass.vehicle.session import HeldParameters, write_values

EARTH = EarthField((210.0, 15.0, 430.0))
IRON = np.array([40.0, -25.0, 60.0])
# A quadcopter X: how motors 1 to 4 roll, pitch and yaw it.
MIX = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])
HZ, LAST_S, VOLTS = 50, 240.0, 16.0


def wandering(rng: np.random.Generator, count: int, lasts_s: float, size: float) -> FloatArray:
    """A Gauss-Markov process of the first order, from zero on."""
    kept, out = math.exp(-1.0 / (lasts_s * HZ)), np.zeros(count)
    for k, kick in enumerate(rng.normal(0.0, size * math.sqrt(1.0 - kept**2), count - 1), start=1):
        out[k] = kept * out[k - 1] + kick
    return out


def flown(
    seed: int, motors: FloatArray, exponent: float = 0.65, apart: float = 0.06, held: FloatArray | None = None
) -> Track:
    """Fly four minutes, turning, leaning, climbing, in gusts: each motor's field, (4, 3), is at full output.

    `apart`: by how much gusts and turns let the outputs differ, rms. `held`: PMOT1 to 4 in force, no noise.
    """
    rng, time = np.random.default_rng(seed), np.arange(0.0, LAST_S, 1.0 / HZ)
    n, smooth = time.size, np.ones(HZ // 2) / (HZ // 2)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(0.45 + wandering(rng, n, 4.0, 0.5)) / HZ
    roll, pitch = (np.convolve(wandering(rng, n, 3.0, 0.08), smooth, "same") for _ in range(2))
    lifted = 0.5 + wandering(rng, n, 5.0, 0.07)
    moments = apart * np.stack([wandering(rng, n, tau, 1.0) for tau in (1.5, 1.5, 2.5)], axis=1)
    outputs = np.clip(lifted[:, None] + moments @ MIX.T, 0.05, 1.0)
    volts = VOLTS - 1.5 * (outputs.mean(axis=1) - 0.5) - 0.004 * time
    slow = volts.copy()
    for k in range(5, n):  # ten times a second a tenth of what is new
        slow[k] = 0.9 * slow[k - 5] + 0.1 * volts[k]
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    nose = np.stack([cy * cp, sy * cp, -sp], axis=1)
    right = np.stack([cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr], axis=1)
    axes = np.stack([nose, right, np.cross(nose, right)], axis=1)
    power = (outputs * slow[:, None]) ** exponent
    raw = axes @ EARTH.vector_mgauss + IRON + power @ motors / VOLTS**exponent
    felt = axes @ [0.0, 0.0, -9.80665] + rng.normal(0.0, 0.05, (n, 3)) + rng.normal(0.0, 0.01, 3)
    p, q, r = (np.gradient(angle, 1.0 / HZ) for angle in (roll, pitch, yaw))
    rates = np.stack([p - r * sp, q * cr + r * cp * sr, r * cp * cr - q * sr], axis=1)
    parameters, noise = {f"SERVO{m}_FUNCTION": 32.0 + m for m in range(1, 5)}, 2.0
    if held is not None:
        noise, raw = 0.0, raw - IRON + (outputs * slow[:, None]) ** 0.8 @ held
        parameters |= dict(zip((f"COMPASS_OFS_{axis}" for axis in "XYZ"), -IRON, strict=True))
        names = [f"COMPASS_PMOT{motor}_{axis}" for motor in range(1, 5) for axis in "XYZ"]
        parameters |= {
            "COMPASS_PMOT_EN": 1.0,
            "COMPASS_PMOT_EXP": 0.8,
            **dict(zip(names, held.ravel(), strict=True)),
        }
    tenths, steps = slice(0, n, 5), (InForce(-np.inf, ardupilot_correction(parameters, 1)),)
    reading = raw[tenths] + rng.normal(0.0, noise, raw[tenths].shape)
    return Track(
        autopilot="ardupilot",
        vehicle="copter",
        compasses={1: MagSeries(1, Series.of(time[tenths] + 0.09, reading), steps)},
        parameters=parameters,
        acc_mps2=Series.of(time, felt),
        gyro_radps=Series.of(time, rates + rng.normal(0.0, 0.002, (n, 3))),
        motors=Series.of(time[tenths], outputs[tenths]),
        voltage_v=Series.of(time[tenths], volts[tenths]),
        current_a=Series.of(time[tenths], 80.0 * (outputs[tenths] ** 1.7).mean(axis=1)),
    )


def drawn(seed: int) -> FloatArray:
    return np.random.default_rng([seed, 7]).normal(0.0, 25.0, (4, 3))


@pytest.mark.parametrize(("seed", "exponent"), [(1, 0.65), (2, 1.0), (3, 2.0)])
def test_each_motors_field_is_found_within_its_sigma(seed: int, exponent: float) -> None:
    """Of 40 drawn flights all were told; 76 and 98 % of 480 numbers lay within one and 1.96 sigmas."""
    true = drawn(seed)
    motion = observe_motion(Recorded(flown(seed, true, exponent), 1, EARTH))
    assert (motion.load_source, motion.exponent) == ("outputs", exponent)
    unit = VOLTS**exponent
    sigma = unit * np.sqrt(np.diag(motion.fit.covariance)[motion.fit.motor].reshape(4, 3))
    off = (unit * motion.fit.motors_mgauss - true) / sigma
    assert sigma.max() < 4.0 and math.sqrt(float((off**2).mean())) < 1.6


@pytest.mark.parametrize(
    ("motors", "changed", "source"),
    [
        (np.zeros((4, 3)), {}, "none"),
        (np.tile([14.0, -10.0, 6.0], (4, 1)), {"exponent": 1.7}, "current"),
        *((drawn(5), {"apart": apart}, "current") for apart in (0.0, 0.003)),
    ],
    ids=["nothing", "alike", "together", "nearly"],
)
def test_one_load_for_all_where_it_does_or_outputs_go_together(
    motors: FloatArray, changed: dict[str, float], source: str
) -> None:
    result = calibrate_track(flown(11, motors, **changed), "world-field", earth=EARTH)
    assert result.accepted and result.correction.motor_source == source


def test_what_is_in_force_is_undone_exactly_and_stays_where_the_load_is_not_told() -> None:
    given = flown(6, drawn(6), held=drawn(7) / 10.0)
    plain = flown(6, drawn(6), held=0.0 * drawn(7))
    assert given.raw_field(1) == pytest.approx(plain.raw_field(1), abs=1e-9)
    kept = calibrate_track(replace(given, voltage_v=None), "world-field", earth=EARTH).correction
    assert kept.motors.T == pytest.approx(kept.matrix @ (drawn(7) / 10.0).T)


def test_only_compass_1_and_no_other_autopilot_has_it() -> None:
    track = flown(5, drawn(5))
    second = replace(track, compasses={2: replace(track.compasses[1], instance=2)})
    others = ((2, second), (1, replace(track, autopilot="px4")), (1, replace(track, vehicle="plane")))
    assert {observe_motion(Recorded(other, i, EARTH)).load_source for i, other in others} == {"current"}


def test_what_is_found_puts_the_firmwares_readings_right_and_is_taken_back(tmp_path: Path) -> None:
    """23 degrees off at full throttle, by an effect that knows no power of outputs."""
    around = Surroundings(60.0, 1.0, 30.0, (1.0,) * 4)
    true = np.array([[60.0, 20.0, -30.0], [-25.0, 50.0, 10.0], [40.0, -35.0, 20.0], [15.0, 55.0, 40.0]])
    ready = CompassSetup(CompassModel(FieldCorrection(tuple(-IRON))), FieldCorrection(tuple(-IRON)))
    names = [f"motor{m}_{axis}" for m in range(1, 5) for axis in "xyz"]
    effect = "per_motor:" + ",".join(f"{n}={v}" for n, v in zip(names, true.ravel(), strict=True))
    vehicle = SimulatedAutopilot("copter", seed=4, compasses=[ready] * 3, effects=[effect])
    vehicle.board.surroundings = lambda: around  # type: ignore[method-assign]
    # The effect knows no voltage: at that of this battery it is the flown one's.
    volts = vehicle.firmware.reports.battery_volts()
    found = calibrate_track(flown(8, true * VOLTS / volts, 1.0), "world-field", earth=EARTH).correction
    seen = [heading_error_rms_deg(vehicle)]

    def wanted(held: HeldParameters, _: object) -> dict[str, float]:
        common = replace(found, motor_mgauss=(1.0, 0.0, 0.0), motor_source="current")
        again = values("ardupilot", {"COMPASS_PMOT_EN": 1.0}, 1, common)
        assert again["COMPASS_PMOT_EN"] == 0.0 and again["COMPASS_MOTCT"] == 2.0
        assert held.dialect.plan(held.values, {2: found}).refusals
        return values("ardupilot", held.values, 1, found)

    def script(context: Context) -> Script[None]:
        saver = undo_saver("test", tmp_path)
        done = yield from write_values(context, "test", wanted, saver, checked=True, consent=lambda *_: "")
        seen.append(heading_error_rms_deg(vehicle))
        assert done.outcome is not None
        yield from done.outcome.take_back(context, "It was a test.")

    run(Machine(script), SimulatedLink(vehicle))
    before, written, back = [*seen, heading_error_rms_deg(vehicle)]
    assert before > 20.0 and written < 2.0 and back == pytest.approx(before, abs=0.01)
