"""Several vehicles on the service's link: none is taken by chance."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from running_service import configured, wait_for

from mavcompass.messages import Statustext
from mavcompass.service.station import Station
from mavcompass.service.work.history import History
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink


class Two(SimulatedAutopilot):
    """Be two vehicles, of which the second says what the first says under its own system id."""

    def advance(self, until_s: float) -> list[Outgoing]:
        said = super().advance(until_s)
        return [each for one in said for each in (one, replace(one, system=5 - one.system))]


class Accompanied(SimulatedAutopilot):
    """Have a ground station on the link, which speaks before each message of the vehicle."""

    def advance(self, until_s: float) -> list[Outgoing]:
        other = Statustext(text="said by another")
        said = super().advance(until_s)
        return [each for one in said for each in (replace(one, message=other, system=255), one)]


@contextmanager
def station_at(folder: Path, system: int, kind: type[SimulatedAutopilot] = Two) -> Iterator[Station]:
    config = configured(folder, "tcp:127.0.0.1:5760")
    config = replace(config, vehicle=replace(config.vehicle, system=system))
    history = History(folder / "history.db")
    vehicle = kind("rover", seed=3, system=2, other_stations=())
    station = Station(config, history, lambda: SimulatedLink(vehicle, speed=5.0))
    station.start()
    try:
        yield station
    finally:
        station.stop()
        history.close()


def test_a_service_says_which_there_are_until_one_is_named(tmp_path: Path) -> None:
    with station_at(tmp_path, 0) as station:
        wait_for(lambda: station.link_error)
        assert "2 vehicles are on this link" in station.link_error and "--system" in station.link_error
        assert "system 2: rover, ardupilot, armed" in station.link_error and "system 3:" in station.link_error
        assert station.view is None
    with station_at(tmp_path, 3) as station:
        wait_for(lambda: station.view)
        assert station.view is not None and station.view.identity.system == 3 and station.link is not None
        station.link.statistics.shared.add(3)
        (told,) = wait_for(lambda: [one for one in station.findings if one.id == "link"])
        assert told.instance == 0 and told.short == "Compass: two autopilots share a system id"
    with station_at(tmp_path, 4) as station:  # which is not there
        wait_for(lambda: station.link and station.link.statistics.received > 200)
        assert station.view is None


def test_what_another_says_as_the_vehicle_is_found_is_not_the_vehicles(tmp_path: Path) -> None:
    with station_at(tmp_path, 0, Accompanied) as station:
        view = wait_for(lambda: station.view)
        wait_for(lambda: view.state.heartbeat)
        assert view.identity.system == 2 and "said by another" not in view.state.texts


def test_history_and_recordings_are_their_owners(tmp_path: Path) -> None:
    old = tmp_path / "history.db"
    old.touch(0o644)
    History(old).close()
    History(tmp_path / "new" / "history.db").close()
    assert {path.stat().st_mode & 0o777 for path in tmp_path.rglob("history.db*")} == {0o600}
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
