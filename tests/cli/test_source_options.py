"""The options that many commands share: which compasses, which system, which effects."""

from __future__ import annotations

import json
from typing import Any

import click
import pytest

from mavcompass.cli import source
from mavcompass.cli.main import main
from mavcompass.cli.source import open_source
from mavcompass.errors import UsageError
from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER
from mavcompass.vehicle.transport import parse_address


@pytest.mark.parametrize(
    ("value", "chosen"),
    [("1", (1,)), ("3,1", (1, 3)), ("2,2", (2,)), ("all", ()), ("0", None), ("4", None), ("x", None),
     ("1,", None)],
)  # fmt: skip
def test_compasses(value: str, chosen: tuple[int, ...] | None) -> None:
    asked: Any = (click.Context(click.Command("x")), click.Option(["--compass"]), value)
    if chosen is None:
        with pytest.raises(click.BadParameter, match="numbers from 1 to 3"):
            source._instances(*asked)
    else:
        assert source._instances(*asked) == chosen


@pytest.mark.parametrize(
    ("value", "system"),
    [(None, None), ("all", "all"), ("1", 1), ("255", 255), ("0", 0.5), ("256", 0.5), ("-1", 0.5),
     ("one", 0.5)],
)  # fmt: skip
def test_systems(value: str | None, system: Any) -> None:
    asked: Any = (click.Context(click.Command("x")), click.Option(["--system"]), value)
    if system == 0.5:
        with pytest.raises(click.BadParameter, match="from 1 to 255, or all"):
            source._systems(*asked)
    else:
        assert source._systems(*asked) == system


def test_effects_go_to_simulated_vehicles_only_beside_those_of_the_address() -> None:
    with pytest.raises(UsageError, match=r"--effect is for sim:VEHICLE only"):
        open_source(parse_address("udpin:127.0.0.1:14550"), ("hard_iron:x=100",))
    with pytest.raises(UsageError, match="no_such_effect"):
        open_source(parse_address("sim:rover"), ("no_such_effect",))
    with open_source(parse_address("sim:rover,seed=4"), ("hard_iron:x=100",)) as link:
        assert link.receive(2.0) is not None


@pytest.mark.parametrize(("station", "identity"), [(True, GROUND_STATION), (False, ONBOARD_COMPUTER)])
def test_who_we_are(station: bool, identity: object) -> None:
    with open_source(parse_address("sim:rover"), (), as_ground_station=station) as link:
        assert link.identity == identity


def test_a_blind_trial_is_held_of_the_tier_that_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["gap", "blind-trial", "--cases", "1", "--generator", "vehicles", "--tier"]
    assert main([*words, "none", "--json", "-"]) == 0
    assert [case["tier"] for case in json.loads(capsys.readouterr().out)["cases"]] == ["none"]
