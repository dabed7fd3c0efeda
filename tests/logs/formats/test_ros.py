"""A ROS 2 bag gives the same calibration and diagnosis as the CSV of the same recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mavcompass
from mavcompass.errors import BadRecording
from mavcompass.frames import euler_to_quaternion
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs import read_track
from mavcompass.simulation import effects
from mavcompass.track import Track

bags = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
TYPES = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def made(name: str, **values: object) -> object:
    return TYPES.types[name](**values)


def vector(row: np.ndarray) -> object:
    return made("geometry_msgs/msg/Vector3", x=float(row[0]), y=float(row[1]), z=float(row[2]))


def write_bag(track: Track, folder: Path, storage: str = "MCAP", heading_deg: float | None = None) -> Path:
    """Write a track as a robot records it: tesla, forward left up, east north up; with a heading, or none."""
    flu, nothing = np.array([1.0, -1.0, -1.0]), np.zeros(9)
    raw = track.raw_field(1) * flu * 1e-7
    plugin = getattr(bags.StoragePlugin, storage)

    def head(time_s: float) -> object:
        stamp = made("builtin_interfaces/msg/Time", sec=int(time_s), nanosec=round(time_s % 1.0 * 1e9))
        return made("std_msgs/msg/Header", stamp=stamp, frame_id="base_link")

    with bags.Writer(folder, version=9, storage_plugin=plugin) as bag:
        kinds = {"/imu/mag": "sensor_msgs/msg/MagneticField", "/imu/data": "sensor_msgs/msg/Imu"}
        topics = {name: bag.add_connection(name, kind, typestore=TYPES) for name, kind in kinds.items()}

        def put(topic: str, time_s: float, message: object) -> None:
            bag.write(topics[topic], round(time_s * 1e9), TYPES.serialize_cdr(message, kinds[topic]))

        for time_s, row in zip(track.compasses[1].time_s.tolist(), raw, strict=True):
            field = made(
                kinds["/imu/mag"], header=head(time_s), magnetic_field=vector(row),
                magnetic_field_covariance=nothing,
            )  # fmt: skip
            put("/imu/mag", time_s, field)
        assert track.gyro_radps is not None and track.acc_mps2 is not None
        acc, gyro = track.acc_mps2.values * flu, track.gyro_radps.values * flu
        rows = zip(track.gyro_radps.time_s.tolist(), acc, gyro, strict=True)
        for time_s, force, rate in rows:
            w, x, y, z = 0.0, 0.0, 0.0, 0.0
            if heading_deg is not None:  # counted from east to north
                w, x, y, z = euler_to_quaternion(0.0, 0.0, np.radians(90.0 - heading_deg)).tolist()
            imu = made(
                kinds["/imu/data"], header=head(time_s),
                orientation=made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
                orientation_covariance=nothing, angular_velocity=vector(rate),
                angular_velocity_covariance=nothing, linear_acceleration=vector(force),
                linear_acceleration_covariance=nothing,
            )  # fmt: skip
            put("/imu/data", time_s, imu)
    return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))


@pytest.fixture(scope="module")
def track() -> Track:
    return make_track(
        Recipe("yaw-steps", duration_s=60.0, seed=3), [effects.parse("hard_iron:x=30,y=-40,z=10")]
    )


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_bag_gives_what_the_csv_gives(track: Track, storage: str, tmp_path: Path) -> None:
    from mavcompass.logs.formats.csv.writer import write_track_csv

    bag = read_track(write_bag(track, tmp_path / "bag", storage))
    write_track_csv(track, tmp_path / "same.csv")
    plain = read_track(tmp_path / "same.csv")
    for quantity in ("gyro_radps", "acc_mps2"):
        assert np.allclose(getattr(bag, quantity).values, getattr(plain, quantity).values, atol=1e-9)
    assert np.allclose(bag.raw_field(), plain.raw_field(), atol=1e-6)
    alone = replace(plain, attitude_rad=None, reference_q=None, position_ned_m=None, place=None)
    one, other = mavcompass.calibrate(bag), mavcompass.calibrate(alone)
    assert np.allclose(one.correction.offsets_mgauss, other.correction.offsets_mgauss, atol=1e-2)
    assert "Compass 1 is /imu/mag." in bag.notes


def test_east_north_up_becomes_north_east_down(track: Track, tmp_path: Path) -> None:
    bag = read_track(write_bag(track, tmp_path / "bag", heading_deg=60.0))
    assert bag.attitude_rad is not None
    assert np.allclose(np.degrees(bag.attitude_rad.values), [0.0, 0.0, 60.0], atol=1e-6)


def test_broad_as_a_bag_is_diagnosed_as_the_csv_is(shared_data: Path, tmp_path: Path) -> None:
    csv = next((shared_data / "real" / "broad").glob("*01*.csv"))
    plain = read_track(csv)
    bag = read_track(write_bag(plain, tmp_path / "bag"))
    assert np.allclose(bag.raw_field(), plain.raw_field(), atol=1e-6)
    results = [mavcompass.calibrate(which, method="ellipsoid") for which in (bag, plain)]
    assert np.allclose(*(r.correction.offsets_mgauss for r in results), atol=1e-3)


def test_a_damaged_bag_is_read_as_far_as_it_goes_or_refused(track: Track, tmp_path: Path) -> None:
    bag = write_bag(track, tmp_path / "bag")
    whole = bag.read_bytes()
    for name, data in (("cut.mcap", whole[: len(whole) // 2]), ("empty.mcap", whole[:8])):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(BadRecording):
            read_track(tmp_path / name)
