"""How long a vehicle is given to come to rest before it is dwelt upon as it is."""

from __future__ import annotations

import math

import pytest

from mavcompass import messages as mav
from mavcompass.procedure.positions import DwellSettings, Rest, VehicleMover, Window, dwell
from mavcompass.procedure.positions.visiting import wait_still
from mavcompass.procedure.script import Context, Machine, Script, Show, Tick
from mavcompass.procedure.turning import GyroAngle

SETTINGS = DwellSettings(settle_s=0.3, patience_s=3.0, tilting_patience_s=9.0)


def imu(time_s: float, yaw_rate_deg_s: float, roll_rate_deg_s: float) -> mav.Incoming:
    milli = 1000.0 * math.pi / 180.0
    message = mav.RawImu(
        time_usec=round(time_s * 1e6),
        zacc=-1000,
        xgyro=round(roll_rate_deg_s * milli),
        zgyro=round(yaw_rate_deg_s * milli),
        xmag=200,
        zmag=400,
    )
    return mav.Incoming(time_s, 1, 1, message)


def settle(
    yaw_rate_deg_s: float, roll_rate_deg_s: float, until_s: float = math.inf, tilts_until_s: float = math.inf
) -> tuple[float, bool, list[str]]:
    """Move a vehicle until a time, then keep it still: how long it waits, whether it rests, what is said."""
    rest = Rest()
    mover = VehicleMover(GyroAngle(), rest)
    shown: list[str] = []

    def script(context: Context) -> Script[tuple[float, bool]]:
        context.listeners.append(rest.hear)
        began_s = context.now
        rests = yield from wait_still(context, mover, SETTINGS)
        return context.now - began_s, rests

    machine = Machine(script)
    for step in range(2000):
        time_s = 1.0 + 0.04 * step
        sway = math.sin(time_s * 2.0)
        moving = time_s < 1.0 + until_s
        tilts = roll_rate_deg_s * sway if time_s < 1.0 + tilts_until_s else 0.0
        rates = (yaw_rate_deg_s, tilts) if moving else (0.0, 0.0)
        shown += [action.text for action in machine.step(imu(time_s, *rates)) if isinstance(action, Show)]
        if machine.done:
            break
    assert machine.result is not None
    return (*machine.result, shown)


def test_rest_is_not_waited_for_where_it_is() -> None:
    waited_s, rests, shown = settle(0.0, 0.0)
    assert rests and waited_s < 0.5 and not shown


def test_what_hunts_for_its_heading_is_dwelt_upon_soon() -> None:
    waited_s, rests, shown = settle(6.0, 0.0)
    assert not rests and waited_s == pytest.approx(3.0, abs=0.2)
    assert shown == ["Waiting until it stands still: its nose still swings."]


def test_what_tilts_to_and_fro_is_given_more_time() -> None:
    waited_s, rests, shown = settle(0.0, 60.0, until_s=6.0)
    assert rests and 6.0 < waited_s < 7.5
    assert shown == ["Waiting until it stands still: it still rocks."]
    waited_s, rests, _ = settle(0.0, 60.0)
    assert not rests and 8.8 < waited_s < 10.5
    # What has tilted, and hunts for its heading since, is given no more than that.
    waited_s, rests, _ = settle(6.0, 60.0, tilts_until_s=2.5)
    assert not rests and 3.0 < waited_s < 5.0


def test_a_dwell_that_was_not_heard_begins_anew() -> None:
    rest, gyro = Rest(), GyroAngle()
    mover = VehicleMover(gyro, rest)

    def script(context: Context) -> Script[Window]:
        context.listeners += [rest.hear, gyro.hear]
        return (yield from dwell(context, mover, DwellSettings()))

    machine = Machine(script)
    for step in range(400):
        time_s = 1.0 + 0.04 * step
        if 2.0 < time_s < 4.0:
            machine.step(Tick(time_s))  # the link is away
        else:
            machine.step(imu(time_s, 0.0, 0.0))
        if machine.done:
            break
    window = machine.result
    assert window is not None and window.start_s >= 4.0
    assert window.end_s - window.start_s == pytest.approx(1.7, abs=0.15)
