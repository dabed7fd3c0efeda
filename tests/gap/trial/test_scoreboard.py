"""The blind trial's table: which cases count in which line, at both sides of every limit."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from mavcompass.gap.trial.cases import Label, Tier
from mavcompass.gap.trial.trial import Answer, Case, Trial, scoreboard
from mavcompass.report.gap import reliability, write_trial_report

TRUTH = ("hard_iron:x=9",)


def answer(verdict: str = "named", **more: object) -> Answer:
    named = ("hard_iron",) if verdict in ("named", "named_with_remainder") else ()
    return replace(Answer(verdict, named, (), 2.0, 1.0, 0.5, (0.4, 0.6), 1.0, 0.8), **more)  # type: ignore[arg-type]


def case(tier: Tier, separation: float, answered: Answer | None = None, **more: object) -> Case:
    effects = () if tier == "none" else TRUTH
    made = Case(
        Label(tier, "hand", 1, effects, 20.0), answered or answer(), None, separation, True, True, math.nan
    )
    return replace(made, **more)  # type: ignore[arg-type]


NAN = math.nan
SINGLE, NEAR = "single, d_sep >= 9: exact", "single, d_sep 5 to 9: in the set"
NOISY = "single without shift (noise, steps, repeats): exact"
PAIR, PAIR_NEAR = "pair, both d_sep >= 9: exact", "pair, both d_sep >= 9: in the set"
HIDDEN, MISNAMED = "withheld, d_perp >= 12: flagged", "withheld, d_perp >= 12: misnamed"
OUTSIDE, OUT_MISNAMED = "outside, d_perp >= 12: flagged", "outside, d_perp >= 12: misnamed"
AGAIN, AGAIN_NEAR = "restored, d_perp >= 12 and d_sep >= 9: exact", "restored, d_perp >= 12: in the set"
ORACLE, COVERS = "restored: within 5 % of the oracle", "shrink's interval covers the true shrink"
NOTHING = "no effect: named or unknown"
withheld, shrunk = partial(case, "withheld", 12.0), partial(case, "single", 9.0)


@pytest.mark.parametrize(
    ("line", "counted", "left_out"),
    [
        (NOTHING, case("none", NAN), case("single", 20.0)),
        (SINGLE, case("single", 9.0), case("single", 8.99)),
        (SINGLE, case("single", 50.0), case("pair", 50.0)),
        (NEAR, case("single", 5.0), case("single", 4.99)),
        (NEAR, case("single", 8.99), case("single", 9.0)),
        (NOISY, case("single", NAN), case("single", 9.0)),
        (PAIR, case("pair", 9.0), case("pair", 8.99)),
        (PAIR_NEAR, case("pair", 9.0), case("single", 9.0)),
        (HIDDEN, case("withheld", 12.0), case("withheld", 11.99)),
        (MISNAMED, case("withheld", 12.0), case("outside", 12.0)),
        (OUTSIDE, case("outside", 12.0), case("outside", 11.99)),
        (OUT_MISNAMED, case("outside", 12.0), case("withheld", 12.0)),
        (AGAIN, withheld(own_separation=9.0), withheld(own_separation=8.99)),
        (AGAIN_NEAR, withheld(), case("withheld", 11.99)),
        (ORACLE, withheld(oracle_shrink=1.0), withheld(oracle_shrink=NAN)),
        (COVERS, shrunk(true_shrink=0.5), shrunk(true_shrink=NAN)),
        (COVERS, shrunk(true_shrink=0.5), shrunk(answer(shrink_ci95=(NAN, NAN)), true_shrink=0.5)),
    ],
)
def test_a_line_counts_its_own_cases_only(line: str, counted: Case, left_out: Case) -> None:
    assert scoreboard([counted])[line][1] == 1
    assert scoreboard([left_out])[line] == (0, 0)
    assert scoreboard([counted, left_out, counted])[line][1] == 2


@pytest.mark.parametrize(
    ("line", "hit", "miss"),
    [
        (NOTHING, case("none", 0.0, answer("unknown")), case("none", 0.0, answer("no_gap"))),
        (SINGLE, shrunk(), shrunk(exact=False)),
        (NEAR, case("single", 5.0, exact=False), case("single", 5.0, in_set=False)),
        (PAIR, case("pair", 9.0), case("pair", 9.0, exact=False)),
        (PAIR_NEAR, case("pair", 9.0, exact=False), case("pair", 9.0, in_set=False)),
        (HIDDEN, withheld(withheld=answer("unknown")), withheld(withheld=answer("named"))),
        (MISNAMED, withheld(withheld=answer("named")), withheld(withheld=answer("no_gap"))),
        (
            OUTSIDE,
            case("outside", 12.0, answer("named_with_remainder")),
            case("outside", 12.0, answer("no_gap")),
        ),
        (OUT_MISNAMED, case("outside", 12.0, answer("named")), case("outside", 12.0, answer("ambiguous"))),
        (ORACLE, withheld(oracle_shrink=0.951), withheld(oracle_shrink=1.051)),
        (COVERS, shrunk(true_shrink=0.4), shrunk(true_shrink=0.39)),
        (COVERS, shrunk(true_shrink=0.6), shrunk(true_shrink=0.61)),
        ("confident wrong names", case("none", 0.0, answer("named")), shrunk(answer("named"))),
        ("after above nominal", shrunk(answer(after=2.001)), shrunk(answer(after=2.0))),
    ],
)
def test_a_hit_and_a_miss(line: str, hit: Case, miss: Case) -> None:
    assert scoreboard([hit])[line] == (1, 1)
    assert scoreboard([miss])[line] == (0, 1)


def trial() -> Trial:
    sizes = (2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 40.0)
    cases = [case("single", size, exact=size > 5.0) for size in sizes]
    return Trial(7, "5" * 64, "a" * 64, (*cases, case("none", math.nan, answer("no_gap"))))


def test_lines_for_a_terminal_leave_out_what_was_not_drawn() -> None:
    lines = trial().lines()
    assert lines[:3] == ["8 sealed cases, seed 7", f"labels sealed  {'5' * 64}", f"answers hashed {'a' * 64}"]
    assert "  single, d_sep >= 9: exact: 3/3 = 100.0 % (95 % 43.8 .. 100.0)" in lines
    assert "  no effect: named or unknown: 0/1 = 0.0 % (95 % 0.0 .. 79.3)" in lines
    assert not any("pair" in line for line in lines)
    assert lines[-2:] == [
        "  seconds per case: median 1.00, 95 % below 1.00",
        "  CPU seconds per case: median 0.80, 95 % below 0.80",
    ]


def test_times_are_the_middle_and_the_95_percent_point() -> None:
    cases = tuple(case("single", 9.0, answer(seconds=float(s), cpu_seconds=s / 2)) for s in range(40, 0, -1))
    taken = Trial(1, "", "", cases).seconds()
    assert taken == {"seconds": (21.0, 39.0), "CPU seconds": (10.5, 19.5)}
    assert Trial(1, "", "", ()).seconds() == {}


def test_the_page_groups_by_separation(tmp_path: Path) -> None:
    bands = [(name, count, share) for name, count, share, _ in reliability(trial())]
    assert bands == [
        ("0 to 3", 1, "0 %"),
        ("3 to 5", 1, "0 %"),
        ("5 to 7", 1, "100 %"),
        ("7 to 9", 1, "100 %"),
        ("9 to 12", 1, "100 %"),
        ("12 to 20", 1, "100 %"),
        ("20 and more", 1, "100 %"),
    ]
    assert reliability(replace(trial(), cases=()))[0] == ("0 to 3", 0, "-", "")
    page = tmp_path / "trial.html"
    write_trial_report(trial(), page)
    text = page.read_text()
    assert "8 cases, seed 7" in text and "43.8 to 100.0" in text
    assert "One fault, plain to see: named" in text and "d_" not in text.split("<script")[0].split("<h1>")[1]
    document = trial().to_json()
    assert document["figures"]["single, d_sep >= 9: exact"] == {  # type: ignore[index]
        "hits": 3,
        "of": 3,
        "wilson95": [pytest.approx(0.438, abs=0.001), 1.0],
    }
    assert document["cpu_seconds"] == {"median": 0.8, "p95": 0.8}
