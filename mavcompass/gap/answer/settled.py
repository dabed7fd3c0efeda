"""Settle what is said of a gap with the figures that it makes: one rule after the other, each on what the one
before it left.

A name changes the figures, and figures may take a name back: neither may contradict the other at the end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.answer.shrink import closings
from mavcompass.gap.answer.verdict import Answer, consistent, hold_little, owning_up, with_likely_names
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import Floor, Scatter, rms
from mavcompass.gap.replay import REFERENCE_YAW
from mavcompass.gap.result import Closing
from mavcompass.gap.selection import ABOVE, SILENT, at_floor, evident, lost_in_the_floor

# Where a heading is told no better, a recording tells nothing.
_COARSEST_DEG = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Hold an answer, and how far it closes the gap of field and heading on held-out readings."""

    answer: Answer
    field: Closing
    heading: Closing

    @property
    def closings(self) -> tuple[Closing, Closing]:
        """Return both."""
        return self.field, self.heading


def settled(evidence: Evidence, decided: Answer, sets: Sequence[tuple[frozenset[str], float]]) -> Settled:
    """Measure the closing of what was decided; take names back that it does not bear out.

    `sets` are what could explain the gap, with their weights.
    """
    settling = _Settling(evidence, decided)
    said = settling.without_contradiction(settling.decided)
    said = settling.without_mere_scatter(said)
    said = settling.owned_up(said)
    said = settling.no_worse(said)
    said = settling.without_unlikely_names(said, sets)
    said = settling.sure_by_its_shrink(said)
    said = settling.beside_its_attitude(said)
    said = settling.as_far_as_it_shows(said)
    return Settled(said.answer, *map(_never_worse, said.closings))


class _Settling:
    """Apply the rules to one recording's evidence."""

    def __init__(self, evidence: Evidence, decided: Answer) -> None:
        identified, scatter = evidence.identified, evidence.remainder.scatter
        self._evidence = evidence
        self._floor, self._none = evidence.floor, identified.found.null
        self._problem, self._test = identified.problem, identified.split.test
        # Of single readings: what scatters more, what rows do not have, and what they were before a rounding.
        self._added_mgauss2, self._unrounded = 0.0, None
        if scatter is not None and decided.verdict != "unknown":
            self._added_mgauss2 = _added_variance(scatter, self._problem, decided.named, self._test)
        if evidence.traces.step_mgauss > 0.0:
            self._unrounded = evidence.remainder.problem.replay.measured.mag_mgauss
        self.decided = self.with_figures(decided)

    def with_figures(self, answer: Answer) -> Settled:
        """Measure what an answer closes, what single readings tell included."""
        named, drawn = answer.named, self._evidence.remainder.fit
        if self._unrounded is not None and named.ids == drawn.ids:
            # What readings may have been before they were rounded was drawn about the fit to all of them.
            named = drawn
        explained = (self._added_mgauss2, self._evidence.unseen_mgauss2, self._unrounded)
        return Settled(answer, *closings(self._problem, named, self._test, self._floor, *explained))

    def without_contradiction(self, said: Settled) -> Settled:
        """Return an answer that its own figures do not contradict."""
        evidence, floor, named = self._evidence, self._floor, said.answer.named
        turns = bool(self._problem.replay.present & {"turning", "tilt"}) or floor.measured
        # Of another iron only what shrinks is a cause: a calibration may be off by it.
        others = any(not term.effect.affine for term in named.terms)
        shrunk = said.field.after < said.field.nominal
        certain = others and shrunk and evident(replace(evidence.identified, fit=named), self._none)
        # Beside the best explanation of the rest a constant offset of what hardly turns is none.
        varies = not (turns or self._is_quiet())
        replay, level_known = self._problem.replay, not evidence.faults

        def borne_out(answer: Answer, field: Closing, heading: Closing) -> Answer:
            return consistent(
                answer, field, heading, evidence.adequacy.where, floor, self._none, evidence.beside, turns,
                replay, certain, level_known, varies,
            )  # fmt: skip

        below = floor.measured and not (floor.representative or evidence.beside)
        below = below and all(c.nominal < c.floor for c in said.closings)
        if below and lost_in_the_floor(self._problem, named, floor):
            # Whatever single readings know.
            answer = Answer("no_gap", self._none, False, None)
        else:
            answer = borne_out(said.answer, *said.closings)
        if answer.verdict == "no_gap" and named.terms:
            # Beside the best explanation of the rest (place, calibration, attitude) nothing lies above the
            # floor.
            return Settled(answer, *(replace(c, after=c.nominal, shrink=0.0) for c in said.closings))
        if answer.named is named:
            return replace(said, answer=answer)
        # Without its names an answer has other figures, which it must not contradict either.
        other = self.with_figures(answer)
        return replace(other, answer=borne_out(answer, *other.closings))

    def without_mere_scatter(self, said: Settled) -> Settled:
        """Take scatter back that holds little, alone and without a baseline: what nobody knows scatters,
        too."""
        evidence, answer = self._evidence, said.answer
        by_scatter = evidence.remainder.scatter is not None and not (evidence.faults or evidence.traces.named)
        alone = by_scatter and answer.verdict == "named_with_remainder" and not answer.named.terms
        if alone and not self._floor.measured and hold_little(*said.closings):
            return self._unknown(answer.coordinate)
        return said

    def owned_up(self, said: Settled) -> Settled:
        """Return an answer that says what healthy vehicles do not leave."""
        evidence, floor = self._evidence, self._floor
        if not floor.measured or floor.representative or evidence.beside:
            return said
        identified, adequacy = evidence.identified, evidence.adequacy
        decided = self.decided.answer
        answer = owning_up(
            said.answer, decided, identified, said.field, adequacy, self._is_quiet(),
            evidence.traces.unexplained,
        )  # fmt: skip
        if answer is decided:
            # Where what was decided stands again, so do its figures.
            return self.decided
        silenced = answer.verdict == "no_gap" and said.answer.verdict != "no_gap"
        return self.with_figures(answer) if silenced else replace(said, answer=answer)

    def no_worse(self, said: Settled) -> Settled:
        """Take names back that make held-out readings less likely: they are no explanation."""
        worse = said.answer.named.terms and _worse_on(self._problem, said.answer.named, self._test)
        return self._unknown(self._evidence.adequacy.where) if worse else said

    def without_unlikely_names(self, said: Settled, sets: Sequence[tuple[frozenset[str], float]]) -> Settled:
        """Take names beside a remainder back that may be others."""
        beside = self._evidence.beside
        answer = with_likely_names(said.answer, sets, self._floor, self._none, beside)
        return said if answer is said.answer else self.with_figures(answer)

    def sure_by_its_shrink(self, said: Settled) -> Settled:
        """Say of what does not surely shrink the mean, certain by its shape alone, that it may be another."""
        shrinks = self._floor.representative or any(c.shrink_ci95[0] > 0.0 for c in said.closings)
        answer = said.answer
        if answer.verdict == "named" and answer.named.terms and not (shrinks or self._evidence.beside):
            return replace(said, answer=replace(answer, verdict="ambiguous"))
        return said

    def beside_its_attitude(self, said: Settled) -> Settled:
        """Leave a remainder beside names where the yaw has to wander by more than the floor: field and dip
        bear them out, but no heading does."""
        answer = said.answer
        sure = answer.verdict == "named" and bool(answer.named.terms)
        if not sure or not yaw_wander_deg(self._problem, answer.named, self._floor, said.heading):
            return said
        left = replace(answer, verdict="named_with_remainder", flagged=True, coordinate="time")
        return replace(said, answer=left)

    def as_far_as_it_shows(self, said: Settled) -> Settled:
        """Say that nothing could show where the attitude is known so badly that hardly any heading does."""
        coarse = not self._floor.measured and said.heading.floor > _COARSEST_DEG
        if not coarse or said.answer.verdict != "no_gap":
            return said
        return replace(said, answer=replace(said.answer, verdict="not_testable"))

    def _unknown(self, coordinate: str | None) -> Settled:
        """Return that nothing explains the gap, single readings included."""
        figures = closings(self._problem, self._none, self._test, self._floor)
        return Settled(Answer("unknown", self._none, True, coordinate), *figures)

    def _is_quiet(self) -> bool:
        """Tell whether nothing lies above the floor beside the best explanation of the rest."""
        return at_floor(self._evidence.identified, self._none, self._floor, ABOVE)


