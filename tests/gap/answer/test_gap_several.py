"""Several recordings of one vehicle: what is the vehicle's, and what is of one flight."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavcompass.cli.main import main
from mavcompass.gap import diagnose_gap
from mavcompass.gap.answer.naming import together
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs import write_track_csv
from mavcompass.simulation import effects
from mavcompass.simulation.effects import Setting

_IRON = effects.parse("hard_iron:x=40,y=-25,z=15")
_MAGNET = effects.parse("hard_iron_step:x=0,y=60,z=0,on_s=20")


def flights() -> list[list[Setting]]:
    return [[_IRON], [_IRON, _MAGNET], [_IRON]]


def test_iron_is_the_vehicles_and_a_magnet_that_comes_once_the_flights() -> None:
    found = [
        diagnose_gap(make_track(Recipe("rich", duration_s=50.0, rate_hz=10.0, seed=70 + i), settings))
        for i, settings in enumerate(flights())
    ]
    vehicle = together(found)
    (shared,) = vehicle.shared
    assert shared.cause.effect == "hard_iron" and shared.named_in == 3
    for axis, true in (("x", 40.0), ("y", -25.0), ("z", 15.0)):
        low, high = shared.cause.ci95[axis]
        assert shared.cause.parameters[axis] == pytest.approx(true, abs=1.0)
        assert high - low < min(d.causes[-1].ci95[axis][1] - d.causes[-1].ci95[axis][0] for d in found) + 1e-9
    assert [[c.effect for c in own] for own in vehicle.own] == [[], ["hard_iron_step"], []]


def test_iron_that_differs_from_flight_to_flight_is_not_the_vehicles() -> None:
    other = effects.parse("hard_iron:x=-30,y=60,z=0")
    found = [
        diagnose_gap(make_track(Recipe("rich", duration_s=50.0, rate_hz=10.0, seed=80 + i), [iron]))
        for i, iron in enumerate((_IRON, other))
    ]
    vehicle = together(found)
    assert not vehicle.shared and all(own for own in vehicle.own)


def test_person_diagnoses_two_recordings_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for i, log in enumerate(logs):
        write_track_csv(make_track(Recipe("rich", duration_s=40.0, rate_hz=10.0, seed=90 + i), [_IRON]), log)
    answer = tmp_path / "vehicle.json"
    assert main(["gap", "diagnose", *map(str, logs), "--json", str(answer)]) == 0
    document = json.loads(answer.read_text())
    assert [v["effect"] for v in document["vehicle"]] == ["hard_iron"]
    assert [f["schema"] for f in document["flights"]] == ["mavcompass.gap/1"] * 2
    assert "of the vehicle (in 2 of 2 flights): hard_iron" in capsys.readouterr().out
