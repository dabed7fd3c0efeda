"""A vehicle that sends more than can be read: the service says so, on the page and to the pilot."""

from __future__ import annotations

from pathlib import Path

import pytest
from running_service import configured, wait_for

from mavcompass.messages import Incoming, Message
from mavcompass.service.mavlink.component import finding_text
from mavcompass.service.station import Station
from mavcompass.service.web.state import state_json
from mavcompass.service.work.history import History
from mavcompass.vehicle.link import Link


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


def test_where_nothing_comes_the_station_goes_on_all_the_same(tmp_path: Path) -> None:
    link = Flooded("udpin:127.0.0.1:14550")
    station = Station(configured(tmp_path, "udpin:127.0.0.1:14550"), History(tmp_path / "h.db"), lambda: link)
    station.start()
    wait_for(lambda: link.longest_s)
    assert station.stop() and link.longest_s <= 1.0


@pytest.mark.parametrize(("behind_s", "told"), [(0.0, False), (4.9, False), (5.1, True)])
def test_a_flood_of_five_seconds_is_told(behind_s: float, told: bool, tmp_path: Path) -> None:
    link = Flooded("udpin:127.0.0.1:14550")
    station = Station(configured(tmp_path, "udpin:127.0.0.1:14550"), History(tmp_path / "h.db"), lambda: link)
    assert station.findings == ()
    station.link, link.behind = link, behind_s
    assert bool(station.findings) is told
    if told:
        (finding,) = state_json(station)["findings"]
        assert (
            finding["id"] == "link"
            and finding["compass"] == 0
            and "14550 than this computer" in finding["text"]
        )
        assert "SRn_*" in finding["remedy"]
        assert finding_text(station.findings[0]).text == "Compass: more messages than can be read"
