"""Tests for any vehicle at all, real ones included: `pytest tests/vehicle_live --mav-url URL`.

They turn and write only what a person allows beside the address: a vehicle that is disarmed is not
armed, and what is written is put back.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcompass import messages as mav
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.script import Context, Machine, Script, pause
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.vehicle.connection import Vehicle, connect
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.parameters.undo import undo_saver


@pytest.fixture
def vehicle(mav_url: str) -> Iterator[Vehicle]:
    with connect(mav_url, timeout_s=30.0) as connected:
        yield connected


def is_armed(vehicle: Vehicle) -> bool:
    beats = (heard.message for heard in vehicle.messages(3.0) if isinstance(heard.message, mav.Heartbeat))
    return any(beat.base_mode & 128 for beat in beats)


def test_it_is_found_and_tells_its_compass_parameters(vehicle: Vehicle) -> None:
    assert vehicle.identity.autopilot in ("ardupilot", "px4")
    dialect = make_dialect(vehicle.identity.autopilot)
    parameters = vehicle.parameters()
    present = dialect.instances(parameters)
    assert present
    for instance in present:
        assert dialect.correction(parameters, instance).matrix.shape == (3, 3)


def test_rates_are_granted_and_put_back(vehicle: Vehicle) -> None:
    px4 = vehicle.identity.autopilot == "px4"
    kind = mav.ScaledImu if px4 else mav.RawImu

    def script(context: Context) -> Script[tuple[int | None, int | None, int]]:
        context.system, context.component = vehicle.identity.system, vehicle.identity.component
        heard: list[object] = []
        context.listeners.append(lambda m: heard.append(m) if type(m.message) is kind else None)
        rates = MessageRates()
        before = yield from rates.interval_us(context, kind)
        assert (yield from rates.ask(context, {kind: 20.0}))[kind]
        heard.clear()
        yield from pause(context, 3.0)
        count = len(heard)
        yield from rates.restore(context)
        return before, (yield from rates.interval_us(context, kind)), count

    before, after, count = run(Machine(script), vehicle.link)
    assert count >= 30
    assert before == after


def test_a_parameter_is_written_read_back_and_restored(vehicle: Vehicle, tmp_path: Path) -> None:
    dialect = make_dialect(vehicle.identity.autopilot)
    name = "CAL_MAG0_XOFF" if vehicle.identity.autopilot == "px4" else "COMPASS_OFS_X"
    before = vehicle.parameters()
    step = 0.005 if vehicle.identity.autopilot == "px4" else 5.0
    plan = dialect.plan_values(before, {name: before[name] + step})
    save = undo_saver("test", tmp_path)

    def script(context: Context) -> Script[float]:
        context.system, context.component = vehicle.identity.system, vehicle.identity.component
        outcome = yield from dialect.write(context, plan, save)
        yield from outcome.take_back(context, "It was a test.")
        return outcome.values[name]

    assert run(Machine(script), vehicle.link) == pytest.approx(before[name] + step, rel=1e-5)
    assert vehicle.parameters() == before


def test_an_armed_vehicle_turns_and_a_calibration_is_found_and_nothing_is_written(vehicle: Vehicle) -> None:
    if not is_armed(vehicle):
        pytest.skip("the vehicle is disarmed: arm it in GUIDED (a copter: flying) to let it turn itself")
    before = vehicle.parameters()
    report = vehicle.calibrate(CalibrateSettings(motion="vehicle", writing="never"))
    assert report.accepted, [result.reasons for result in report.results]
    assert vehicle.parameters() == before
    assert is_armed(vehicle)


def test_a_disarmed_vehicle_is_calibrated_by_hand(vehicle: Vehicle) -> None:
    if not os.environ.get("MAVCOMPASS_TURN_BY_HAND"):
        pytest.skip("set MAVCOMPASS_TURN_BY_HAND=1 and turn the vehicle when asked")
    report = vehicle.calibrate(
        CalibrateSettings(motion="hand", writing="never"), on_show=lambda show: print(show.text)
    )
    assert report.accepted, [result.reasons for result in report.results]
