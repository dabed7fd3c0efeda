"""What may be said of a gap: every line of the rules, at its limits."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.answer import verdict
from mavcompass.gap.answer.verdict import (
    Answer,
    consistent,
    decide,
    owning_up,
    with_likely_names,
)
from mavcompass.gap.fit import Fit, Term
from mavcompass.gap.left import Adequacy
from mavcompass.gap.result import Closing, Verdict
from mavcompass.simulation.effects import registry

CLOSED, OPEN = Closing(4.0, 1.2, 1.0, 0.9, (0.8, 0.95)), Closing(4.0, 2.0, 1.0, 0.5, (0.4, 0.6))
SILENT = Closing(1.0, 1.0, 1.0, 0.0, (-0.1, 0.1))

TIME = np.arange(0.0, 100.0, 0.1)


def fit_of(*effects: str, **first: float) -> Fit:
    """Make a fit with these effects, which take 100 squared sigmas off; the named parameters are set."""
    terms, thetas = [], []
    for name in effects:
        effect = registry.get(name)
        free = np.ones(len(effect.parameters), dtype=np.bool_)
        low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
        terms.append(Term(effect, free, low, high))
        nothing = zip(effect.parameters, effect.neutral(), strict=True)
        thetas.append(np.array([first.get(p.name, float(value)) for p, value in nothing]))
    return Fit(tuple(terms), tuple(thetas), (), 0.0 if effects else 100.0)


def floor(measured: bool = True, representative: bool = False) -> Any:
    return SimpleNamespace(measured=measured, representative=representative, field_rms_mgauss=1.0)


def replay(kind: str = "estimator", yaw_unknown: bool = False, step_s: float = 0.1) -> Any:
    reference = SimpleNamespace(kind=kind, yaw_unknown=yaw_unknown)
    return SimpleNamespace(reference=reference, time_s=np.arange(50) * step_s)


NONE = fit_of()


def said(
    answer: Answer, field: Closing = CLOSED, heading: Closing = SILENT, *, over: Any = None, **given: Any
) -> Answer:
    values = {
        "traces": False,
        "turns": True,
        "certain": False,
        "floor": over or floor(),
        "replay": replay(),
        **given,
    }
    return consistent(answer, field, heading, "speed", none=NONE, **values)


def answer(told: Verdict, *effects: str, flagged: bool = False) -> Answer:
    return Answer(told, fit_of(*effects), flagged, "yaw" if flagged else None)


# --- first what is found -------------------------------------------------------------------------------


def identified(*effects: str, weight: float = 1.0, as_good: tuple[frozenset[str], ...] = ()) -> Any:
    fit = fit_of(*effects)
    found = SimpleNamespace(null=NONE, weights=((fit.ids, weight),))
    return SimpleNamespace(fit=fit, found=found, as_good=as_good)


@pytest.fixture(autouse=True)
def steady(monkeypatch: pytest.MonkeyPatch) -> None:
    """An offset that wanders is another test's."""
    monkeypatch.setattr(verdict, "wanders", lambda identified: False)


def decided(
    found: Any, over: Any = None, *, flagged: bool = False, traces: bool = False, **rest: Any
) -> Answer:
    tests: Any = (SimpleNamespace(coordinate="yaw", p=1e-9),)
    adequacy = Adequacy(tests, flagged)
    half = rest.get("half", frozenset())
    return decide(found, over or floor(), rest.get("remainder"), adequacy, traces, half)


def test_nothing_found_is_no_gap_or_unknown() -> None:
    assert decided(identified()) == Answer("no_gap", NONE, False, None)
    # A floor that does not hold in detail flags nothing.
    assert decided(identified(), flagged=True).verdict == "no_gap"
    there = floor(representative=True)
    assert decided(identified(), there, flagged=True) == Answer("unknown", NONE, True, "yaw")
    assert decided(identified(), there).verdict == "no_gap"
    # Scatter, repeats or steps alone are an answer.
    assert decided(identified(), traces=True).verdict == "named"
    assert decided(identified(), there, traces=True, flagged=True).verdict == "named_with_remainder"


