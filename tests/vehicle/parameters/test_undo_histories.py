"""Undo in drawn histories: some of the campaign `scripts/campaigns/undo_histories.py`, and its sharpness."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

from mavcompass.procedure.nameplate import Nameplate
from mavcompass.vehicle.parameters import undo


@pytest.fixture(scope="module")
def campaign(campaigns: Callable[[str], ModuleType]) -> ModuleType:
    return campaigns("undo_histories")


def test_no_value_goes_to_the_wrong_vehicle(campaign: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.main(["--histories", "40", "--seed", "100001"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("blunt", ["identity", "newest"])
def test_the_campaign_notices(
    blunt: str, campaign: ModuleType, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if blunt == "identity":
        monkeypatch.setattr(Nameplate, "is_same", lambda self, other: True)
    else:
        monkeypatch.setattr(undo, "_number", lambda path: int(path.name[9:17]))
    assert campaign.main(["--histories", "20", "--seed", "100001"]) == 1


WHOSE = Nameplate("ardupilot", 1, "0a", "32", "4.5.7", (97_539, 0, 0))


@pytest.mark.parametrize(
    ("changed", "same"),
    [({}, True), ({"firmware": "4.6.3"}, True), ({"uid": "0b"}, False), ({"uid": ""}, False),
     ({"system": 2}, False), ({"board": "33"}, False), ({"compasses": (97_539, 131_874, 0)}, False),
     ({"autopilot": "px4"}, False)],
)  # fmt: skip
def test_a_vehicle_is_the_same_where_all_but_its_firmware_is(changed: dict[str, object], same: bool) -> None:
    other = Nameplate.of_document({**WHOSE.document(), **changed})
    assert WHOSE.is_same(other) is other.is_same(WHOSE) is same


def test_without_a_unique_id_the_firmware_must_be_the_same_too() -> None:
    mute = {**WHOSE.document(), "uid": ""}
    older, newer = (Nameplate.of_document({**mute, "firmware": version}) for version in ("4.5.7", "4.6.3"))
    assert older.is_same(older) and not older.is_same(newer)
