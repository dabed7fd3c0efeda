"""The tables of the criterion belong to the code that reads them, and to the command that makes them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np
import pytest

from mavcompass.gap.answer.evidence import figures, statistics
from mavcompass.gap.attitude.reference import ReferenceKind
from mavcompass.gap.diagnose import examine
from mavcompass.gap.tables import KINDS, OUTCOMES, parsed, tables, usual
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.installation.parts import params_path

ROOT = Path(__file__).parents[2]
DOCUMENT: dict[str, Any] = json.loads(params_path("gap/criterion.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def command(campaigns: Callable[[str], ModuleType]) -> ModuleType:
    return campaigns("learn_gap")


def test_the_tables_are_those_of_the_command_as_it_stands(command: ModuleType) -> None:
    assert DOCUMENT["made"]["lot"] == [list(one) for one in command.LOT]
    assert DOCUMENT["levels"] == command.LEVELS
    assert DOCUMENT["map"]["names"] == list(command.MAPPED)
    assert DOCUMENT["healthy"]["names"] == list(command.LEFT)


def test_every_statistic_that_the_tables_name_is_one_that_a_recording_has() -> None:
    evidence = examine(make_track(Recipe("figure-8", duration_s=40.0, rate_hz=10.0, seed=3)), None)
    known = statistics(evidence, *figures(evidence, evidence.identified.fit, with_scatter=True))
    assert {*tables().map.names, *tables().healthy.names} <= known.values.keys()
    assert sum(tables().map.probabilities(known.values).values()) == pytest.approx(1.0)
    assert 0.0 < tables().healthy.p_of_fit(known.kind, known.values) <= 1.0


def test_healthy_vehicles_of_every_kind_were_seen_and_bound_the_p_values() -> None:
    healthy, levels = tables().healthy, tables().levels
    assert set(healthy.usual) == set(KINDS) and len(tables().map.weights[0]) == len(OUTCOMES)
    # A rate that so few could not have shown would never be reached.
    assert 1.0 / (1.0 + healthy.count) < min(levels.gain, levels.fit)
    assert healthy.p_of_gain(-1.0) > max(levels.gain, levels.fit) > healthy.p_of_gain(1e9)
    assert healthy.p_of_gain(50.0) >= healthy.p_of_gain(500.0)


def evidence_of(command: ModuleType, kind: str, tier: str, number: int) -> dict[str, Any]:
    """Make a line of evidence as the command keeps them, by chance alone."""
    rng = np.random.default_rng([KINDS.index(kind), len(tier), number])  # type: ignore[arg-type]
    names = {*command.MAPPED, *command.LEFT}
    ids = [[], ["hard_iron"], ["soft_iron"], ["hard_iron", "soft_iron"]]
    order = rng.permutation(len(ids)).tolist()
    return {
        "case": ["vehicles", tier, True, 1, number], "maker": "vehicles", "tier": tier, "kind": kind,
        "truth": {"none": [], "single": ["hard_iron"], "pair": ["hard_iron", "soft_iron"]}.get(tier, []),
        "beside": [], "gain": float(rng.exponential(50.0)), "found": True, "rows": 500, "overdispersion": 1.2,
        "values": {name: float(rng.normal()) for name in names}, "separation": None,
        "sets": [
            {"ids": ids[i], "sse": 500.0 + 30.0 * k, "strain": 3.0, "d": 3 * len(ids[i]), "same": k == 2}
            for k, i in enumerate(order)
        ],
    }  # fmt: skip


def test_evidence_becomes_tables_with_all_that_is_printed_of_them(
    command: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    tiers = ("none", "single", "pair", "outside")
    lines = [evidence_of(command, kind, tier, k) for kind in KINDS for tier in tiers for k in range(6)]
    command.penalties(lines)
    document = command.learn(lines, lines)
    made = parsed(json.loads(json.dumps(document)))
    assert set(made.healthy.usual) == set(KINDS) and made.healthy.count == 24
    assert sum(made.map.probabilities(lines[0]["values"]).values()) == pytest.approx(1.0)
    bins = command.report("out of fold", lines, command.out_of_fold(lines))
    command.false_alarms(lines, document)
    assert command.drawn(bins).count("<circle") == len(bins) > 0
    said = capsys.readouterr().out
    assert "Brier" in said and "hard_iron" in said and "alarmed" in said
    # A try has too few of some kind; it prints what it has.
    few = [line for line in lines if line["kind"] != "reference"]
    assert set(command.learn(few, few)["healthy"]["usual"]) == set(KINDS) - {"reference"}


def test_what_is_usual_is_used_and_what_is_used_is_there() -> None:
    known = {f"{table}.{name}" for table, values in vars(usual).items() for name in vars(values)}
    code = "".join(file.read_text("utf-8") for file in (ROOT / "mavcompass/gap").rglob("*.py"))
    used = set(re.findall(r"\busual\.(\w+\.\w+)", code))
    # An attitude's doubt goes by its kind.
    used |= {f"doubt.{kind}_rad" for kind in get_args(ReferenceKind)}
    assert used == known and usual.yaw.lost_rad == pytest.approx(1.0472, abs=1e-4)


def test_tables_of_another_form_are_refused() -> None:
    with pytest.raises(ValueError, match="criterion"):
        parsed({**DOCUMENT, "schema": "another/1"})
