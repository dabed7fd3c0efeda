"""A vehicle in a program's hands: `mavcompass.connect`."""

from __future__ import annotations

from typing import Any

import pytest

from mavcompass.errors import LinkLost, NoVehicle, Refused
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle import connection
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.connection import connect
from mavcompass.vehicle.links.simulated import SimulatedLink


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> SimulatedLink:
    """The link that is opened, whatever the address."""
    opened = SimulatedLink(SimulatedAutopilot("rover", seed=7, system=4), "sim:rover")
    monkeypatch.setattr(connection, "open_link", lambda source: opened)
    return opened


def test_a_recording_knows_the_corrections_in_force_and_is_as_long_as_asked(link: SimulatedLink) -> None:
    with connect("sim:rover") as vehicle:
        held = vehicle.parameters()
        track = vehicle.record(4.0)
    assert vehicle.identity.system == 4
    assert track.autopilot == "ardupilot" and track.vehicle == "rover" and track.source == "sim:rover"
    assert 3.0 <= track.duration_s <= 4.0  # it speaks once a second where nobody asks for more
    compass = track.compasses[1]
    assert compass.correction_known
    assert compass.in_force[-1].correction.offsets_mgauss[0] == held["COMPASS_OFS_X"]
    with pytest.raises(LinkLost):
        link.receive(1.0)


def test_messages_are_the_vehicles_own_and_end_in_time(
    link: SimulatedLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = connect("sim:rover", system=4)
    began_s, receive, heard = link.now(), link.receive, 0

    def with_another(timeout_s: float) -> Any:
        nonlocal heard
        incoming, heard = receive(timeout_s), heard + 1
        return (
            None if incoming is None or heard % 2 else type(incoming)(incoming.time_s, 9, 1, incoming.message)
        )

    monkeypatch.setattr(link, "receive", with_another)
    assert list(vehicle.messages(1.0)) == []
    monkeypatch.undo()
    assert link.now() - began_s == pytest.approx(1.0, abs=0.01)
    assert {message.system for message in vehicle.messages(1.0)} == {4}
    vehicle.close()


def test_a_link_on_which_nobody_answers_is_closed_again(link: SimulatedLink) -> None:
    with pytest.raises(NoVehicle):
        connect("sim:rover", system=5, timeout_s=2.0)
    with pytest.raises(LinkLost):
        link.receive(1.0)


def test_it_is_the_vehicle_that_was_connected_that_is_calibrated(
    link: SimulatedLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[CalibrateSettings] = []
    monkeypatch.setattr(
        connection, "calibrate_on", lambda link, source, settings, *_, **__: asked.append(settings)
    )
    with connect("sim:rover") as vehicle:
        vehicle.calibrate()
        vehicle.calibrate(CalibrateSettings(method="one-point", max_heading_error_deg=3.0))
        vehicle.calibrate(method="one-point", max_heading_error_deg=3.0)
    assert [settings.system for settings in asked] == [4, 4, 4] and asked[0].writing == "never"
    told = [(settings.method, settings.max_heading_error_deg) for settings in asked]
    assert told == [("four-positions", 2.0), ("one-point", 3.0), ("one-point", 3.0)]


@pytest.mark.parametrize(("kind", "name"), [("rover", "COMPASS_DIA2_X"), ("px4-copter", "CAL_MAG0_ZOFF")])
def test_a_parameter_that_is_not_a_number_is_named_before_anything_moves(kind: str, name: str) -> None:
    vehicle = SimulatedAutopilot(kind, seed=7, parameters={name: float("nan")})
    with pytest.raises(Refused, match=f"{name} of this vehicle: not a number"):
        calibrate_on(SimulatedLink(vehicle, "sim"), "sim", CalibrateSettings())
