"""What a service learns of true north on the way: told at once, kept by place, used again."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from mavcompass import messages as mav
from mavcompass.earth_field import EarthField
from mavcompass.heading.live import Heading
from mavcompass.heading.true_north import NorthSeen
from mavcompass.messages import Incoming
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.station import datagram
from mavcompass.service.view import VehicleView
from mavcompass.service.web.state import heading_json
from mavcompass.service.work.north import NorthKeeper, joined

EARTH = EarthField((240.0, 0.0, -520.0))
DEG = math.pi / 180.0
HIDDEN_RAD = 4.0 * DEG


class Drive:
    """A rover whose true headings are 4 degrees ahead of its magnetic ones, as it speaks to a service."""

    def __init__(self, lat_deg: float = 10.0) -> None:
        self.view = VehicleView(VehicleIdentity(1, 1, "ardupilot", "rover"), "rover", 2026.0)
        self.view.set_parameters({"COMPASS_OFS_X": 1.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0})
        self.place(lat_deg)
        self.time_s, self.yaw, self.rng = 100.0, 0.3, np.random.default_rng(2)

    def place(self, lat_deg: float) -> None:
        self.view.hear(Incoming(0.0, 1, 1, mav.GlobalPositionInt(0, round(lat_deg * 1e7), 200_000_000)))
        self.view.world = EARTH
        for compass in self.view.compasses.values():
            compass.set_world(EARTH)

    def go(self, seconds: int) -> None:
        """Drive legs of 20 s, with a bend of 40 degrees after each."""
        for k in range(seconds * 5):
            self.time_s += 0.2
            rate = 20.0 * DEG if k % 110 >= 100 else 0.0
            self.yaw += 0.2 * rate
            noise = self.rng.normal(0.0, 1.5, 2)  # what a compass repeats for ever is old
            x, y = (round(240.0 * a) for a in (math.cos(self.yaw), -math.sin(self.yaw)) + noise / 240.0)
            spin, side = round(1000.0 * rate), round(1000.0 * 4.0 * rate / 9.81)
            imu = mav.RawImu(round(self.time_s * 1e6), 0, side, -1000, 0, 0, spin, x, y, -520)
            cog = round(math.degrees(self.yaw + HIDDEN_RAD) % 360.0 * 100.0) % 36000
            gps = mav.GpsRawInt(time_usec=round(self.time_s * 1e6), fix_type=3, vel=400, cog=cog)
            for message in (imu, gps):
                self.view.hear(Incoming(self.time_s, 1, 1, message))

    @property
    def rests_on(self) -> str:
        north = self.view.compasses[1].north
        assert north is not None
        return north.words()


def test_it_says_on_what_its_true_heading_rests_and_knows_it_the_next_day(tmp_path: Path) -> None:
    drive, keeper = Drive(), NorthKeeper(tmp_path / "north.json")
    drive.go(2)
    keeper.learn(drive.view, 1)
    assert drive.rests_on.startswith("declination +0.0 deg by the model")
    assert not (tmp_path / "north.json").exists()
    for _ in range(10):
        drive.go(60)
        keeper.learn(drive.view, 1)
    drive.go(1)
    assert drive.rests_on.startswith("learnt from ") and "minutes of course here: +4.0" in drive.rests_on
    heading = drive.view.compasses[1].latest
    assert heading is not None
    told = heading_json(heading)
    assert (told["true_deg"] - told["magnetic_deg"]) % 360.0 == pytest.approx(4.0, abs=0.2)
    assert (
        told["sigma_deg"]
        < told["true_sigma_deg"]
        == pytest.approx(json.loads(datagram(heading))["true_sigma_deg"], abs=0.01)
    )
    # Ten looks at the same ten minutes are one row.
    assert len(json.loads((tmp_path / "north.json").read_text())) == 1
    again = Drive()
    again.go(2)
    NorthKeeper(tmp_path / "north.json").learn(again.view, 1)
    assert again.rests_on.startswith("learnt from ")


def test_it_is_of_its_place_its_compass_and_its_calibration(tmp_path: Path) -> None:
    drive, path = Drive(), tmp_path / "north.json"
    drive.go(600)
    NorthKeeper(path).learn(drive.view, 1)
    far, other, near = Drive(lat_deg=10.1), Drive(), Drive(lat_deg=10.08)  # 11 and 9 km away
    near.go(2)
    NorthKeeper(path).learn(near.view, 1)
    assert "of course (+4 " in near.rests_on
    other.view.set_parameters({"COMPASS_OFS_X": 50.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0})
    for one in (far, other):
        one.go(2)
        NorthKeeper(path).learn(one.view, 1)
        assert one.rests_on.startswith("declination +0.0 deg by the model") and "course" not in one.rests_on


@pytest.mark.parametrize("content", ["", "[]x", '[{"seen": 3}]', '{"a": 1}'])
def test_a_file_that_cannot_be_read_is_begun_anew(content: str, tmp_path: Path) -> None:
    path = tmp_path / "north.json"
    path.write_text(content)
    drive = Drive()
    drive.go(600)
    NorthKeeper(path).learn(drive.view, 1)
    assert len(json.loads(path.read_text())) == 1


@pytest.mark.parametrize(("true_rad", "true_deg", "sigma_deg"), [(None, None, None), (0.25, 14.324, 1.621)])
def test_a_datagram_tells_a_heading_in_degrees(
    true_rad: float | None, true_deg: float | None, sigma_deg: float | None
) -> None:
    sigma_rad = None if true_rad is None else 0.0283
    heading = Heading(4.5, 20.0, 2, 1.5, true_rad, 0.02, (200.0, 0.0, 400.0), true_sigma_rad=sigma_rad)
    assert json.loads(datagram(heading)) == {
        "boot_s": 20.0, "compass": 2, "magnetic_deg": 85.944, "sigma_deg": 1.146, "true_deg": true_deg,
        "true_sigma_deg": sigma_deg,
    }  # fmt: skip


def test_drives_are_joined_by_inverse_variance_and_fade_with_distance() -> None:
    def seen(turn_deg: float, chance_deg: float) -> NorthSeen:
        return NorthSeen("gps-course", turn_deg * DEG, chance_deg * DEG, 0.2 * DEG, 300.0)

    (both,) = joined([(seen(2.0, 0.3), 0.0), (seen(2.2, 0.6), 0.5)], EARTH)
    assert both.turn_rad == pytest.approx(2.04 * DEG) and both.seconds == 600.0
    assert (
        both.chance_rad == pytest.approx(DEG * (1 / 0.09 + 1 / 0.36) ** -0.5) and both.steady_rad == 0.2 * DEG
    )
    for turns_deg, chance_deg in (((0.0, 2.0), 1.0), ((0.0, 1.0, 2.0), 3.0**-0.5)):
        (apart,) = joined([(seen(turn_deg, 0.1), 0.5) for turn_deg in turns_deg], EARTH)
        assert apart.chance_rad == pytest.approx(chance_deg * DEG, rel=0.01)
    chances = [joined([(seen(2.0, 0.3), km)], EARTH)[0].chance_rad for km in (0.9, 2.0, 5.0, 9.9)]
    assert chances == sorted(chances) and chances[0] == pytest.approx(0.3 * DEG) and chances[-1] < 2.5 * DEG
    assert joined([(seen(2.0, 0.3), 11.0)], EARTH) == []