def yaw_wander_deg(problem: Problem, fit: Fit, floor: Floor, heading: Closing) -> float:
    """Return by how much a yaw that neither witness nor baseline tells has to wander beside a fit, rms over
    time; 0 where that is no more than the heading's floor."""
    reference = problem.replay.reference
    if reference.witnessed or floor.measured:
        return 0.0
    turned = [
        rms(reference.wander_rad(theta[1:])[problem.usable])
        for nuisance, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True)
        if nuisance.effect.id == REFERENCE_YAW
    ]
    wander = math.degrees(max(turned, default=0.0))
    return wander if wander > ABOVE * heading.floor else 0.0


def shows(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects change held-out readings enough to be judged by them."""
    held = problem.with_rows(test)
    change = held.shift(held.predict(fit), held.predict(fit, effects=False))
    return float(np.sum(change**2)) > SILENT


def _worse_on(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects make held-out readings of all sensors less likely."""
    if not shows(problem, fit, test):
        return False
    held = problem.with_rows(test)
    before, after = held.residual(held.predict(fit, effects=False)), held.residual(held.predict(fit))
    return float(after @ after) > float(before @ before)


def _never_worse(closing: Closing) -> Closing:
    """Say no change where effects that show elsewhere (accelerometer, gyro) leave one figure as it was.

    All sensors together became better; one that has no part in it differs by its noise.
    """
    if closing.after <= closing.nominal:
        return closing
    return replace(closing, after=closing.nominal, shrink=0.0)


def _added_variance(scatter: Scatter, problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> float:
    if scatter.white:
        return scatter.on_rows_mgauss2(problem.replay)
    field = problem.signals(fit).reading.mag_mgauss
    change = np.gradient(field, problem.replay.time_s, axis=0)[test]
    return float(np.mean((scatter.size * change) ** 2))