@pytest.mark.parametrize(
    ("found", "half", "told"),
    [
        (identified("hard_iron"), (), "named"),
        (identified("hard_iron", weight=0.90), (), "named"),
        (identified("hard_iron", weight=0.899), (), "ambiguous"),
        (identified("hard_iron"), ("hard_iron",), "ambiguous"),
        (identified("hard_iron"), ("soft_iron",), "named"),
        (identified("hard_iron", as_good=(frozenset({"soft_iron"}),)), (), "ambiguous"),
    ],
)
def test_a_name_is_sure_where_nothing_else_is_as_good(found: Any, half: tuple[str, ...], told: str) -> None:
    assert decided(found, half=frozenset(half)).verdict == told


def test_an_offset_that_wanders_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "wanders", lambda identified: True)
    there = floor(representative=True)
    assert decided(identified("hard_iron"), there) == Answer("unknown", NONE, True, "time")
    assert decided(identified("hard_iron"), there, flagged=True).coordinate == "yaw"
    assert decided(identified("hard_iron")).verdict == "named"


@pytest.mark.parametrize(
    ("representative", "left_mgauss", "told"),
    [
        # The floor: 1 mG rms; the gap: 10 mG rms, so 99 mG^2 above it. 5 and 40 % of that may be left.
        (False, (1.0 + 0.39 * 99.0) ** 0.5, True),
        (False, (1.0 + 0.41 * 99.0) ** 0.5, False),
        (True, (1.0 + 0.049 * 99.0) ** 0.5, True),
        (True, (1.0 + 0.051 * 99.0) ** 0.5, False),
    ],
)
def test_a_name_stands_beside_a_remainder_that_is_small(
    representative: bool, left_mgauss: float, told: bool
) -> None:
    rows = np.arange(40) < 30
    signs = np.where(np.arange(40) % 2 == 0, 1.0, -1.0)[:, np.newaxis] * np.ones(3)
    measured = np.where(rows[:, np.newaxis], 400.0 + 0.0 * signs, np.nan)

    def predict(fit: Fit, effects: bool = True) -> Any:
        return SimpleNamespace(mag_mgauss=400.0 + signs * (left_mgauss if effects else 10.0))

    problem: Any = SimpleNamespace(
        predict=predict,
        replay=SimpleNamespace(measured=SimpleNamespace(mag_mgauss=measured)),
        usable=rows,
        residual=lambda predicted: (measured - predicted.mag_mgauss)[rows].ravel(),  # sigma 1 mG
    )
    assert verdict._confirmed(problem, fit_of("hard_iron"), floor(representative=representative)) is told
    if representative:
        remainder = SimpleNamespace(problem=problem, fit=fit_of("hard_iron"))
        found = identified("hard_iron")
        seen = decided(found, floor(representative=True), flagged=True, remainder=remainder)
        named = Answer("named_with_remainder", found.fit, True, "yaw")
        assert seen == (named if told else Answer("unknown", NONE, True, "yaw"))


# --- then what its figures allow -------------------------------------------------------------------------


def test_silence_of_a_vehicle_that_neither_turns_nor_tilts_says_nothing() -> None:
    assert said(answer("no_gap"), SILENT, turns=False) == Answer("not_testable", NONE, False, None)
    assert said(answer("no_gap"), SILENT).verdict == "no_gap"
    assert said(answer("named", "hard_iron"), turns=False).verdict == "named"


def test_what_varies_is_a_gap_though_a_constant_would_be_none() -> None:
    assert said(answer("no_gap"), SILENT, turns=False, varies=True) == Answer("unknown", NONE, True, "speed")
    # Of a vehicle that turns the figures speak.
    assert said(answer("no_gap"), SILENT, varies=True).verdict == "no_gap"


@pytest.mark.parametrize(
    ("field", "heading", "little"),
    [
        (CLOSED, SILENT, False),
        (OPEN, SILENT, False),
        (Closing(4.0, 2.8, 1.0, 0.5, (0.4, 0.6)), SILENT, True),  # 8.16 of 15
        (CLOSED, Closing(4.0, 3.9, 1.0, 0.1, (0.0, 0.2)), True),
        (SILENT, SILENT, False),
    ],
)
def test_names_hold_little_where_less_than_six_tenths_of_a_gap_close(
    field: Closing, heading: Closing, little: bool
) -> None:
    assert verdict.hold_little(field, heading) is little


