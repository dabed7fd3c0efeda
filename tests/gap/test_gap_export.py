"""Exports: a file per simulator that makes the field that was found, or says what it cannot."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from xml.etree import ElementTree

import lupa
import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.export import TARGETS, Found, found_in, known_to
from mavcompass.gap.result import CalibrationInForce, Cause, Iron, PosteriorComponent
from mavcompass.simulation import effects
from mavcompass.simulation.effects import catalogue
from mavcompass.simulation.effects.effect import Distortion, Setting, Signals
from mavcompass.simulation.physics.signals import Stimulus, ideal

AFFINE = {"hard_iron", "soft_iron", "axis_scale"}
IMU = {"accel_bias", "accel_scale", "gyro_bias", "gyro_scale"}
PARAMETERS = {
    *AFFINE, *IMU, "orientation", "motor_current", "noise_excess", "transport_lag", "height_anomaly"
}  # fmt: skip
SCRIPTED = {
    "hard_iron_step",
    "temperature_bias",
    "per_motor",
    "relay_field",
    "spatial_dipole",
    "field_gradient",
}
# What each holds as it is; docs/gap.md has the same table.
HOLDS = {
    "ardupilot-sitl": PARAMETERS,
    "ardupilot-lua": PARAMETERS | SCRIPTED,
    "px4-sitl": {"hard_iron"},
    "gazebo": {"hard_iron", "noise_excess", "quantisation", "bias_random_walk"},
    "mavcompass": set(catalogue()),
}


def typical(effect_id: str) -> Setting:
    text = {"relay_field": "relay_field:x=25,y=-15,z=10,source=3,threshold=0.5"}.get(effect_id, effect_id)
    return effects.parse(text)


@pytest.mark.parametrize("target", sorted(TARGETS.keys() - {"mavcompass"}))
def test_a_file_says_how_well_is_known_what_it_holds(target: str) -> None:
    cause = Cause(
        "hard_iron", {"x": 9.0, "y": 1.0, "z": 3.0}, {"x": (8.96, 9.04), "z": (-12.0, 18.0)}, 1.0, ()
    )
    found = Found([typical("hard_iron")], known=(known_to(cause),))
    assert "hard_iron, 95 %: x 8.96 to 9.04 mG, z -12 to 18 mG" in TARGETS[target](found).text


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_a_simulator_holds_an_effect_or_the_file_says_that_it_does_not(target: str) -> None:
    held = set()
    for effect_id in catalogue():
        found = Found([typical(effect_id)], "a.tlog", {effect_id: 3.2})
        exported = TARGETS[target](found)
        if not exported.lacking:
            held.add(effect_id)
        assert all(sentence in exported.text.replace("&lt;", "<") for sentence in exported.lacking)
        assert (
            not exported.lacking
            or effect_id in {*AFFINE, "misalignment", "non_orthogonality"}
            or any("3.2 deg of heading" in sentence for sentence in exported.lacking)
        )
    assert held == HOLDS[target]


def test_px4_is_told_in_gauss_and_in_the_form_of_its_ground_stations() -> None:
    exported = TARGETS["px4-sitl"](Found([effects.parse("hard_iron:x=120,y=-80,z=40")]))
    rows = [line.split("\t") for line in exported.text.splitlines() if not line.startswith("#")]
    assert rows == [
        ["1", "1", "SIM_MAG_OFFSET_X", "0.12", "9"],
        ["1", "1", "SIM_MAG_OFFSET_Y", "-0.08", "9"],
        ["1", "1", "SIM_MAG_OFFSET_Z", "0.04", "9"],
    ]


def test_gazebo_is_told_in_tesla_with_left_and_up() -> None:
    found = Found(
        [effects.parse("hard_iron:x=120,y=-80,z=40"), effects.parse("noise_excess:sigma_mgauss=6")], "a<b--c"
    )
    sensor = ElementTree.fromstring(TARGETS["gazebo"](found).text)
    assert sensor.attrib["type"] == "magnetometer"
    for axis, mean in zip("xyz", (120e-7, 80e-7, -40e-7), strict=True):
        noise = sensor.find(f"magnetometer/{axis}/noise")
        assert noise is not None and noise.attrib["type"] == "gaussian"
        assert float(noise.findtext("mean", "")) == pytest.approx(mean)
        assert float(noise.findtext("stddev", "")) == pytest.approx(6e-7)


def test_our_preset_is_the_vehicle_itself() -> None:
    settings = [typical("soft_iron"), typical("spatial_dipole")]
    document = json.loads(TARGETS["mavcompass"](Found(settings)).text)
    again = [effects.parse(text) for text in document["effects"]]
    for setting, read in zip(settings, again, strict=True):
        np.testing.assert_allclose(read.theta, setting.theta, rtol=1e-5)


class Firmware:
    """Stand in for ArduPilot beside a script: its bindings answer from one instant of a flight."""

    def __init__(self, text: str, time_s: float, position: FloatArray, rotation: FloatArray) -> None:
        self.parameters: dict[str, float] = {}
        self.rotation, self.position, self.time_s = rotation, position, time_s
        self.lua = lupa.LuaRuntime(unpack_returned_tuples=True)  # type: ignore[call-arg]
        vector = self.lua.execute(
            """
            local function vector(x, y, z)
              local v = { x, y, z }
              local function part(i)
                return function(_, value) if value then v[i] = value end return v[i] end
              end
              return { x = part(1), y = part(2), z = part(3) }
            end
            Vector3f = function() return vector(0, 0, 0) end
            return vector
            """
        )
        scope = self.lua.globals()
        scope.param = self._object(set=self._set)
        scope.millis = lambda: self._object(tofloat=lambda _: 1000.0 * self.time_s)
        scope.baro = self._object(get_temperature=lambda _: 31.5)
        scope.battery = self._object(current_amps=lambda _, instance: 12.0)
        scope.SRV_Channels = self._object(get_output_pwm=lambda _, number: 1000 + 100 * (number - 32))
        scope.ahrs = self._object(
            get_relative_position_NED_origin=lambda _: vector(*self.position.tolist()),
            earth_to_body=lambda _, v: vector(*(self.rotation.T @ [v.x(v), v.y(v), v.z(v)]).tolist()),
        )
        self.update = self.lua.execute(text)[0]

    def _object(self, **methods: object) -> object:
        return self.lua.table_from(methods)

    def _set(self, _: object, name: str, value: float) -> None:
        self.parameters[name] = value

    def raw(self, field_ned_mgauss: FloatArray) -> FloatArray:
        """Return what the firmware's simulator makes of a field: E^-1 field - OFS."""
        self.update()
        p = self.parameters
        x, y, z = (p[f"SIM_MAG1_ODI_{axis}"] for axis in "XYZ")
        cure = np.diag([p[f"SIM_MAG1_DIA_{axis}"] for axis in "XYZ"])
        cure += np.array([[0.0, x, y], [x, 0.0, z], [y, z, 0.0]])
        offsets = np.array([p[f"SIM_MAG1_OFS_{axis}"] for axis in "XYZ"])
        return np.asarray(np.linalg.inv(cure) @ self.rotation.T @ field_ned_mgauss - offsets)


