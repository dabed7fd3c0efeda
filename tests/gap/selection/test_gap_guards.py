"""The guards at their limits, on problems of a few numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Term
from mavcompass.gap.selection import guards, levels, materiality
from mavcompass.gap.selection.split import Split
from mavcompass.simulation.effects import registry

ROWS = 80
BOTH_WAYS = np.where(np.arange(ROWS) % 2 == 0, 1.0, -1.0)
NORTH = np.tile([200.0, 0.0, 400.0], (ROWS, 1))


def fit_of(**sizes: float) -> Fit:
    """Make a fit with these effects; the first parameter of each is set."""
    terms, thetas = [], []
    for name, size in sizes.items():
        effect = registry.get(name)
        low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
        terms.append(Term(effect, np.ones(low.size, dtype=np.bool_), low, high))
        thetas.append(np.array([size, *[0.0] * (low.size - 1)]))
    return Fit(tuple(terms), tuple(thetas), (), 0.0)


@dataclass
class Problem:
    """Predict the first parameters of a fit's effects, mG, on the axis of each, in turn both ways."""

    left: FloatArray  # what no effect explains, (N, 3)
    rows: Any = field(default_factory=lambda: np.ones(ROWS, dtype=np.bool_))
    gap: FloatArray = field(default_factory=lambda: np.zeros(3))  # what is to be explained, by axis
    axes: tuple[str, ...] = ("hard_iron", "soft_iron", "spatial_dipole")
    noise_mgauss: float = 0.5
    scatter_mgauss: float = 0.0
    step_mgauss: float = 0.0
    taken_mgauss: float = 0.0
    bent: float = 0.0
    structured: float = 1.0
    kind: str = "estimator"

    groups = ("mag",)
    nuisances = (SimpleNamespace(known=1),)

    def __post_init__(self) -> None:
        self.noise = {
            "mag": SimpleNamespace(rms=np.full(3, self.noise_mgauss), sigma=np.full(3, self.scatter_mgauss))
        }
        self.usable = np.ones(ROWS, dtype=np.bool_)
        self.index = np.flatnonzero(self.rows)
        stimulus = SimpleNamespace(field_ned_mgauss=NORTH, position_ned_m=np.zeros((ROWS, 3)))
        self.replay = SimpleNamespace(
            measured=SimpleNamespace(mag_mgauss=NORTH + BOTH_WAYS[:, None] * self.gap + self.left),
            reference=SimpleNamespace(kind=self.kind),
            trace=SimpleNamespace(step_mgauss=self.step_mgauss),
            taken_mgauss=self.taken_mgauss,
            signals=SimpleNamespace(stimulus=stimulus),
            doubtful={},
        )

    def predict(self, fit: Fit, effects: bool = True) -> Any:
        out = NORTH.copy()
        for term, theta in zip(fit.terms, fit.thetas, strict=True):
            if effects and term.effect.id in self.axes:
                out[:, self.axes.index(term.effect.id)] += BOTH_WAYS * theta[0]
        return SimpleNamespace(mag_mgauss=out)

    def residual(self, predicted: Any) -> FloatArray:
        return (
            (self.replay.measured.mag_mgauss - predicted.mag_mgauss)[self.rows] / self.noise_mgauss
        ).ravel()

    def with_rows(self, rows: Any) -> Problem:
        return replace(self, rows=rows)

    def fit(self, terms: Any, thetas: Any, nuisances: Any, iterations: int = 1) -> Fit:
        found = Fit(tuple(terms), tuple(thetas), nuisances, 0.0)
        return replace(found, sse=float(np.sum(self.residual(self.predict(found)) ** 2)))

    def refit(self, fit: Fit) -> Fit:
        return self.fit(fit.terms, fit.thetas, fit.nuisance_thetas)

    def steady(self, fit: Fit) -> Problem:
        return self

    def null(self) -> Fit:
        return self.refit(fit_of())

    def strain(self, fit: Fit) -> float:
        return 0.0 if fit.terms else self.bent

    def straight(self, fit: Fit) -> bool:
        return self.strain(fit) < 22.0


def split() -> Split:
    """Eight blocks of ten rows; the third and the seventh are held out."""
    block = np.arange(ROWS) // 10
    held = np.array([False, False, True, False, False, False, True, False])
    return Split(block, held, ~held[block], held[block])