def test_many_names_and_a_remainder_are_unknown_beside_an_exact_floor_too() -> None:
    problem = SimpleNamespace()
    ids = ("hard_iron", "soft_iron", "spatial_dipole")
    remainder = SimpleNamespace(problem=problem, fit=fit_of(*ids))
    seen = decided(identified(*ids), floor(representative=True), flagged=True, remainder=remainder)
    assert seen == Answer("unknown", NONE, True, "yaw")


def test_a_floor_that_holds_in_detail_has_judged_already() -> None:
    first = answer("named", "hard_iron")
    assert said(first, SILENT, over=floor(representative=True)) is first


@pytest.mark.parametrize(
    ("nominal", "measured", "told"),
    [(0.89, True, "no_gap"), (0.91, True, "named"), (0.89, False, "named")],
)
def test_below_a_measured_floor_there_is_no_gap(nominal: float, measured: bool, told: Verdict) -> None:
    there = Closing(nominal, 0.5, 1.0, 0.5, (0.4, 0.6))
    over = floor(measured)
    seen = said(answer("named", "hard_iron"), there, there, over=over)
    assert seen.verdict == told and bool(seen.named.terms) is (told == "named")
    assert said(answer("named", "hard_iron"), there, OPEN, over=over).verdict != "no_gap"
    assert said(answer("named", "hard_iron"), there, there, over=over, traces=True).verdict != "no_gap"


@pytest.mark.parametrize(("nominal", "told"), [(1.31, "unknown"), (1.29, "no_gap")])
def test_what_nobody_knows_must_lie_above_the_floor(nominal: float, told: Verdict) -> None:
    there = Closing(nominal, nominal, 1.0, 0.0, (0.0, 0.0))
    for field, heading in ((there, SILENT), (SILENT, there)):
        seen = said(answer("unknown", flagged=True), field, heading)
        assert (seen.verdict, seen.flagged, seen.coordinate) == (
            ("unknown", True, "yaw") if told == "unknown" else ("no_gap", False, None)
        )


@pytest.mark.parametrize(("taken_off", "told"), [(82.0, "named"), (80.0, "no_gap")])
def test_below_the_floor_a_cause_must_be_certain(taken_off: float, told: Verdict) -> None:
    below = Closing(1.2, 1.0, 1.0, 0.3, (0.1, 0.5))
    named = answer("named", "hard_iron")
    named = replace(named, named=replace(named.named, sse=NONE.sse - taken_off))
    assert said(named, below).verdict == told


def test_below_the_floor_only_what_surely_shrinks_is_a_cause() -> None:
    # Between 0.9 and 1.3 floors: neither quiet nor a gap.
    hardly, surely = (Closing(1.2, 1.0, 1.0, 0.3, (low, 0.5)) for low in (0.0, 0.01))
    seen = said(answer("named", "hard_iron"), hardly)
    assert seen.verdict == "no_gap" and not seen.named.terms
    seen = said(answer("named", "hard_iron"), hardly, traces=True)
    assert seen.verdict == "named" and not seen.named.terms
    for field, heading in ((surely, SILENT), (SILENT, surely)):
        seen = said(answer("named", "hard_iron"), field, heading)
        assert seen.verdict == "named" and seen.named.terms


@pytest.mark.parametrize("nominal", [1.2, 0.6])
def test_what_is_certain_is_named_below_the_floor(nominal: float) -> None:
    hardly = Closing(nominal, 0.5, 1.0, 0.3, (-0.1, 0.5))
    assert said(answer("named", "clipping"), hardly, hardly).verdict == "no_gap"
    seen = said(answer("named", "clipping"), hardly, hardly, certain=True)
    assert seen.verdict == "named" and seen.named.terms


