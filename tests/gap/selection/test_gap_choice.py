"""Which of several sets that explain a gap is named, and what else it may be: on sets without any data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit import Fit, Term
from mavcompass.gap.selection import identification, rivals
from mavcompass.gap.selection.guards import TOO_SMALL
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.split import probe, split_blocks
from mavcompass.simulation.effects import registry


def fit_of(*names: str, sse: float = 100.0) -> Fit:
    terms = []
    for name in names:
        effect = registry.get(name)
        low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
        terms.append(Term(effect, np.ones(low.size, dtype=np.bool_), low, high))
    return Fit(tuple(terms), tuple(np.zeros(t.lower.size) for t in terms), (), sse)


@dataclass
class Problem:
    """Know how far each set bends what is known of the vehicle."""

    strained: dict[frozenset[str], float]

    def refit(self, fit: Fit) -> Fit:
        return fit

    def strain(self, fit: Fit) -> float:
        return self.strained.get(fit.ids, 0.0)

    def null(self) -> Fit:
        return NOTHING


def candidate(
    chosen: Fit, *explored: Fit, strained: dict[frozenset[str], float] | None = None, **more: Any
) -> Identified:
    def without(fit: Fit, name: str) -> Fit:
        return fit.without([t.effect.id for t in fit.terms].index(name))

    search = SimpleNamespace(
        explored={f.ids: f for f in explored},
        criteria=SimpleNamespace(
            exact=True,
            score=lambda f: f.sse + 10.0 * len(f.terms),
            grows=lambda smaller, larger: smaller.sse - larger.sse > 30.0,
        ),
        without=without,
        terms=(),
    )
    values: dict[str, Any] = {
        "problem": Problem(strained or {}),
        "split": None,
        "found": None,
        "fit": chosen,
        "dropped": (),
        "search": search,
        "first": None,
        **more,
    }
    return Identified(**values)


MEASURED: Any = SimpleNamespace(measured=True, representative=False)
NOTHING = Fit((), (), (), 400.0)
IRON, SOFT, BOTH = fit_of("hard_iron"), fit_of("soft_iron"), fit_of("hard_iron", "soft_iron", sse=50.0)


@pytest.fixture
def good(monkeypatch: pytest.MonkeyPatch) -> set[frozenset[str]]:
    """The sets that reach the floor; no alias, and no guard that refuses."""
    reach: set[frozenset[str]] = set()
    monkeypatch.setattr(rivals, "at_floor", lambda candidate, fit, floor: fit.ids in reach)
    monkeypatch.setattr(rivals, "_substitutes", lambda candidate: [])
    monkeypatch.setattr(rivals, "refused", lambda candidate, floor: None)
    monkeypatch.setattr(rivals, "_no_worse", lambda candidate, rivals: [])
    return reach


def test_of_the_sets_that_reach_the_floor_the_smallest_is_named(good: set[frozenset[str]]) -> None:
    good |= {BOTH.ids, IRON.ids}
    named = rivals.simplest(candidate(BOTH, IRON, SOFT, BOTH), MEASURED)
    assert named.fit is IRON and named.as_good == (BOTH.ids,)
    good.add(SOFT.ids)
    named = rivals.simplest(candidate(BOTH, IRON, SOFT, BOTH), MEASURED)
    fewest = min((IRON, SOFT), key=lambda f: (f.dimension, f.sse))
    assert named.fit is fewest and set(named.as_good) == {BOTH.ids, IRON.ids, SOFT.ids} - {fewest.ids}


@pytest.mark.parametrize(("more", "kept"), [("spatial_dipole", True), ("soft_iron", False)])
def test_what_is_certain_is_named_though_fewer_reach_the_floor(
    more: str, kept: bool, good: set[frozenset[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another iron, by which a calibration may be off, the simplest is taken all the same."""
    both = fit_of("hard_iron", more, sse=50.0)
    good |= {both.ids, IRON.ids}
    monkeypatch.setattr(rivals, "evident", lambda here, rest: here.fit is both and rest is IRON)
    named = rivals.simplest(candidate(both, IRON), MEASURED)
    assert named.fit is (both if kept else IRON)
    assert named.as_good == ((IRON if kept else both).ids,)


def test_what_does_not_reach_the_floor_is_no_rival(good: set[frozenset[str]]) -> None:
    good.add(BOTH.ids)
    named = rivals.simplest(candidate(BOTH, IRON, SOFT), MEASURED)
    assert named.fit is BOTH and named.as_good == ()
    good.clear()
    assert rivals.simplest(candidate(BOTH, IRON, SOFT), MEASURED).fit is BOTH