@pytest.mark.parametrize("time_s", [10.0, 45.0])
@pytest.mark.parametrize("effect_id", sorted(SCRIPTED))
def test_the_script_makes_the_field_that_our_own_effect_makes(effect_id: str, time_s: float) -> None:
    """The script runs in a real Lua, beside stand-ins for the firmware's bindings."""
    settings = [
        effects.parse("soft_iron:xx=0.08,yy=-0.05,xy=0.03"),
        effects.parse("hard_iron:x=40,y=-20,z=10"),
        typical(effect_id),
    ]
    # The recording begins at its datum, from which a gradient counts.
    position, rotation = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, -1.5]]), euler_to_matrix(0.2, -0.3, 1.1)
    field, two = np.tile([230.0, 50.0, -520.0], (2, 1)), np.ones(2)
    stimulus = Stimulus.posed(
        np.array([0.0, time_s]), np.stack([rotation, rotation]), field, position_ned_m=position,
        current_a=12.0 * two, throttle=0.5 * two, temperature_degc=31.5 * two,
        motors=np.tile(0.1 * np.arange(1, 9), (2, 1)),
    )  # fmt: skip
    before = Signals(stimulus, ideal(stimulus))
    truth = Distortion(settings).run(before, None).reading.mag_mgauss[1]
    script = TARGETS["ardupilot-lua"](Found(settings)).text
    firmware = Firmware(script, time_s, position[1], rotation)
    np.testing.assert_allclose(firmware.raw(field[1]), truth, atol=0.02)