@pytest.mark.parametrize("told", ["named", "ambiguous"])
def test_beside_a_faulty_sensor_of_the_attitude_nothing_is_named_below_the_floor(told: Verdict) -> None:
    surely, fault = Closing(1.2, 0.5, 1.0, 0.9, (0.1, 0.9)), {"traces": True, "certain": True}
    assert said(answer(told, "hard_iron_step"), surely, **fault).named.terms
    seen = said(answer(told, "hard_iron_step"), surely, **fault, level_known=False)
    assert seen == Answer("named", NONE, False, None)
    above = said(answer(told, "hard_iron_step"), CLOSED, **fault, level_known=False)
    assert above.named.terms


def test_without_a_name_what_is_left_is_unknown() -> None:
    empty = answer("no_gap")
    assert said(empty, CLOSED) is empty
    for field, heading in ((OPEN, SILENT), (SILENT, OPEN)):
        assert said(empty, field, heading) == Answer("unknown", NONE, True, "speed")
    seen = said(answer("named"), OPEN, traces=True)
    assert seen.verdict == "named_with_remainder" and seen.flagged and seen.coordinate == "speed"


@pytest.mark.parametrize(
    ("effects", "after", "told"),
    [
        # 15 mG^2 above the floor: 60 % of it, 9, must be explained.
        (("hard_iron",), (16.0 - 9.1) ** 0.5, "named_with_remainder"),
        (("hard_iron",), (16.0 - 8.9) ** 0.5, "unknown"),
        (("hard_iron", "soft_iron"), (16.0 - 9.1) ** 0.5, "named_with_remainder"),
        (("hard_iron", "soft_iron", "declination"), (16.0 - 9.1) ** 0.5, "unknown"),
    ],
)
def test_beside_a_remainder_few_names_must_explain_most(
    effects: tuple[str, ...], after: float, told: Verdict
) -> None:
    left = Closing(4.0, after, 1.0, 0.5, (0.4, 0.6))
    for field, heading in ((left, SILENT), (SILENT, left), (left, CLOSED)):
        seen = said(answer("named", *effects), field, heading)
        assert (seen.verdict, seen.flagged, seen.coordinate) == (told, True, "speed")
        assert bool(seen.named.terms) is (told != "unknown")
        told_beside = said(answer("named", *effects), field, heading, traces=True)
        assert told_beside.verdict == "named_with_remainder", "what single readings tell stays told"
    # The worse of the two counts.
    assert said(answer("named", *effects), left, Closing(4.0, 3.5, 1.0, 0.1, (0.0, 0.2))).verdict == "unknown"


@pytest.mark.parametrize(
    ("effects", "given", "told"),
    [
        (("hard_iron",), {}, "named"),
        (("hard_iron", "soft_iron"), {}, "named"),
        (("hard_iron", "soft_iron", "declination"), {}, "ambiguous"),  # many
        (("spatial_dipole",), {}, "named"),
        (("spatial_dipole", "hard_iron"), {}, "ambiguous"),  # bends to anything, beside another
        (("spatial_dipole",), {"over": floor(measured=False)}, "ambiguous"),  # or without a baseline
        (("spatial_dipole",), {"over": floor(False), "replay": replay("columns")}, "named"),
        (("hard_iron",), {"over": floor(measured=False)}, "named"),
        (("hard_iron",), {"over": floor(measured=False), "traces": True}, "ambiguous"),
        (("hard_iron",), {"traces": True}, "named"),
        # A turn of the mounting where nothing fixes the yaw.
        (("misalignment",), {"over": floor(False), "replay": replay(yaw_unknown=True)}, "ambiguous"),
        (("misalignment",), {"over": floor(False)}, "named"),
        (("misalignment",), {"replay": replay(yaw_unknown=True)}, "named"),
        (("hard_iron",), {"over": floor(False), "replay": replay(yaw_unknown=True)}, "named"),
    ],
)
def test_names_that_reach_the_floor_may_be_one_explanation_of_several(
    effects: tuple[str, ...], given: dict[str, Any], told: Verdict
) -> None:
    seen = said(answer("named", *effects), **given)
    assert seen.verdict == told and len(seen.named.terms) == len(effects)
    assert said(answer("ambiguous", *effects), **given).verdict == "ambiguous"


