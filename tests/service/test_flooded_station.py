"""What a station tells of its link and its vehicle, on the page and to the pilot; also of a flooded link."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from running_service import configured, wait_for

from mavcompass import messages as mav
from mavcompass.frames import euler_to_matrix
from mavcompass.messages import Incoming, Message
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.mavlink.component import finding_text
from mavcompass.service.station import Station
from mavcompass.service.view import VehicleView
from mavcompass.service.web.metrics import metrics_text
from mavcompass.service.web.state import moment_json, state_json
from mavcompass.service.work.history import History
from mavcompass.vehicle.link import Link, SourceStatistics


class Flooded(Link):
    """A link on which more comes than is read."""

    behind = longest_s = 0.0

    def now(self) -> float:
        return 100.0

    def behind_s(self) -> float:
        return self.behind

    def send(self, message: Message) -> None: ...

    def receive(self, timeout_s: float) -> Incoming | None:
        self.longest_s = max(self.longest_s, timeout_s)
        return None

    def close(self) -> None: ...


@pytest.fixture
def station(tmp_path: Path) -> Station:
    link = Flooded("udpin:127.0.0.1:14550")
    return Station(configured(tmp_path, link.name), History(tmp_path / "h.db"), lambda: link)


def test_where_nothing_comes_the_station_goes_on_all_the_same(station: Station) -> None:
    station.start()
    link = wait_for(lambda: station.link)
    wait_for(lambda: link.longest_s)
    assert station.stop() and link.longest_s <= 1.0


@pytest.mark.parametrize(("behind_s", "told"), [(0.0, False), (4.9, False), (5.1, True)])
def test_a_flood_of_five_seconds_is_told(behind_s: float, told: bool, station: Station) -> None:
    assert station.findings == ()
    station.link = link = Flooded("udpin:127.0.0.1:14550")
    link.behind = behind_s
    assert bool(station.findings) is told
    if told:
        (finding,) = state_json(station)["findings"]
        assert (finding["id"], finding["compass"]) == ("link", 0)
        assert "14550 than this computer" in finding["text"]
        assert "SRn_*" in finding["remedy"]
        assert finding_text(station.findings[0]).text == "Compass: more messages than can be read"


def test_what_is_known_is_told_number_by_number_to_pages_and_to_prometheus(station: Station) -> None:
    """A rover leans by ten degrees and heads 30 degrees from magnetic north; it spoke half a second ago."""
    link = Flooded("udpin:127.0.0.1:14550")
    unknown = {"connected": False, "headings": [], "turned_deg": 0.0, "rate_dps": 0.0, "still": False}
    assert moment_json(station) == unknown and state_json(station)["link"]["open"] is False
    view = station.view = VehicleView(VehicleIdentity(1, 1, "ardupilot", "rover"), "key", 2026.0)
    station.link, view.reconnects, view.reboots = link, 6, 7
    link.statistics.received, link.statistics.malformed, link.statistics.dropped = 2, 4, 5
    link.statistics.sources[1, 1] = SourceStatistics(lost=3)
    stood = euler_to_matrix(math.radians(10.0), 0.0, math.radians(30.0)).T
    seen, felt = (np.rint(stood @ ned).astype(int).tolist() for ned in ((200, 0, 400), (0, 0, -1000)))
    for message in (
        mav.Heartbeat(type=10, autopilot=3, base_mode=128, custom_mode=15),
        mav.GlobalPositionInt(lat=473_977_000, lon=85_456_000, alt=488_000),
        mav.GpsRawInt(fix_type=3, cog=27_000, vel=250),
        mav.RawImu(5_000_000, *felt, 0, 0, 0, *seen),
        mav.Statustext(text="Ready"),
    ):
        view.hear(Incoming(99.5, 1, 1, message))
    told, now = state_json(station), moment_json(station)
    assert told["link"] == {
        "source": link.name, "open": True, "connected": True, "error": "", "silent_s": 0.5, "reconnects": 6,
        "reboots": 7, "received": 2, "lost": 3, "malformed": 4, "dropped": 5,
    }  # fmt: skip
    (compass,) = told["vehicle"].pop("compasses")
    assert (compass["instance"], compass["device_id"]) == (1, 0)
    sigma_deg = math.degrees(view.compasses[1].calibration_sigma_rad)
    assert compass["calibration_sigma_deg"] == pytest.approx(sigma_deg, abs=0.01)
    assert compass["true_north"]["turn_deg"] == pytest.approx(told["world"]["declination_deg"], abs=0.01)
    assert told["vehicle"] == {
        "key": "key", "system": 1, "autopilot": "ardupilot", "kind": "rover", "armed": True, "mode": 15,
        "boot_s": 5.0, "texts": ["Ready"],
    }  # fmt: skip
    world = {"horizontal_mgauss": 217.0, "total_mgauss": 485.0, "dip_deg": 63.5, "declination_deg": 3.5}
    assert told["world"] == pytest.approx(world, rel=0.02, abs=0.5)
    (heading,) = now.pop("headings")
    assert now == {
        "connected": True, "turned_deg": 0.0, "rate_dps": 0.0, "roll_deg": pytest.approx(10.0, abs=0.1),
        "pitch_deg": 0.0, "still": True, "course_deg": 270.0,
    }  # fmt: skip
    assert (heading["instance"], heading["boot_s"]) == (1, 5.0)
    assert heading["magnetic_deg"] == pytest.approx(30.0, abs=0.3)
    assert heading["true_deg"] == pytest.approx(30.0 + told["world"]["declination_deg"], abs=0.3)
    assert heading["level_mgauss"] == pytest.approx([173.2, -100.0, 400.0], abs=1.0)
    lines = (line.rsplit(" ", 1) for line in metrics_text(station).decode().splitlines() if line[0] != "#")
    scraped = {name.removeprefix("mavcompass_"): float(value) for name, value in lines}
    of_the_compass = {
        "heading_magnetic_degrees": 30.0, "heading_sigma_degrees": heading["sigma_deg"],
        "field_milligauss": 447.2, "dip_degrees": 63.4,
    }  # fmt: skip
    counted = {
        "headings": 0, "messages_received": 2, "messages_lost": 3, "frames_malformed": 4,
        "messages_dropped": 5, "tasks": 0, "reconnects": 6, "reboots": 7,
    }  # fmt: skip
    expected = {"connected": 1.0, "task_running": 0.0} | {f"{n}_total": v for n, v in counted.items()}
    expected |= {f'{name}{{compass="1"}}': value for name, value in of_the_compass.items()}
    assert {name: v for name, v in scraped.items() if "_created" not in name} == pytest.approx(
        expected, abs=0.7
    )
    # Too slow to have a course; turning; and silent for two seconds.
    for time_s, later in (
        (99.6, mav.GpsRawInt(fix_type=3, cog=27_000, vel=50)),
        (97.9, mav.RawImu(5_050_000, *felt, 0, 0, 900, *seen)),
    ):
        view.hear(Incoming(time_s, 1, 1, later))
    now = moment_json(station)
    assert (now["course_deg"], now["still"], now["connected"]) == (None, False, False)
