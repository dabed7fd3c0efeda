"""The live heading: which messages make it, what it refuses, and that it ends with the vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from mavcompass.earth_field import earth_field
from mavcompass.enums import MavCmd
from mavcompass.errors import LinkLost, Refused
from mavcompass.frames import wrap_angle
from mavcompass.messages import (
    CommandLong,
    GlobalPositionInt,
    Message,
    RawImu,
    ScaledImu,
    ScaledImu2,
    ScaledImu3,
    SystemTime,
    message_id,
)
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.heading_stream import LiveHeading, headings
from mavcompass.vehicle.links.simulated import SimulatedLink


class Listening(SimulatedLink):
    """Leave out messages of these kinds, the date before the place, and all after a time."""

    left_out: tuple[type, ...] = ()
    knows_its_place = no_third = False
    on_sent: Callable[[CommandLong], object] = staticmethod(lambda _: None)
    silent_from_s = math.inf
    unix_s = 0.0

    def send(self, message: Message) -> None:
        if isinstance(message, CommandLong) and message.command == MavCmd.SET_MESSAGE_INTERVAL:
            self.on_sent(message)
        super().send(message)

    def receive(self, timeout_s: float):  # type: ignore[no-untyped-def]
        heard = super().receive(timeout_s)
        if heard is None or isinstance(heard.message, self.left_out) or heard.time_s > self.silent_from_s:
            return None
        self.knows_its_place |= isinstance(heard.message, GlobalPositionInt)
        if isinstance(heard.message, SystemTime) and not self.knows_its_place:
            return None
        if self.unix_s and isinstance(heard.message, SystemTime):
            return replace(heard, message=replace(heard.message, time_unix_usec=round(1e6 * self.unix_s)))
        if self.no_third and isinstance(heard.message, RawImu):
            return replace(heard, message=replace(heard.message, zmag=0))
        return heard


def listening(kind: str = "rover", armed: bool = True) -> Listening:
    return Listening(SimulatedAutopilot(kind, seed=2, calibration="exact", armed=armed), "sim:" + kind)


def first(link: SimulatedLink, count: int = 20, **options: bool) -> list[LiveHeading]:
    stream = headings(link, "sim:x", **options)
    try:
        return list(islice(stream, count))
    finally:
        stream.close()  # type: ignore[attr-defined]


def off_deg(found: LiveHeading, link: SimulatedLink) -> float:
    yaw_rad = link.autopilot.body.yaw_rad  # type: ignore[attr-defined]
    assert found.true_rad is not None
    return math.degrees(math.remainder(found.true_rad - yaw_rad, 2.0 * math.pi))


@pytest.mark.parametrize(("kind", "grid_deg"), [("rover", 1.25), ("px4-copter", 0.33)])
def test_it_points_where_the_nose_does(kind: str, grid_deg: float) -> None:
    """West of their zone's middle, 2.2 degrees near Canberra and 0.5 near Zurich: grid north is off there."""
    for yaw_deg in (-0.5, 0.5, 90.0):  # the declination goes past north
        link = listening(kind)
        link.autopilot.body.yaw_rad = math.radians(yaw_deg)  # type: ignore[attr-defined]
        found = first(link)
        assert abs(off_deg(found[-1], link)) < 3.0
        times = [heading.boot_s for heading in found]
        assert times == sorted(set(times)), "each fresh message once"
        told = [rad for h in found for rad in (h.magnetic_rad, h.true_rad, h.grid_rad)]
        assert all(rad is not None and 0.0 <= rad < 2.0 * math.pi for rad in told)
        for h in found:
            assert math.degrees(wrap_angle(h.grid_rad - h.true_rad)) == pytest.approx(grid_deg, abs=0.01)  # type: ignore[operator]


@pytest.mark.parametrize(("orientation", "least_deg"), [(0, 0.0), (2, 30.0), (4, 60.0)])
def test_one_that_is_mounted_turned_claims_what_it_is_off(orientation: int, least_deg: float) -> None:
    effects = (f"orientation:orientation={orientation}",) if orientation else ()
    link = SimulatedLink(SimulatedAutopilot("rover", seed=2, calibration="exact", effects=effects))
    found = first(link, 80)[-1]
    off, claimed = abs(off_deg(found, link)), math.degrees(found.sigma_rad)
    assert least_deg <= off < 1.05 * claimed and claimed < 1.05 * off + 4.0