@pytest.mark.parametrize(("after", "told"), [(1.20, "named"), (1.25, "ambiguous")])
def test_a_name_that_comes_to_the_floor_must_hold_most_of_a_small_gap(after: float, told: Verdict) -> None:
    # 1.25 mG^2 above the floor: 60 % of it is 0.75, and 1.5 is the square of 1.22.
    small = Closing(1.5, after, 1.0, 0.5, (0.4, 0.6))
    for field, heading in ((small, SILENT), (SILENT, small), (small, CLOSED)):
        assert said(answer("named", "hard_iron"), field, heading).verdict == told


def test_what_passes_has_more_than_a_place_or_a_moment_to_bend_by() -> None:
    def told(effect: str, **when_s: float) -> Verdict:
        return said(Answer("named", fit_of(effect, **when_s), False, None)).verdict

    assert told("spatial_dipole", on_s=5.0) == told("spatial_dipole", off_s=5.0) == "ambiguous"
    assert told("hard_iron_step", on_s=5.0) == "named"
    assert told("hard_iron_step", on_s=5.0, off_s=9.0) == "ambiguous"


@pytest.mark.parametrize(("hz", "told"), [(4.2, "named"), (4.3, "ambiguous")])
def test_a_line_at_half_the_sampling_rate_may_be_a_sensor_that_alternates(hz: float, told: Verdict) -> None:
    # Ten readings a second: 0.85 of 5 Hz is 4.25 Hz.
    line = fit_of("ac_interference")
    line.thetas[0][6] = hz
    assert registry.get("ac_interference").parameters[6].unit == "Hz"
    assert said(Answer("named", line, False, None)).verdict == told


# --- beside what healthy vehicles do not leave -----------------------------------------------------------


def beside(
    told: Verdict = "no_gap",
    names: tuple[str, ...] = (),
    strain: float = 0.0,
    chance: float = 1.0,
    left: tuple[float, float] = (1.0, 1.0),
    nominal: float = 2.0,
    tests: tuple[tuple[str, float], ...] = (),
    decided: tuple[str, ...] = (),
    decided_left: float = 1.0,
    rest_at_floor: bool = False,
    sweeps: bool = False,
    unexplained: str = "",
    gained: float = 100.0,
) -> Answer:
    """Ask what becomes of an answer: `left` of rows that were fitted, and of others, mean squares.

    `chance` is how seldom the known is off by so much; the names that were decided first leave
    `decided_left`.
    """

    def rows(mean_square: float, **more: Any) -> Any:
        def residual(fit: Fit) -> Any:
            return np.full(8, math.sqrt(decided_left if decided and fit.terms else mean_square))

        return SimpleNamespace(residual=residual, predict=lambda fit: fit, **more)

    held = rows(left[1])
    bent: Any = {"strain": lambda _: strain, "chance_of_strain": lambda _: chance}
    problem = rows(left[0], null=lambda: replace(fit_of(), sse=gained), with_rows=lambda _: held, **bent)
    found = SimpleNamespace(problem=problem, split=SimpleNamespace(test=None))
    made = [SimpleNamespace(name=name, excess=excess, coordinate=f"at {name}") for name, excess in tests]
    adequacy: Any = SimpleNamespace(tests=made, where="somewhere", sweeps=sweeps)
    field: Any = SimpleNamespace(nominal=nominal, floor=1.0)
    own, first = answer(told, *names), answer("named", *decided)
    return owning_up(own, first, found, field, adequacy, rest_at_floor, unexplained)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"left": (1.6, 1.6)}, "unknown"),
        ({"left": (1.4, 9.0)}, "no_gap"),  # of those held out an attitude may err by more
        ({"left": (1.9, 1.4)}, "no_gap"),
        ({"left": (2.1, 1.0)}, "unknown"),
        ({"left": (1.6, 1.6), "nominal": 0.9}, "unknown"),  # the floor holds another flight's attitude
        ({"chance": 0.9e-5}, "unknown"),  # the known gives way by more than it may be off by
        ({"chance": 1.1e-5}, "no_gap"),
        ({"left": (1.41, 1.41)}, "unknown"),
        ({"left": (1.39, 1.39)}, "no_gap"),
    ],
)
def test_silence_is_given_up_beside_what_is_loud_or_bent(given: dict[str, Any], told: Verdict) -> None:
    said = beside(**given)
    assert (said.verdict, said.flagged) == (told, told == "unknown")
    assert said.coordinate == ("somewhere" if told == "unknown" else None)