@pytest.fixture(autouse=True)
def plain_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of field and heading without an attitude: of x, y and z, and of y over 200 mG."""

    def heading(replay: Any, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        return (measured - predicted)[:, 1] / 200.0

    def apart(replay: Any, one: FloatArray, other: FloatArray, rows: Any) -> tuple[float, float]:
        off = (one - other)[rows]
        return math.sqrt((off**2).mean()), math.degrees(math.sqrt((off[:, 1] ** 2).mean()) / 200.0)

    monkeypatch.setattr(materiality, "heading_error_rad", heading)
    for module in (levels, materiality):
        monkeypatch.setattr(module, "apart", apart)
    monkeypatch.setattr(levels, "most_structured", lambda problem, fit: problem.structured)


def candidate(problem: Problem, fit: Fit, **changed: Any) -> Any:
    null = fit_of()

    def without(fit: Fit, effect: str) -> Fit:
        return problem.refit(fit.without([term.effect.id for term in fit.terms].index(effect)))

    search = SimpleNamespace(
        criteria=SimpleNamespace(contradiction=lambda rest, fit: changed.pop("contradiction", 0.0)),
        without=without,
    )
    values = {
        "problem": problem,
        "fit": fit,
        "split": split(),
        "search": search,
        "found": SimpleNamespace(null=null),
    }
    return SimpleNamespace(**{**values, **changed})


def floor(
    field_mgauss: float = 1.0, heading_deg: float = 0.3, measured: bool = True, representative: bool = False
) -> Any:
    return SimpleNamespace(
        field_rms_mgauss=field_mgauss,
        heading_rms_deg=heading_deg,
        measured=measured,
        representative=representative,
    )


def explained(gap: tuple[float, float, float], left_mgauss: float = 0.5, **changed: Any) -> Problem:
    quiet = (
        left_mgauss * np.roll(BOTH_WAYS, 1)[:, None] * np.where(np.arange(ROWS) % 4 < 2, 1.0, -1.0)[:, None]
    )
    return Problem(quiet * np.ones(3), gap=np.array(gap), **changed)


# --- nothing is needed ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left_mgauss", "measured", "silent"),
    [(0.89, True, True), (0.91, True, False), (1.24, False, True), (1.26, False, False)],
)
def test_a_gap_at_the_floor_needs_no_effect(left_mgauss: float, measured: bool, silent: bool) -> None:
    here = candidate(explained((0.0, 0.0, 0.0), left_mgauss, noise_mgauss=2.0), fit_of())
    assert levels.needs_none(here, floor(heading_deg=9.0, measured=measured)) is silent
    assert (
        levels.needs_none(here, floor(9.0, math.degrees(1.0 / 200.0), measured)) is silent
    )  # by the heading
    assert not levels.needs_none(here, floor(9.0, 9.0, measured, representative=True))
    stated = candidate(explained((0.0, 0.0, 0.0), left_mgauss, noise_mgauss=2.0, kind="columns"), fit_of())
    assert levels.needs_none(stated, floor(9.0, 9.0, measured)) is measured


@pytest.mark.parametrize(("left_mgauss", "searched"), [(1.11, False), (1.13, True)])
def test_readings_that_know_better_than_their_floor_are_searched(left_mgauss: float, searched: bool) -> None:
    """Their noise is 1 mG: a quarter more than its square is the most that needs nothing."""
    here = candidate(explained((0.0, 0.0, 0.0), left_mgauss, noise_mgauss=1.0), fit_of())
    assert levels.needs_none(here, floor(9.0, 9.0)) is not searched
    assert levels.needs_none(here, floor(9.0, 9.0, measured=False))


@pytest.mark.parametrize("structured", [7.9, 8.1])
def test_what_goes_with_the_motion_is_searched_below_a_measured_floor(structured: float) -> None:
    here = candidate(explained((0.0, 0.0, 0.0), noise_mgauss=2.0, structured=structured), fit_of())
    assert levels.needs_none(here, floor(9.0, 9.0)) is (structured < 8.0)
    assert levels.needs_none(here, floor(9.0, 9.0, measured=False))


@pytest.mark.parametrize("bent", [0.0, 21.0, 23.0])
def test_what_is_known_is_searched_where_it_was_bent_further_than_by_chance(bent: float) -> None:
    here = candidate(explained((0.0, 0.0, 0.0), noise_mgauss=2.0, bent=bent), fit_of())
    assert levels.needs_none(here, floor(9.0, 9.0)) is (bent < 22.0)
    assert levels.needs_none(here, floor(9.0, 9.0, measured=False))


@pytest.mark.parametrize(
    ("effect", "left_mgauss", "heading_deg", "lost"),
    [
        ("soft_iron", 9.0, 9.0, True),  # acts everywhere: only in the mean it could be more
        ("spatial_dipole", 0.5, 9.0, True),
        ("spatial_dipole", 1.1, 9.0, False),
        ("spatial_dipole", 0.5, 0.1, False),  # it turns the heading
    ],
)
def test_below_the_floor_only_what_passes_is_told_from_another_flight(
    effect: str, left_mgauss: float, heading_deg: float, lost: bool
) -> None:
    """Where a magnet is passed readings may lie above the floor that they keep in the mean."""
    passed = np.where(np.arange(ROWS) < 10, 1.0, 0.0)

    class Passing(Problem):
        def predict(self, fit: Fit, effects: bool = True) -> Any:
            out = NORTH + sum(
                (passed * theta[0] if term.effect.id == "spatial_dipole" else BOTH_WAYS * theta[0])[:, None]
                * np.ones(3)
                for term, theta in zip(fit.terms, fit.thetas, strict=True)
            )
            return SimpleNamespace(mag_mgauss=out)

    problem: Any = Passing((passed * left_mgauss)[:, None] * np.ones(3))
    limits = floor(1.0, heading_deg)
    assert levels.lost_in_the_floor(problem, fit_of(**{effect: 1.0}), limits) is lost
    assert levels.lost_in_the_floor(problem, fit_of(), limits)


def test_without_held_out_rows_nothing_lies_at_the_floor() -> None:
    none = replace(split(), test=np.zeros(ROWS, dtype=np.bool_))
    here = candidate(explained((0.0, 0.0, 0.0)), fit_of(), split=none)
    assert not levels.at_floor(here, fit_of(), floor(9.0, 9.0))
    assert levels.at_floor(candidate(explained((0.0, 0.0, 0.0), 1.2), fit_of()), fit_of(), floor(1.0, 9.0))
    assert not levels.at_floor(
        candidate(explained((0.0, 0.0, 0.0), 1.3), fit_of()), fit_of(), floor(1.0, 9.0)
    )


# --- what is refused ---------------------------------------------------------------------------------


def test_a_sound_effect_passes_all_guards() -> None:
    here = candidate(explained((10.0, 0.0, 0.0)), fit_of(hard_iron=10.0))
    assert guards.refused(here, floor()) is None


def test_a_value_at_the_end_of_its_range_is_refused_where_it_is_needed() -> None:
    fit = fit_of(hard_iron=200.0)
    term = fit.terms[0]
    ends = replace(term, upper=np.array([200.0 + 1e-4, *term.upper[1:]]))
    at_the_end = replace(fit, terms=(ends,))
    refused = guards.refused(candidate(explained((200.0, 0.0, 0.0)), at_the_end), floor())
    assert refused == ("hard_iron", "its best value lies at the end of the physical range")
    held = replace(at_the_end, terms=(replace(ends, free=np.array([False, True, True])),))
    assert guards.refused(candidate(explained((200.0, 0.0, 0.0)), held), floor()) is None
    # Ten squared sigmas, 4 N gap^2 of what is predicted, by a tenth of it; by all under coarse numbers.
    for size, step_mgauss, is_needed in (
        (1.7, 0.0, False),
        (1.85, 0.0, True),
        (0.17, 5.0, False),
        (0.185, 5.0, True),
    ):
        small = fit_of(hard_iron=size)
        problem = explained((size, 0.0, 0.0), 0.0, step_mgauss=step_mgauss)
        assert guards._needed(candidate(problem, small), 0, 0) is is_needed


def test_a_magnet_on_the_path_is_refused() -> None:
    fit = fit_of(spatial_dipole=0.0)
    for away_m, touches in ((0.029, True), (0.031, False)):
        there = replace(fit, thetas=(np.array([0.0, away_m, 0.0, *fit.thetas[0][3:]]),))
        here = candidate(explained((0.0, 0.0, 0.0)), there)
        assert guards._touched(here) == ("spatial_dipole" if touches else None)
    assert guards._touched(candidate(explained((0.0, 0.0, 0.0)), fit_of(hard_iron=0.0))) is None


@pytest.mark.parametrize(("limit_mgauss", "ends"), [(395.0, True), (389.0, False)])
def test_a_limit_within_a_step_of_the_numbers_is_rounding(limit_mgauss: float, ends: bool) -> None:
    coarse = candidate(explained((0.0, 0.0, 0.0), step_mgauss=10.0), fit_of(clipping=limit_mgauss))
    assert guards._ends_on_a_step(coarse) is ends
    assert not guards._ends_on_a_step(candidate(explained((0.0, 0.0, 0.0)), fit_of(clipping=limit_mgauss)))
    assert not guards._ends_on_a_step(
        candidate(explained((0.0, 0.0, 0.0), step_mgauss=10.0), fit_of(hard_iron=1.0))
    )


@pytest.mark.parametrize(
    ("reads_mgauss", "passes"), [(500.0, False), (510.0, False), (513.9, False), (514.1, True), (900.0, True)]
)
def test_a_limit_that_readings_pass_is_none(reads_mgauss: float, passes: bool) -> None:
    # Two percent and four sigmas above 500 mG: one reading of eighty is more than one of a hundred.
    problem = explained((0.0, 0.0, 0.0), 0.0)
    problem.noise["mag"].rms[:] = 1.0
    problem.replay.measured.mag_mgauss[7, 1] = -reads_mgauss
    assert guards._passed(candidate(problem, fit_of(clipping=500.0))) is passes
    assert not guards._passed(candidate(problem, fit_of(hard_iron=1.0)))


def test_an_effect_of_one_half_that_the_other_contradicts_is_refused() -> None:
    problem = explained((10.0, 0.0, 0.0))
    sound = candidate(problem, fit_of(hard_iron=10.0))
    assert guards._vetoed(sound) is None
    torn = explained((0.0, 0.0, 0.0))
    assert (
        guards._vetoed(candidate(torn, fit_of(hard_iron=3.0))) is None
    )  # it explains nothing: no half shows it
    order = np.cumsum(~split().held)[split().block] % 2 == 0
    only = np.stack([BOTH_WAYS * np.where(order, 12.0, 0.0), 0.0 * BOTH_WAYS, 0.0 * BOTH_WAYS], axis=1)
    torn = replace(torn, left=torn.left + only)
    assert guards._vetoed(candidate(torn, fit_of(hard_iron=12.0))) == "hard_iron"
    # Where it hardly changes anything, a half says nothing against it.
    kept, change = guards._gain(torn, fit_of(hard_iron=12.0), 0)
    assert change == pytest.approx(ROWS * (12.0 / 0.5) ** 2) and kept < change


@pytest.mark.parametrize(
    ("size", "given", "floors", "refused"),
    [
        # With a baseline 0.5 mG, or half the floor; without one 1 mG.
        (0.55 * math.sqrt(3.0), {}, floor(0.5, 9.0), False),
        (0.45 * math.sqrt(3.0), {}, floor(0.5, 9.0), True),
        (1.1 * math.sqrt(3.0), {}, floor(0.6, 9.0, measured=False), False),
        (0.9 * math.sqrt(3.0), {}, floor(0.6, 9.0, measured=False), True),
        (1.6 * math.sqrt(3.0), {}, floor(3.0, 9.0), True),  # less than the floor without it
        (2.9 * math.sqrt(3.0), {}, floor(3.0, 9.0), False),
        # Coarse numbers: half of what rounding leaves.
        (1.4 * math.sqrt(3.0), {"step_mgauss": 8.0}, floor(0.8, 9.0), False),
        (1.0 * math.sqrt(3.0), {"step_mgauss": 8.0}, floor(0.8, 9.0), True),
        # Six hundredths of a line that was taken out.
        (1.6 * math.sqrt(3.0), {"taken_mgauss": 25.0}, floor(0.8, 9.0), False),
        (1.4 * math.sqrt(3.0), {"taken_mgauss": 25.0}, floor(0.8, 9.0), True),
    ],
)  # fmt: skip
def test_what_removes_too_little_is_not_named(
    size: float, given: dict[str, Any], floors: Any, refused: bool
) -> None:
    here = candidate(explained((size, 0.0, 0.0), 0.3, **given), fit_of(hard_iron=size))
    assert guards.refused(here, floors) == (("hard_iron", guards.TOO_SMALL) if refused else None)


@pytest.mark.parametrize(
    ("effect", "scatter_mgauss", "size", "refused"),
    [
        # Half of a floor of 4 mG; of what lasts of it, the square root of 4^2 - 3.5^2, half is 0.97.
        ("spatial_dipole", 0.0, 2.1, False),
        ("spatial_dipole", 0.0, 1.9, True),
        ("spatial_dipole", 3.5, 1.0, False),
        ("spatial_dipole", 3.5, 0.9, True),
        # A quarter of it is taken to last at least: half a milligauss.
        ("spatial_dipole", 3.99, 0.55, False),
        ("spatial_dipole", 3.99, 0.45, True),
        # Another iron is what a calibration may be off by.
        ("hard_iron", 3.5, 1.9, True),
    ],
)
def test_scatter_hides_nothing_but_another_iron(
    effect: str, scatter_mgauss: float, size: float, refused: bool
) -> None:
    size *= math.sqrt(3.0)
    axis = Problem.axes.index(effect)
    gap = size * np.eye(3)[axis]
    left = np.full((ROWS, 3), 3.9 * math.sqrt(1.5))  # 3.9 mG rms, on the other axes
    left[:, axis] = 0.0
    problem = Problem(left, gap=gap, scatter_mgauss=scatter_mgauss, noise_mgauss=4.0)
    here = candidate(problem, fit_of(**{effect: size}))
    assert materiality.immaterial(here, floor(4.0, 90.0)) == (effect if refused else None)


@pytest.mark.parametrize(
    ("effect", "size", "noise_mgauss", "refused"),
    [
        # An eighth of a floor of 8 mG is asked for, though 8 mG are left without it, and no more.
        ("spatial_dipole", 1.05, 0.5, False),
        ("spatial_dipole", 0.95, 0.5, True),
        # Eighty-one squared sigmas make it certain: with 60 readings and a noise of 1.9 mG 55.
        ("spatial_dipole", 1.05, 1.9, True),
        # Another iron is what a calibration may be off by, however certain.
        ("hard_iron", 1.05, 0.5, True),
    ],
)
def test_what_is_certain_need_not_rise_above_the_floor(
    effect: str, size: float, noise_mgauss: float, refused: bool
) -> None:
    size *= math.sqrt(3.0)
    gap = size * np.eye(3)[Problem.axes.index(effect)]
    x, y, z = gap.tolist()
    here = candidate(explained((x, y, z), 0.3, noise_mgauss=noise_mgauss), fit_of(**{effect: size}))
    assert materiality.immaterial(here, floor(8.0, 90.0)) == (effect if refused else None)


@pytest.mark.parametrize(
    ("share", "left_mgauss", "floor_mgauss", "refused"),
    [
        (0.21, 0.5, 4.0, False),
        (0.19, 0.5, 5.0, True),  # 6.6 mG without it: that is near the floor
        (0.19, 0.5, 3.0, False),
        (0.11, 0.5, 1.0, False),
        (0.09, 0.5, 1.0, True),
        (0.19, 2.0, 1.0, True),
        (0.21, 2.0, 1.0, False),
        (0.35, 55.0, 1.0, True),
    ],
)
def test_beside_another_a_material_share_is_asked_for(
    share: float, left_mgauss: float, floor_mgauss: float, refused: bool
) -> None:
    """A fifth of what all effects change, a tenth where it leads from far above the floor down to it, and two
    fifths of all that the rest leaves where something is left that nobody knows."""
    other = 60.0
    size = share * other / math.sqrt(1.0 - share**2)
    here = candidate(explained((other, 0.0, size), left_mgauss), fit_of(hard_iron=other, spatial_dipole=size))
    assert materiality.immaterial(here, floor(floor_mgauss, 90.0)) == ("spatial_dipole" if refused else None)


def test_the_heading_alone_makes_an_effect_matter() -> None:
    size = 0.45 * math.sqrt(3.0)  # too little of the field; of the heading 0.22 degrees
    here = candidate(explained((0.0, size, 0.0), 0.1), fit_of(soft_iron=size))
    assert materiality.immaterial(here, floor(0.8, 0.2)) is None
    assert materiality.immaterial(here, floor(0.8, 0.46)) == "soft_iron"


def test_an_independent_attitudes_floor_is_generous() -> None:
    size = 0.6 * math.sqrt(3.0)
    for kind, refused in (("columns", False), ("estimator", True)):
        here = candidate(explained((size, 0.0, 0.0), 0.3, kind=kind), fit_of(hard_iron=size))
        assert (
            materiality.immaterial(here, floor(1.1, 9.0, measured=False)) is not None
        ) is refused or kind == "columns"
    large = candidate(explained((3.0, 0.0, 0.0), 0.3, kind="columns"), fit_of(hard_iron=3.0))
    assert materiality.immaterial(large, floor(3.0, 9.0, measured=False)) is None
    assert materiality.immaterial(large, floor(4.0, 9.0, measured=False)) == "hard_iron"  # below half of it


def test_what_is_removed_is_told_on_rows_that_were_not_fitted() -> None:
    problem = explained((0.0, 6.0, 0.0), 0.0)
    problem.replay.measured.mag_mgauss[split().train, 1] += 1.0
    field, heading = materiality.removed_by(candidate(problem, fit_of(soft_iron=6.0)), 0)
    assert field.square == pytest.approx(12.0) and field.without == pytest.approx(math.sqrt(12.0 + 0.25))
    degree = math.degrees(1.0 / 200.0)
    assert heading.square == pytest.approx(36.0 * degree**2)
    assert field.sure == pytest.approx(12.0)  # all blocks agree
    # A block in which it changes nothing says nothing; one that contradicts does.
    problem.replay.measured.mag_mgauss[split().block == 0, 1] -= 6.0 * BOTH_WAYS[:10]
    torn, _ = materiality.removed_by(candidate(problem, fit_of(soft_iron=6.0)), 0)
    blocks = np.array([-12.0] + [12.0] * 7)
    assert torn.sure == pytest.approx(blocks.mean() - 1.7 * blocks.std() / math.sqrt(7.0))
    none = replace(split(), test=np.zeros(ROWS, dtype=np.bool_))
    whole, _ = materiality.removed_by(candidate(problem, fit_of(soft_iron=6.0), split=none), 0)
    assert whole.square == pytest.approx(0.75 * 12.0 - 0.25 * 12.0 + 2.0, abs=3.0) and whole.square > 0.0


class Passed(Problem):
    """The effect is there on a quarter of the held-out rows only, and on all the others."""

    def predict(self, fit: Fit, effects: bool = True) -> Any:
        there = ~split().test | (np.arange(ROWS) % 4 == 0)
        whole = super().predict(fit, effects).mag_mgauss
        return SimpleNamespace(mag_mgauss=NORTH + (whole - NORTH) * there[:, None])


def test_what_shows_in_few_held_out_rows_is_told_for_all() -> None:
    made = explained((0.0, 6.0, 0.0), 0.0)
    problem = Passed(made.left, made.rows, made.gap)
    fit = fit_of(soft_iron=6.0)
    problem.replay.measured.mag_mgauss[:] = problem.predict(fit).mag_mgauss
    field, _ = materiality.removed_by(candidate(problem, fit), 0)
    there = 20 / 80 * 6 / 20 + 60 / 80  # six of twenty held-out rows, all others
    assert field.square == pytest.approx(12.0 * there)


@pytest.mark.parametrize(("fitted", "agree"), [(range(8), True), ((0, 1), False)])
def test_what_shows_in_no_held_out_row_is_told_by_blocks_that_agree(
    fitted: Sequence[int], agree: bool
) -> None:
    """A compass that clips while the vehicle points one way may do so in fitted rows alone."""
    made = explained((0.0, 6.0, 0.0), 0.0)
    problem = Clipped(made.left, made.rows, made.gap)
    problem.blocks = fitted
    fit = fit_of(soft_iron=6.0)
    problem.replay.measured.mag_mgauss[:] = problem.predict(fit).mag_mgauss
    field, _ = materiality.removed_by(candidate(problem, fit), 0)
    assert field.square == pytest.approx(12.0 if agree else 0.0, abs=0.1)


class Clipped(Problem):
    """The effect is there in some blocks, and of these in what was fitted."""

    blocks: Sequence[int] = ()

    def predict(self, fit: Fit, effects: bool = True) -> Any:
        there = ~split().test & np.isin(split().block, self.blocks)
        whole = super().predict(fit, effects).mag_mgauss
        return SimpleNamespace(mag_mgauss=NORTH + (whole - NORTH) * there[:, None])


class Yielding(Problem):
    """Without an effect what is known of the vehicle gives way and explains the gap as well."""

    def fit(self, terms: Any, thetas: Any, nuisances: Any, iterations: int = 1) -> Fit:
        return replace(super().fit(terms, thetas, nuisances), nuisance_thetas=(self.gap,))

    def predict(self, fit: Fit, effects: bool = True) -> Any:
        out = super().predict(fit, effects)
        yielded = BOTH_WAYS[:, None] * fit.nuisance_thetas[0] if fit.nuisance_thetas else 0.0
        return SimpleNamespace(mag_mgauss=out.mag_mgauss + yielded)

    def steady(self, fit: Fit) -> Problem:
        return Problem(**{name: getattr(self, name) for name in ("left", "rows", "gap")})


@pytest.mark.parametrize(("bent", "square"), [(21.0, 0.0), (23.0, 12.0)])
def test_what_is_known_does_not_give_way_by_more_than_chance(bent: float, square: float) -> None:
    problem = explained((0.0, 6.0, 0.0), 0.0)
    yielding = Yielding(problem.left, problem.rows, problem.gap, bent=bent)
    field, _ = materiality.removed_by(candidate(yielding, fit_of(soft_iron=6.0)), 0)
    assert field.square == pytest.approx(square, abs=1e-9)


# --- certain, and too small ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gain", "held_gain", "contradiction", "told"),
    [(81.5, 26.0, 0.9, True), (80.5, 26.0, 0.9, False), (81.5, 24.0, 0.9, False), (170.0, 26.0, 2.2, False)],
)
def test_what_is_certain_is_so_on_both_kinds_of_rows(
    gain: float, held_gain: float, contradiction: float, told: bool
) -> None:
    problem = explained((0.0, 0.0, 0.0), 0.0)
    rest = replace(fit_of(), sse=100.0 + gain)
    size = math.sqrt(held_gain / 20.0) * 0.5  # of twenty held-out rows
    problem = explained((size, 0.0, 0.0), 0.0)
    search = SimpleNamespace(criteria=SimpleNamespace(contradiction=lambda without, fit: contradiction))
    here = candidate(problem, replace(fit_of(hard_iron=size), sse=100.0), search=search)
    assert levels.evident(here, rest) is told
    nothing = replace(split(), test=np.zeros(ROWS, dtype=np.bool_))
    assert not levels.evident(candidate(problem, here.fit, search=search, split=nothing), rest)


@pytest.mark.parametrize(("left_mgauss", "worth"), [(1.10, False), (1.14, True)])
def test_one_more_effect_is_worth_while_above_the_noise(left_mgauss: float, worth: bool) -> None:
    problem = explained((0.0, 0.0, 0.0), left_mgauss)  # noise 0.5, least 1 mG: 1.118 in all
    assert materiality.worthwhile(problem, floor(), fit_of()) is worth  # type: ignore[arg-type]
    assert materiality.worthwhile(problem, floor(representative=True), fit_of())  # type: ignore[arg-type]
    assert materiality.worthwhile(replace(problem, bent=23.0), floor(), fit_of())  # type: ignore[arg-type]


def test_a_tenth_of_the_gap_is_the_least() -> None:
    problem = explained((60.0, 0.0, 0.0), 0.3)
    fit = fit_of(hard_iron=60.0)
    after = materiality._left(problem, fit, effects=True)  # type: ignore[arg-type]
    assert after["mag"] == pytest.approx(0.3)
    least = materiality._least(problem, fit, after)  # type: ignore[arg-type]
    assert (
        least["mag"] == pytest.approx(0.1 * 60.0 / math.sqrt(3.0))
        and least["acc"] == 0.1
        and least["gyro"] == 0.004
    )
    small = explained((5.0, 0.0, 0.0), 0.3)
    assert materiality._least(small, fit_of(hard_iron=5.0), {"mag": 0.3})["mag"] == 1.0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("beside", "size", "floor_mgauss", "lost"),
    [(60.0, 3.5, 9.0, True), (60.0, 3.7, 9.0, False), (60.0, 3.5, 5.0, False), (60.0, 1.7, 5.0, True)],
)
def test_beside_an_exact_floor_small_errors_of_another_are_not_named(
    beside: float, size: float, floor_mgauss: float, lost: bool
) -> None:
    """Six hundredths of another effect, and a third of the floor, whichever is less."""
    fit = fit_of(hard_iron=beside, spatial_dipole=size)
    here = candidate(explained((beside, 0.0, size), 0.3), fit)
    over = floor(floor_mgauss, 9.0, representative=True)
    assert materiality.immaterial(here, over) == ("spatial_dipole" if lost else None)
    assert materiality._lost_beside(here, over, {}) is None


def test_beside_an_exact_floor_a_doubtful_sensors_effects_have_its_tolerance() -> None:
    fit = fit_of(hard_iron=1.5)
    for size, refused in ((1.5, True), (1.9, False)):  # 1 mG of all axes: 1.73 of one
        problem = explained((size, 0.0, 0.0), 0.1)
        problem.replay.doubtful = {"mag": "x"}
        here = candidate(problem, fit_of(hard_iron=size))
        assert materiality.immaterial(here, floor(representative=True)) == ("hard_iron" if refused else None)
    sure = candidate(explained((1.5, 0.0, 0.0), 0.1), fit)
    assert materiality.immaterial(sure, floor(representative=True)) is None


REASONS = {
    "_touched": ("spatial_dipole", "its place lies on the path itself, where it could explain any reading"),
    "_ends_on_a_step": ("clipping", "numbers as coarse as these end at one of their own steps"),
    "_passed": ("clipping", "readings pass the limit"),
    "_vetoed": ("soft_iron", "one half of the training data does not confirm what the other half says"),
    "immaterial": ("hard_iron", guards.TOO_SMALL),
}


@pytest.mark.parametrize("first", REASONS)
def test_guards_are_asked_in_their_order_and_say_why(first: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first that refuses is told, whatever those after it would say."""
    refusing = False
    for name, (effect, _) in REASONS.items():
        refusing = refusing or name == first
        said: Any = refusing if name in ("_ends_on_a_step", "_passed") else (effect if refusing else None)
        monkeypatch.setattr(guards, name, lambda *_, said=said: said)
    made = candidate(explained((30.0, 0.0, 0.0)), fit_of(hard_iron=30.0))
    assert guards.refused(made, floor()) == REASONS[first]


