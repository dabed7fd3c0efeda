"""Somebody steps in: a few moments of the campaign `scripts/campaigns/interruptions.py`."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

EVENTS = ("stick", "mode", "disarm", "battery", "signal", "silence", "broken", "two-seconds")


@pytest.fixture(scope="module")
def campaign() -> ModuleType:
    path = Path(__file__).parents[2] / "scripts" / "campaigns" / "interruptions.py"
    spec = importlib.util.spec_from_file_location("interruptions", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("kind", ["rover", "copter"])
def test_motion_ends_within_a_second_and_everything_is_put_back(
    campaign: ModuleType, kind: str, event: str
) -> None:
    # Other seeds than the campaign's; moments before the end of every run.
    outcomes = [campaign.interrupt(kind, event, seed, 18.0) for seed in range(1000, 1003)]
    happened = [outcome for outcome in outcomes if outcome is not None]
    assert len(happened) >= 2
    assert [(o.seed, o.at_s, o.told, o.wrong) for o in happened if o.wrong] == []


@pytest.mark.parametrize("event", ["stick", "signal", "silence"])
@pytest.mark.parametrize("kind", ["boat", "sub", "ackermann-rover", "px4-copter"])
def test_the_other_vehicles_stop_commanding_and_are_put_back_too(
    campaign: ModuleType, kind: str, event: str
) -> None:
    outcome = campaign.interrupt(kind, event, 1000, 25.0)
    assert outcome is not None
    # Water carries a turn on for longer than a second: there the commands are judged alone.
    assert set(outcome.wrong) <= {"turned more than 1 s after"}, (outcome.at_s, outcome.told)
    assert outcome.command_s <= 1.0


def test_each_event_is_named_to_the_person(campaign: ModuleType) -> None:
    told = {event: campaign.interrupt("rover", event, 1001, 20.0).told for event in EVENTS[:6]}
    assert told["stick"] == "The pilot moved a stick."
    assert told["mode"] == "The flight mode was changed to HOLD."
    assert told["disarm"] == "The vehicle was disarmed."
    assert told["battery"] in (
        "The vehicle reports a failsafe.",
        "The battery is at 9 %.",
        "The flight mode was changed to HOLD.",
    )
    assert told["signal"] == "Stopped by the system (SIGTERM)."
    assert "said nothing" in told["silence"] or "fell silent" in told["silence"]