def test_where_the_chosen_does_not_reach_it_the_best_that_does_is_taken(good: set[frozenset[str]]) -> None:
    good |= {IRON.ids, SOFT.ids}
    better = replace(SOFT, sse=70.0)
    named = rivals.simplest(candidate(BOTH, IRON, better), MEASURED)
    assert named.fit.dimension == min(IRON.dimension, better.dimension)
    assert BOTH.ids in named.as_good and named.fit.ids not in named.as_good, "the search preferred it"


def test_where_guards_left_nothing_one_effect_may_do_what_several_did(
    good: set[frozenset[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the vehicle's own freedom reaches by bending counts as nothing reached."""
    nothing = NOTHING
    good |= {nothing.ids, IRON.ids, SOFT.ids, BOTH.ids}
    monkeypatch.setattr(
        rivals, "refused", lambda c, floor: ("soft_iron", "no") if "soft_iron" in c.fit.ids else None
    )
    named = rivals.simplest(candidate(nothing, IRON, SOFT, BOTH), MEASURED)
    assert named.fit is IRON and named.as_good == ()
    hardly = replace(IRON, sse=375.0)
    assert rivals.simplest(candidate(nothing, hardly), MEASURED).fit is nothing, "nothing does as well"
    good.remove(IRON.ids)
    assert rivals.simplest(candidate(nothing, IRON, SOFT, BOTH), MEASURED).fit is nothing


def test_what_the_search_finds_far_likelier_is_an_alternative() -> None:
    far, near = replace(BOTH, sse=40.0), replace(SOFT, sse=70.0)
    here = candidate(IRON, IRON, near, far)
    assert rivals.likelier(here) == (far.ids,)
    assert rivals.likelier(replace(here, dropped=(("soft_iron", TOO_SMALL),))) == ()
    assert rivals.likelier(replace(here, as_good=(far.ids,))) == ()
    assert rivals.likelier(candidate(NOTHING, near, far)) == ()


def test_where_none_reaches_it_what_leaves_no_more_is_a_rival(
    good: set[frozenset[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        rivals, "_no_worse", lambda candidate, rivals: [f for f in rivals if f.ids == SOFT.ids]
    )
    named = rivals.simplest(candidate(BOTH, IRON, SOFT), MEASURED)
    assert named.fit is BOTH and named.as_good == (SOFT.ids,)


def test_what_a_guard_refuses_is_not_taken(
    good: set[frozenset[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    good |= {IRON.ids, SOFT.ids}
    monkeypatch.setattr(
        rivals, "refused", lambda c, floor: ("soft_iron", "no") if c.fit.ids == SOFT.ids else None
    )
    assert rivals.simplest(candidate(BOTH, replace(IRON, sse=450.0), SOFT), MEASURED).fit.ids == IRON.ids
    monkeypatch.setattr(rivals, "refused", lambda c, floor: ("x", "no"))
    assert rivals.simplest(candidate(BOTH, IRON, SOFT), MEASURED).fit is BOTH


@pytest.mark.parametrize(("strain", "is_rival"), [(29.0, True), (31.0, False)])
def test_what_bends_the_vehicle_by_force_is_no_rival(
    strain: float, is_rival: bool, good: set[frozenset[str]]
) -> None:
    good |= {BOTH.ids, IRON.ids}
    here = candidate(BOTH, IRON, strained={IRON.ids: strain + 5.0, BOTH.ids: 5.0})
    assert (rivals.simplest(here, MEASURED).fit is IRON) is is_rival


def test_four_rivals_are_looked_at(good: set[frozenset[str]]) -> None:
    names = ("hard_iron", "soft_iron", "declination", "transport_lag", "misalignment")
    sets = [fit_of(name, sse=10.0 * k) for k, name in enumerate(names)]
    good |= {f.ids for f in sets} | {BOTH.ids}
    named = rivals.simplest(candidate(BOTH, *sets), MEASURED)
    assert {*named.as_good, named.fit.ids} == {f.ids for f in sets[:4]} | {BOTH.ids}


def test_an_alias_that_was_not_searched_is_a_rival_and_no_name(
    good: set[frozenset[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rivals, "_substitutes", lambda candidate: [IRON])
    good |= {BOTH.ids, IRON.ids}
    named = rivals.simplest(candidate(BOTH), MEASURED)
    assert named.fit is BOTH and named.as_good == (IRON.ids,)


def test_what_a_guard_refuses_is_taken_out_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fit_of("hard_iron", "soft_iron", "declination")
    reasons = {"declination": "it is torn", "soft_iron": TOO_SMALL}

    def refuse(here: Any, floor: Any) -> tuple[str, str] | None:
        return next(((n, why) for n, why in reasons.items() if n in here.fit.ids), None)

    monkeypatch.setattr(identification, "refused", refuse)
    for certain in (True, False):
        monkeypatch.setattr(identification, "evident", lambda here, rest, *least, c=certain: c)
        left = identification._allowed(candidate(whole), MEASURED)
        assert left.fit.ids == {"hard_iron"} and left.dropped == (
            ("declination", "it is torn"),
            ("soft_iron", TOO_SMALL),
        )
        # What is certain and too small to be named is remembered; what is torn is not.
        assert left.evident == (frozenset({"soft_iron"}) if certain else frozenset())
    exact: Any = SimpleNamespace(measured=True, representative=True)
    monkeypatch.setattr(identification, "evident", lambda here, rest, *least: True)
    assert identification._allowed(candidate(whole), exact).evident == frozenset()


def test_what_is_certain_beside_a_name_makes_other_sets() -> None:
    here = candidate(IRON, evident=frozenset({"soft_iron", "declination", "hard_iron"}))
    assert {frozenset(s) for s in rivals.with_evident(here)} == {
        frozenset({"hard_iron", "soft_iron"}), frozenset({"hard_iron", "declination"}),
        frozenset({"hard_iron", "soft_iron", "declination"}),
    }  # fmt: skip
    assert rivals.with_evident(candidate(fit_of(), evident=frozenset({"soft_iron"}))) == []


def tried(*names: str) -> Any:
    return SimpleNamespace(terms=fit_of(*names).terms)


@pytest.mark.parametrize(
    ("chosen", "searched", "other"),
    [
        (("transport_lag",), ("transport_lag",), [{"low_pass"}]),
        (("transport_lag",), ("transport_lag", "low_pass"), []),
        (("height_anomaly", "hard_iron"), ("spatial_dipole",), [{"spatial_dipole", "hard_iron"}]),
        (("height_anomaly",), (), []),
        (("hard_iron",), ("spatial_dipole",), []),
    ],
)
def test_what_no_recording_tells_from_the_chosen_is_said(
    chosen: tuple[str, ...], searched: tuple[str, ...], other: list[set[str]]
) -> None:
    here = candidate(fit_of(*chosen))
    here = replace(here, search=tried(*searched))
    assert [set(s) for s in rivals.alike(here)] == other


@pytest.mark.parametrize(
    ("field", "heading", "scatter", "hopeless"),
    [
        ((9.0, 8.5), (2.0, 1.0), 1.0, True),  # the field is hardly explained
        ((9.0, 4.0), (2.0, 1.9), 1.0, True),  # the heading is hardly explained
        ((9.0, 7.0), (2.0, 1.5), 1.0, False),
        ((9.0, 4.0), (0.9, 0.9), 1.0, False),  # a heading near its floor needs no explanation
        ((3.9, 3.8), (0.9, 0.9), 1.0, False),
        ((9.0, 7.7), (0.9, 0.9), 1.0, True),
        ((9.0, 7.7), (0.9, 0.9), 4.0, False),  # of what is no scatter a good part
        ((9.0, 8.9), (0.9, 0.9), 5.0, False),  # nearly all is scatter
    ],
)
def test_guards_are_spared_where_the_best_set_explains_little(
    field: tuple[float, float],
    heading: tuple[float, float],
    scatter: float,
    hopeless: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nothing = Fit((), (), (), 400.0)
    left = {nothing.ids: (field[0], heading[0]), IRON.ids: (field[1], heading[1])}
    rows = np.ones(4, dtype=np.bool_)
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(
            measured=SimpleNamespace(mag_mgauss=None),
            signals=SimpleNamespace(
                stimulus=SimpleNamespace(field_ned_mgauss=np.array([[180.0, 240.0, 400.0]]))
            ),
        ),
        sigma_mgauss=np.full(3, scatter),
        usable=rows,
        predict=lambda fit: SimpleNamespace(mag_mgauss=fit.ids),
    )
    monkeypatch.setattr(identification, "apart", lambda replay, measured, predicted, rows: left[predicted])
    floor: Any = SimpleNamespace(
        measured=True, representative=False, field_rms_mgauss=2.0, heading_rms_deg=0.5
    )
    tried = candidate(
        nothing,
        problem=problem,
        split=SimpleNamespace(train=rows, test=rows),
        found=SimpleNamespace(null=nothing),
    )
    assert identification._hopeless(tried, floor, IRON) == hopeless
    assert not identification._hopeless(tried, floor, nothing), "there is nothing to guard"
    floor.measured = False
    assert not identification._hopeless(tried, floor, IRON), "a floor that is a guess refuses nothing"


@dataclass
class Rows:
    """Be a replay of nothing but its rows."""

    time_s: Any
    valid: Any
    notes: tuple[str, ...] = ()


def seconds(length_s: float = 100.0) -> Rows:
    time_s = np.arange(0.0, length_s, 0.05)
    return Rows(time_s, np.ones(time_s.size, dtype=np.bool_))


@dataclass
class Fitted(Problem):
    """Know which rows it fits."""

    replay: Rows
    train: Any
    count: int = 100
    noise = prior = None

    def with_rows(self, train: Any) -> Fitted:
        return replace(self, train=train)


def step_at(moment_s: float) -> Fit:
    step = fit_of("hard_iron_step")
    names = [p.name for p in step.terms[0].effect.parameters]
    theta = np.where(np.array(names) == "on_s", moment_s, 0.0)
    theta[names.index("off_s")] = 1e7
    return replace(step, thetas=(theta,))


def test_a_change_inside_a_held_out_block_comes_between_training_rows() -> None:
    rows = seconds()
    split = split_blocks(rows.time_s, rows.valid)
    inside, beside = (
        float(np.median(rows.time_s[split.block == split.block[rows_in][0]]))
        for rows_in in (split.test, split.train)
    )
    search = SimpleNamespace(explored={}, polished=lambda fit, moments: fit)
    search.on = lambda problem: search
    problem = Fitted({}, rows, split.train)

    here = candidate(step_at(inside), problem=problem, split=split, search=search)
    assert probe(split, rows.time_s, inside) is not None
    closer: Any = identification._moments_in_training(here)
    assert probe(closer.split, rows.time_s, inside) is None
    assert closer.problem.train is closer.split.train and closer.search.explored == {here.fit.ids: here.fit}
    assert 0.8 * split.test.sum() < closer.split.test.sum() < split.test.sum()

    assert probe(split, rows.time_s, beside) is None
    there = candidate(step_at(beside), problem=problem, split=split, search=search)
    assert identification._moments_in_training(there) is there


@pytest.mark.parametrize(
    ("changes_still", "left", "noise_known", "taken"),
    [
        (True, 90.0, True, True),
        (True, 110.0, True, False),
        (True, 110.0, False, True),
        (False, 90.0, True, False),
    ],
)
def test_rows_while_something_changes_are_set_aside_where_that_explains_the_rest(
    changes_still: bool, left: float, noise_known: bool, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = seconds(20.0)
    rows.valid[30] = False
    split, while_it_changes = split_blocks(rows.time_s, rows.valid), np.abs(rows.time_s - 10.0) < 0.5
    seen: list[tuple[Any, Any]] = []
    first = candidate(step_at(10.0), problem=Fitted({}, rows, split.train), split=split)
    again = replace(first, fit=replace(step_at(10.1), sse=left))

    def searched(replay: Any, floor: Any, split: Any, *more: Any) -> tuple[Identified, Any]:
        seen.append((replay, split))
        return (first, again)[len(seen) - 1], floor

    monkeypatch.setattr(identification, "_searched", searched)
    monkeypatch.setattr(
        identification, "moments", lambda fit: [10.0] if fit is first.fit or changes_still else []
    )
    monkeypatch.setattr(identification, "transients", lambda problem, fit, when: while_it_changes)
    monkeypatch.setattr(identification, "switched", lambda problem, fit: np.zeros_like(while_it_changes))
    monkeypatch.setattr(identification, "near_places", lambda problem, fit: np.zeros_like(while_it_changes))
    monkeypatch.setattr(identification, "told", lambda *of: ("something changes",))
    monkeypatch.setattr(identification, "with_moments", lambda problem, fit, when: fit)
    monkeypatch.setattr(identification, "widened", lambda floor, problem, fit: floor)
    monkeypatch.setattr(identification, "Problem", lambda *of: Fitted({}, rows, split.train))
    floor: Any = SimpleNamespace(measured=noise_known, prior=None)
    found, _ = identification.identify(rows, floor, split, (), noise_known)  # type: ignore[arg-type]
    assert found.fit is (again if taken else first).fit
    (_, _), (calm, parts) = seen
    np.testing.assert_array_equal(calm.valid, rows.valid & ~while_it_changes)
    np.testing.assert_array_equal(parts.train, split.train & ~while_it_changes)
    np.testing.assert_array_equal(parts.test, split.test & ~while_it_changes)
    assert calm.notes == ("something changes",)


@pytest.mark.parametrize(
    ("named", "after", "refuses", "left"),
    [
        # Of three the least is given up, where the two hold nearly all: 1 - 2^2 / 10^2 and more.
        (("hard_iron", "soft_iron", "spatial_dipole"), 2.0, False, {"hard_iron", "spatial_dipole"}),
        (
            ("hard_iron", "soft_iron", "spatial_dipole"),
            5.0,
            False,
            {"hard_iron", "soft_iron", "spatial_dipole"},
        ),
        (
            ("hard_iron", "soft_iron", "spatial_dipole"),
            2.0,
            True,
            {"hard_iron", "soft_iron", "spatial_dipole"},
        ),
        (("hard_iron", "soft_iron"), 2.0, False, {"hard_iron", "soft_iron"}),
    ],
)
def test_beside_something_unknown_the_few_that_hold_nearly_all_are_kept(
    named: tuple[str, ...], after: float, refuses: bool, left: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    worth = {"hard_iron": 300.0, "soft_iron": 20.0, "spatial_dipole": 100.0}

    def without(fit: Fit, effect_id: str) -> Fit:
        kept = fit.without([t.effect.id for t in fit.terms].index(effect_id))
        return replace(kept, sse=fit.sse + worth[effect_id])

    monkeypatch.setattr(identification, "at_floor", lambda here, fit, floor, within: False)
    monkeypatch.setattr(identification, "_closed", lambda here, fit, floor: [(10.0, after, 1.0)])
    monkeypatch.setattr(identification, "refused", lambda here, floor: ("x", "y") if refuses else None)
    here = candidate(fit_of(*named), search=SimpleNamespace(without=without))
    assert identification._few_beside_unknown(here, MEASURED).fit.ids == left


def test_what_looks_alike_and_fits_better_is_no_worse_a_name() -> None:
    scores = {"low_pass": 600.0, "transport_lag": 640.0, "hard_iron": 500.0}
    search: Any = SimpleNamespace(criteria=SimpleNamespace(score=lambda fit: scores[next(iter(fit.ids))]))
    lag, low_pass, iron = (fit_of(name) for name in ("transport_lag", "low_pass", "hard_iron"))
    assert rivals._is_better_alias(search, low_pass, lag)
    assert not rivals._is_better_alias(search, lag, low_pass)
    assert not rivals._is_better_alias(search, iron, lag)  # better, and nothing like it
    assert not rivals._is_better_alias(search, fit_of(), lag)


def test_what_a_fit_leaves_is_counted_by_its_rows() -> None:
    for count, each in ((4, 2.5), (1, 10.0), (0, 10.0)):
        found: Any = SimpleNamespace(fit=SimpleNamespace(sse=10.0), problem=SimpleNamespace(count=count))
        assert identification._each(found) == each


@pytest.mark.parametrize(
    ("ids", "tried", "alike"),
    [
        (("transport_lag", "hard_iron"), (), [{"low_pass", "hard_iron"}]),
        (("transport_lag",), ("low_pass",), []),
        (("height_anomaly",), ("spatial_dipole",), [{"spatial_dipole"}]),
        (("height_anomaly",), (), []),
        (("orientation", "hard_iron"), (), [{"orientation"}]),
        (("orientation",), (), []),
        (("hard_iron",), (), []),
    ],
)
def test_sets_that_look_the_same_by_nature(
    ids: tuple[str, ...], tried: tuple[str, ...], alike: list[set[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rivals, "_iron_stayed", lambda candidate: True)
    made = candidate(fit_of(*ids))
    made.search.terms = tuple(SimpleNamespace(effect=SimpleNamespace(id=name)) for name in tried)
    assert [set(other) for other in rivals.alike(made)] == alike