def test_what_the_calibration_cures_is_added_to_what_was_found() -> None:
    from mavcompass.gap.export.vehicle import vehicle_settings

    none = Iron(np.eye(3), np.zeros(3), np.zeros(3))
    tuned = Iron(np.eye(3), np.array([4.0, 0.0, 9.0]), np.array([1.0, 2.0, -3.0]))
    taught = Iron(np.zeros((3, 3)), np.array([1.0, 0.0, 7.0]), np.array([0.5, 0.0, 0.0]))
    iron = CalibrationInForce(True, none, tuned, taught, "current", 1.0)
    cause = Cause("motor_current", {"x": 0.5, "y": -1.0, "z": 0.25}, {}, 1.0, ())
    diagnosis = SimpleNamespace(causes=(cause,), in_force=iron, beliefs=())
    offset, motors = vehicle_settings(diagnosis)  # type: ignore[arg-type]
    np.testing.assert_allclose(offset.theta, [4.0, 0.0, 9.0])
    np.testing.assert_allclose(motors.theta, [1.5, 1.0, -2.75])
    # What the simulator itself showed beside its calibration is no iron that it could be given.
    offset, motors = vehicle_settings(diagnosis, beside_simulator=True)  # type: ignore[arg-type]
    np.testing.assert_allclose(offset.theta, [3.0, 0.0, 2.0])
    np.testing.assert_allclose(motors.theta, [1.0, 1.0, -2.75])


@pytest.mark.parametrize(
    ("calibrated", "told", "sigma", "held"),
    [
        (0.0, 0.04, 0.015, None),  # 2.7 sigmas of one of three axes: the noise of a baseline
        (0.0, 0.04, 0.0142, 0.04),
        (0.0, 0.001, 0.0001, 0.001),  # however small it is
        (2.0, 2.04, 0.015, 2.0),
        (2.0, 2.04, 0.0142, 2.04),
    ],
)
def test_an_export_holds_a_motors_field_that_is_known_to_differ_from_zero(
    calibrated: float, told: float, sigma: float, held: float | None
) -> None:
    from mavcompass.gap.export.vehicle import vehicle_settings

    none = Iron(np.zeros((3, 3)), np.zeros(3), np.zeros(3))
    cures, tuned = (
        Iron(np.eye(3), np.array([one, one, one]), np.array([0.0, motor, 0.0]))
        for one, motor in ((0.0, calibrated), (1.0, told))
    )
    iron = CalibrationInForce(True, cures, tuned, none, "current", 1.0)
    likely = PosteriorComponent(0.9, (), (), np.zeros(18), sigma**2 * np.eye(18))
    beliefs = (PosteriorComponent(0.1, (), (), np.zeros(18), np.eye(18)), likely)
    diagnosis = SimpleNamespace(causes=(), in_force=iron, beliefs=beliefs)
    settings = {s.effect.id: s.theta for s in vehicle_settings(diagnosis)}  # type: ignore[arg-type]
    assert settings.keys() == ({"hard_iron"} if held is None else {"hard_iron", "motor_current"})
    if held is not None:
        np.testing.assert_allclose(settings["motor_current"], [0.0, held, 0.0])


@pytest.mark.parametrize(
    ("effect", "after", "left2"),
    [("height_anomaly", 4.0, 3.0), ("height_anomaly", 1.0, 1.0), ("hard_iron", 4.0, 0.0)],
)
def test_the_field_of_the_place_stays_where_an_effect_goes_with_places(
    effect: str, after: float, left2: float
) -> None:
    unlikely = PosteriorComponent(0.1, (), (), 9.0 * np.ones(18), np.eye(18))
    likely = PosteriorComponent(0.9, (), (), np.array([3.0, 0.0, 0.0, *[0.0] * 15]), np.eye(18))
    diagnosis = SimpleNamespace(
        causes=(), in_force=None, beliefs=(unlikely, likely), effects={effect}, waterfall=(),
        field=SimpleNamespace(nominal=6.0, after=after, floor=math.sqrt(3.0), shrink=0.9),
    )  # fmt: skip
    found = found_in(diagnosis, "a log")  # type: ignore[arg-type]
    assert found.shrink == pytest.approx(0.9 - left2 / 33.0)
    told = TARGETS["ardupilot-sitl"](found).lacking
    assert (f"The field of the place, {math.sqrt(left2):.1f} mG" in " ".join(told)) is bool(left2)


def test_of_what_was_promised_an_export_tells_what_it_holds() -> None:
    found = Found(
        [typical("hard_iron"), typical("temperature_bias")], shrink=0.97,
        shares={"hard_iron": 0.7, "temperature_bias": 0.27},
    )  # fmt: skip
    for target, held in {
        "ardupilot-sitl": 0.7,
        "px4-sitl": 0.7,
        "gazebo": 0.7,
        "ardupilot-lua": 0.97,
    }.items():
        assert found.promised(TARGETS[target](found)) == pytest.approx(held), target