def test_the_declination_is_the_dates() -> None:
    link = listening()
    link.unix_s = 59.0 * 31_556_952.0  # 2029
    found = first(link)[-1]
    place = np.array(link.autopilot.firmware.reports.place()) * (1e-7, 1e-7, 1e-3)
    then = earth_field(*place, 2029.0).declination_rad  # 1.3e-3 rad more than in 2026
    assert found.true_rad is not None
    assert found.true_rad - found.magnetic_rad == pytest.approx(then, abs=1e-4)


def test_what_the_receiver_of_one_that_drives_shows_of_north_is_looked_at_every_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = listening()
    steering = type(link.autopilot.firmware.steering)  # type: ignore[attr-defined]
    monkeypatch.setattr(steering, "control", lambda *_: Drive(0.0, 3.0, motors_on=True))
    *_, found = first(link, 700)
    assert found.north is not None
    assert [one.seconds for one in (*found.north.learnt, *found.north.doubted)] == pytest.approx(
        [60.0], abs=2.0
    )
    assert abs(off_deg(found, link)) < 3.0


@pytest.mark.parametrize("two_axis", [True, False])
def test_two_axes_know_the_world_and_need_no_third(two_axis: bool) -> None:
    link = listening(armed=False)
    link.no_third = True
    link.autopilot.turn_by_hand([HandMove(0.0, 3.0, 60.0, roll_rad=0.0, pitch_rad=0.3)])  # type: ignore[attr-defined]
    assert (abs(off_deg(first(link, 100, two_axis=two_axis)[-1], link)) < 3.0) is two_axis


@pytest.mark.parametrize(
    ("kind", "instance", "asked_hz"),
    [
        ("rover", 1, {RawImu: 10.0, ScaledImu2: 2.0, ScaledImu3: 2.0}),
        ("rover", 2, {RawImu: 10.0, ScaledImu2: 10.0, ScaledImu3: 2.0}),
        ("px4-copter", 1, {ScaledImu: 10.0, ScaledImu2: 2.0}),
    ],
)
def test_the_compass_that_is_asked_for_comes_often_and_those_beside_it_twice_a_second(
    kind: str, instance: int, asked_hz: dict[type[Message], float]
) -> None:
    asked = dict[int, float]()
    link = listening(kind)
    link.on_sent = lambda sent: asked.setdefault(int(sent.param1), 1e6 / (sent.param2 or math.inf))
    next(headings(link, "sim:x", instance))
    assert {told: asked.get(message_id(told)) for told in asked_hz} == pytest.approx(asked_hz)


def test_two_axes_are_refused_where_the_place_is_unknown() -> None:
    link = listening()
    link.left_out = (GlobalPositionInt,)
    with pytest.raises(Refused, match="does not know its place"):
        first(link, two_axis=True)
    found = first(link)[-1]
    assert found.true_rad is None and found.grid_rad is None and found.sigma_rad > 0.0


def test_another_compass_is_read_from_its_own_message() -> None:
    link = listening()
    link.left_out = (ScaledImu2,)
    stream = headings(link, "sim:rover", 2)
    link.silent_from_s = link.now() + 20.0
    with pytest.raises(LinkLost, match="fell silent"):
        next(stream)
    link.left_out, link.silent_from_s = (), math.inf
    assert next(headings(link, "sim:rover", 2)).sigma_rad > 0.0


def test_a_compass_that_is_not_there_is_refused() -> None:
    link = listening()
    link.autopilot.firmware.store.values["COMPASS_DEV_ID3"] = 0.0
    link.left_out = (ScaledImu3,)
    with pytest.raises(Refused, match="has no compass 3"):
        next(headings(link, "sim:rover", 3))


def test_a_compass_that_reports_is_there_whatever_its_id() -> None:
    link = listening()
    link.autopilot.firmware.store.values["COMPASS_DEV_ID3"] = 0.0
    assert 0.0 <= next(headings(link, "sim:rover", 3)).magnetic_rad < 7.0


def test_it_ends_with_the_vehicle() -> None:
    link = listening()
    stream = headings(link, "sim:rover")
    next(stream)
    link.silent_from_s = link.now() + 1.0
    with pytest.raises(LinkLost, match="fell silent"):
        list(stream)
