"""Somebody steps in, or the link goes: a few cells of `scripts/campaigns/fault_matrix.py`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from bent_vehicles import calibrated, perform

from mavcompass.errors import PoorCalibration, WriteFailed
from mavcompass.messages import Message
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.procedure.vehicle_state import VehicleState
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.parameters.undo import load_record, undo_saver

EVENTS = (
    "stick", "mode", "disarmed", "low battery", "stopped", "silent 15 s", "link closed", "silent 2 s"
)  # fmt: skip
Interrupt = Callable[..., Any]
# How what ends it is told to the person, and what comes of it; one that ends it before it turns is refused.
STOPS = r"It (no longer turns; it is (dis)?armed|is still turning, by \d+ deg/s, armed: keep clear)\."
TOLD = {
    "stick": rf"The pilot (moved|holds) a stick\. {STOPS}",
    "mode": rf"The flight mode was changed to (HOLD|LOITER)\. {STOPS}",
    "disarmed": rf"The vehicle (was disarmed\. It said: .+|is disarmed, so it cannot turn itself)\. {STOPS}",
    "low battery": r"The vehicle reports a failsafe\.|The battery is at 9 %\.|The flight mode was changed",
    "stopped": r"Stopped by the system \(SIGTERM\)\.",
    "silent 15 s": r".*(said nothing|fell silent)",
}


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("kind", ["rover", "copter"])
def test_motion_ends_within_a_second_everything_is_put_back_and_the_event_is_named(
    interrupted: Interrupt, kind: str, event: str
) -> None:
    outcome = interrupted("calibrate", kind, event, 1001)
    assert not outcome.wrong, (str(outcome.cell), outcome.told)
    assert outcome.told == "done" or re.match(TOLD.get(event, "."), outcome.told), outcome.told


@pytest.mark.parametrize("event", ["stick", "stopped", "silent 15 s", "low battery"])
@pytest.mark.parametrize("kind", ["boat", "sub", "ackermann-rover", "px4-copter"])
def test_the_other_vehicles_stop_commanding_and_are_put_back_too(
    interrupted: Interrupt, kind: str, event: str
) -> None:
    outcome = interrupted("calibrate", kind, event, 1000)
    assert not outcome.wrong, (str(outcome.cell), outcome.told)


class DeadAfterTheWrite(SimulatedAutopilot):
    """Hear and say nothing any more from a second after its calibration was changed."""

    was: dict[str, float]
    changed_s = math.inf

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        if self.time_s < self.changed_s + 1.0:
            super().receive(message, system, component, port)

    def advance(self, until_s: float) -> Sequence[Outgoing]:
        said = super().advance(until_s)
        if compass_values(self) != self.was:
            self.changed_s = min(self.changed_s, self.time_s)
        return said if self.time_s < self.changed_s + 1.0 else []


def compass_values(vehicle: SimulatedAutopilot) -> dict[str, float]:
    return {name: v for name, v in vehicle.firmware.store.values.items() if name.startswith("COMPASS_")}


def test_a_stop_between_the_write_and_the_proof_puts_the_old_values_back(interrupted: Interrupt) -> None:
    outcome = interrupted("calibrate", "rover", "stopped", command=1)
    assert not outcome.wrong and outcome.told.startswith("Stopped by the system")
    assert any(text.startswith("Writing ") for text in outcome.scene.told)


def test_a_link_that_dies_between_the_write_and_the_proof_is_told_with_the_way_back(
    interrupted: Interrupt,
) -> None:
    outcome = interrupted("calibrate", "rover", "silent 15 s", command=2)
    assert not outcome.wrong and "params restore" in outcome.told


@pytest.mark.parametrize("kind", ["rover", "copter"])
def test_one_undo_file_leads_back_from_the_calibration_and_from_what_was_set_for_it(
    kind: str, tmp_path: Path
) -> None:
    vehicle = DeadAfterTheWrite(kind, seed=1001)
    vehicle.was, before, shown = compass_values(vehicle), dict(vehicle.firmware.store.values), list[str]()
    with pytest.raises(WriteFailed) as told:
        calibrated(vehicle, tmp_path, shown=shown)
    held = vehicle.firmware.store.values
    changed = {name: value for name, value in before.items() if held[name] != value and name[:4] != "STAT"}
    assert "EK3_GBIAS_P_NSE" in changed and "COMPASS_OFS_X" in changed
    assert told.value.undo_file is not None
    back = load_record(told.value.undo_file).before
    assert {name: back[name] for name in changed} == pytest.approx(changed, abs=1e-4)
    # Each is said where it fails, too: the last that is seen of a link that died.
    assert sum("params restore" in text and "could not be undone" in text for text in shown) == 2


def test_what_was_set_for_a_while_and_stays_is_told_beside_what_ended_it(tmp_path: Path) -> None:
    vehicle = DeadAfterTheWrite("rover", seed=1001)
    vehicle.was = compass_values(vehicle)

    def ended() -> Script[None]:
        vehicle.changed_s = -math.inf  # dead from now on
        yield from nothing(None)
        raise PoorCalibration("Too little was seen.", "Turn it further.")

    def script(context: Context, _: VehicleState) -> Script[None]:
        overrides = Overrides(make_dialect("ardupilot", "sim:test"), undo_saver("sim:test", tmp_path))
        yield from overrides.hold(context, {"EK3_GBIAS_P_NSE": 0.1})
        yield from overrides.put_back_after(context, ended(), "It ends.")

    with pytest.raises(PoorCalibration, match="Too little was seen") as told:
        perform(vehicle, script)
    assert told.value.remedy.startswith("Turn it further. Bring the link back, then put the old values back")
    assert str(next(tmp_path.glob("*.json"))) in told.value.remedy