@pytest.mark.parametrize(("decided_left", "told"), [(2.9, "ambiguous"), (3.1, "unknown")])
def test_a_name_that_only_spares_the_known_is_not_the_only_one(decided_left: float, told: Verdict) -> None:
    said = beside(chance=1e-9, decided=("axis_scale",), decided_left=decided_left)
    assert said.verdict == told and said.named.ids == ({"axis_scale"} if told == "ambiguous" else set())


def test_silence_is_given_up_beside_structure_along_a_coordinate() -> None:
    along, anything = (("mag: rate", 12.1),), (("mag: time", 20.1),)
    for tests, where in ((along, "at mag: rate"), (anything, "at mag: time")):
        said = beside(tests=tests)
        assert (said.verdict, said.coordinate) == ("unknown", where) and not said.named.terms
        assert beside(tests=tests, left=(1.0, 1.1)).verdict == "no_gap"


def test_silence_is_given_up_beside_a_line_that_sweeps() -> None:
    said = beside(sweeps=True)
    assert (said.verdict, said.flagged, said.coordinate) == ("unknown", True, "frequency")
    assert beside("named", ("hard_iron",), sweeps=True).verdict == "named"
    # Nor is there one of readings that scatter less than their noise.
    assert beside(sweeps=True, left=(0.7, 0.7)).verdict == "no_gap"
    assert beside(sweeps=True, left=(0.7, 0.9)).verdict == "unknown"


@pytest.mark.parametrize(("decided_left", "told"), [(2.9, "named"), (3.1, "unknown")])
def test_what_is_loud_without_its_name_keeps_it(decided_left: float, told: Verdict) -> None:
    magnet = {"decided": ("spatial_dipole",), "decided_left": decided_left, "nominal": 0.9}
    said = beside(left=(9.0, 9.0), **magnet)  # type: ignore[arg-type]
    assert said.verdict == told and said.flagged is (told == "unknown")
    assert said.named.ids == ({"spatial_dipole"} if told == "named" else set())
    assert beside(left=(1.0, 9.0), **magnet).verdict == "no_gap"  # type: ignore[arg-type]
    # One that leaves more than half of what is louder than noise explains it no better than nothing does.
    assert beside(left=(2.0, 2.0), decided=("clipping",), decided_left=1.49, nominal=0.9).verdict == "named"
    assert beside(left=(2.0, 2.0), decided=("clipping",), decided_left=1.51, nominal=0.9).verdict == "unknown"


@pytest.mark.parametrize(
    ("given", "told", "where"),
    [
        ({"strain": 59.0}, "named", None),
        ({"strain": 61.0}, "ambiguous", None),
        ({"tests": (("mag: rate", 12.1),)}, "named_with_remainder", "at mag: rate"),
        ({"tests": (("mag: rate", 11.9),)}, "named", None),
        ({"tests": (("mag: time", 20.1),)}, "named_with_remainder", "at mag: time"),
        ({"tests": (("mag: time", 19.9),)}, "named", None),
        # The largest first; noise that is higher everywhere is no structure.
        ({"tests": (("mag: rate", 13.0), ("mag: time", 21.0))}, "named_with_remainder", "at mag: time"),
        ({"tests": (("mag: rate", 20.0),), "left": (1.0, 2.0)}, "named", None),
        ({"tests": (("mag: rate", 20.0),), "left": (2.0, 1.0)}, "named", None),
        ({"tests": (("mag: rate", 12.1),), "left": (0.5, 0.5)}, "named_with_remainder", "at mag: rate"),
        # A floor that grows with the turns may hide what fits badly.
        ({"left": (3.1, 3.1)}, "named_with_remainder", "somewhere"),
        ({"left": (2.9, 9.0)}, "named", None),
    ],
)
def test_beside_a_name_structure_and_bending_are_told(
    given: dict[str, Any], told: Verdict, where: str | None
) -> None:
    said = beside("named", ("hard_iron",), **given)
    assert (said.verdict, said.coordinate, said.flagged) == (told, where, where is not None)
    assert said.named.ids == {"hard_iron"}