def test_a_veto_looks_at_rows_that_are_fitted_alone() -> None:
    """Each half teaches and judges once; rows that the problem leaves out do neither."""
    looked: list[Any] = []
    fitted = np.arange(ROWS) % 3 > 0

    class Spy:
        rows = fitted

        def with_rows(self, rows: Any) -> Spy:
            looked.append(rows)
            return self

        def fit(self, *_: Any, **more: Any) -> Fit:
            assert more == {"iterations": 3}
            return fit_of()

    assert guards._vetoed(candidate(Spy(), fit_of(hard_iron=1.0))) is None  # type: ignore[arg-type]
    one, other = split().halves()
    assert [rows.tolist() for rows in looked] == [
        rows.tolist() for rows in (one & fitted, other & fitted, other & fitted, one & fitted)
    ]


@pytest.mark.parametrize(
    ("field", "heading", "lies"),
    [(2.49, 0.74, True), (2.5, 0.74, False), (2.49, 0.75, False), (2.6, 0.1, False), (0.1, 0.8, False)],
)
def test_the_floor_is_reached_below_a_quarter_more(
    field: float, heading: float, lies: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(levels, "apart", lambda *_: (field, heading))
    made = candidate(explained((30.0, 0.0, 0.0)), fit_of())
    assert levels.at_floor(made, made.fit, floor(2.0, 0.6)) is lies


@pytest.mark.parametrize(("away_m", "touches"), [(0.03, False), (0.0299, True), (-0.031, False)])
def test_a_magnet_nearer_than_three_centimetres_lies_on_the_path(away_m: float, touches: bool) -> None:
    made = candidate(explained((0.0, 0.0, 30.0)), fit_of(spatial_dipole=away_m))
    assert (guards._touched(made) == "spatial_dipole") is touches
    assert guards._touched(candidate(made.problem, fit_of(hard_iron=away_m))) is None


@pytest.mark.parametrize(
    ("size_mgauss", "floor_mgauss", "refused"),
    [
        # On one axis of three: 0.2 mG change 0.115 in all.
        (0.2, 2.0, False),
        (0.2, 2.5, True),
        (-0.2, 2.5, True),
        (2.0, 2.5, False),
    ],
)
def test_beside_an_exact_floor_too_a_twentieth_of_it_is_the_models_own_error(
    size_mgauss: float, floor_mgauss: float, refused: bool
) -> None:
    """A declination of two hundredths of a degree was named, at a hundred per cent, in a healthy vehicle."""
    here = candidate(explained((size_mgauss, 0.0, 0.0)), fit_of(hard_iron=size_mgauss))
    over = floor(floor_mgauss, 9.0, representative=True)
    assert materiality._within_the_model(here, over) == ("hard_iron" if refused else None)
    # Of other sensors the compass says nothing.
    gyro = candidate(explained((0.0, 0.0, 0.0)), fit_of(gyro_bias=size_mgauss))
    assert materiality._within_the_model(gyro, over) is None