def test_what_follows_anything_is_not_the_only_explanation_of_what_the_rest_explains() -> None:
    for names, told in ((("field_gradient",), "ambiguous"), (("hard_iron",), "named")):
        assert beside("named", names, nominal=1.29).verdict == told
        assert beside("named", names, nominal=1.31, rest_at_floor=True).verdict == told
        assert beside("named", names, nominal=1.31).verdict == "named"


@pytest.mark.parametrize(
    ("given", "silent"),
    [
        ({"gained": 80.0}, True),
        ({"gained": 82.0}, False),
        ({"gained": 80.0, "left": (1.5, 1.5)}, False),
        ({"gained": 80.0, "left": (1.3, 1.3)}, True),
        # Beside a baseline that scatters twice as much.
        ({"gained": 26.0, "left": (0.3, 0.5)}, False),
        ({"gained": 24.0, "left": (0.3, 0.5)}, True),
        ({"gained": 80.0, "chance": 1e-6}, False),
    ],
)
def test_what_gains_little_where_silence_leaves_nothing_is_no_name(
    given: dict[str, Any], silent: bool
) -> None:
    for told in ("named", "ambiguous"):
        said = beside(told, ("hard_iron",), **given)
        assert (said.verdict == "no_gap") is silent and bool(said.named.terms) is not silent
        assert beside(told, ("transport_lag",), **given).verdict != "no_gap"


def test_who_is_not_sure_already_stays_so() -> None:
    for told in ("ambiguous", "unknown", "named_with_remainder", "not_testable"):
        said = beside(told, ("hard_iron",), strain=1e3, left=(9.0, 9.0), tests=(("mag: rate", 99.0),))  # type: ignore[arg-type]
        assert said.verdict == told


@pytest.mark.parametrize(
    ("sets", "traces", "told"),
    [
        ({"hard_iron": 1.0}, False, "named_with_remainder"),
        ({"hard_iron": 0.6, "hard_iron+soft_iron": 0.35, "soft_iron": 0.05}, False, "named_with_remainder"),
        ({"hard_iron": 0.45, "hard_iron+soft_iron": 0.36, "soft_iron": 0.19}, False, "named_with_remainder"),
        ({"hard_iron": 0.45, "hard_iron+soft_iron": 0.34, "soft_iron": 0.21}, False, "unknown"),
        ({"hard_iron": 0.5, "soft_iron": 0.5}, True, "named_with_remainder"),
    ],
)
def test_beside_a_remainder_a_name_that_may_be_another_one_is_none(
    sets: dict[str, float], traces: bool, told: Verdict
) -> None:
    weights = [(frozenset(ids.split("+")), weight) for ids, weight in sets.items()]
    given = answer("named_with_remainder", "hard_iron", flagged=True)
    after = with_likely_names(given, weights, floor(), NONE, traces)
    assert (after.verdict, after.flagged, after.coordinate) == (told, True, "yaw")
    assert bool(after.named.terms) is (told == "named_with_remainder" and not traces)
    assert with_likely_names(given, weights, floor(representative=True), NONE, traces) is given
    other = answer("ambiguous", "hard_iron")
    assert with_likely_names(other, weights, floor(), NONE, traces) is other


@pytest.mark.parametrize("coordinate", ["time", "frequency"])
def test_what_single_readings_show_and_no_name_is_for_is_no_silence(coordinate: str) -> None:
    said = beside(unexplained=coordinate)
    assert (said.verdict, said.flagged, said.coordinate) == ("unknown", True, coordinate)
    assert beside().verdict == "no_gap"
