"""Search the set of effects that explains a gap: beam search, and its first values.

The catalogue is linearised once beside what is known, and sets are weighed by their normal equations; only
the few that could win are fitted through the simulation. Beside the best one the catalogue is linearised
again, until nothing changes. Sets are weighed by what they cost in the posterior (`candidates`).

No derivative leads to some of them: what is bent by a gap hides what bends it; what makes readings late is
hidden by the age of telemetry; a compass in another orientation is turned by right angles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mavcompass.gap.fit.candidates import Candidate, Candidates, Criteria, likeliest_sets, misfit_of
from mavcompass.gap.fit.hypothesis import Fit, Term, least_gain, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, TELEMETRY_AGE, yaw_starts
from mavcompass.gap.tables import Kind, usual
from mavcompass.simulation.effects.effect import MOMENTS, Effect

# So many steps tell whether a fit is worth going on with.
FEW_STEPS = 3


def nuisances_at_prior(problem: Problem, fit: Fit, curves: bool = False) -> Fit:
    """Return nuisances to their prior where a gap has bent them far: what is wrong must show to be
    found. How the attitude wanders explains nothing away, but beside bent `curves` no derivative is
    good."""
    prior, kept = problem.prior, fit.nuisances.copy()
    if fit.terms or not kept.size:
        return fit
    off, within = kept - prior.mean, problem.nuisances_within_prior(fit)
    for nuisance, at in prior.places.items():
        if nuisance == REFERENCE_YAW:
            # Its constant, and its curves, by themselves.
            parts = [slice(at.start, at.start + 1), *([slice(at.start + 1, at.stop)] if curves else [])]
            bent = [p for p in parts if off[p] @ prior.precision[p, p] @ off[p] >= least_gain(off[p].size)]
        else:
            # How old readings are is another matter than the iron and the place that a gap may bend.
            aged2 = (off[at] / usual.age.sigma_s) ** 2 if nuisance == TELEMETRY_AGE else np.inf
            bent = [] if within or np.all(aged2 < least_gain(1)) else [at]
        for part in bent:
            kept[part] = prior.mean[part]
    return fit if np.array_equal(kept, fit.nuisances) else replace(fit, nuisances=kept)


def facing(problem: Problem, terms: Sequence[Term], beside: Fit, most_sse: float) -> list[Fit]:
    """Fit each likely orientation beside the effects of a fit, where it may leave less than `most_sse`."""
    out: list[Fit] = []
    for term in terms:
        if term.effect.kind != "discrete" or term.effect.starts is None:
            continue
        for guess in term.effect.starts(misfit_of(problem, problem.signals(beside))):
            turned = beside.beside(term, guess)
            starts = [replace(turned, nuisances=known) for known in yaw_starts(problem.prior)]
            fits = sorted((problem.fit(start, 1) for start in starts), key=lambda f: f.sse)
            if len(starts) > 1 and fits[0].sse >= most_sse:
                # Where the yaw may be anything, one of six is off by so much that it takes a few steps more.
                fits = [problem.fit(f, FEW_STEPS) for f in fits[:1]]
            # Elsewhere one step is enough to see that a compass is not mounted so.
            likely = [fit for fit in fits[: usual.search.yaws] if fit.sse < most_sse]
            if likely:
                out.append(min(map(problem.refit, likely), key=lambda f: f.sse))
    return out


MOST_EFFECTS = 4
_ROUNDS = 4


def pruned(problem: Problem, fit: Fit) -> Fit:
    """Hold parameters at zero that the data do not need beside the others, one after another.

    Of several that could go, that one goes which leaves the smallest parameters in natural sizes.
    """
    if len(fit.terms) < 2:
        return fit
    while True:
        options = []
        for i, term in enumerate(fit.terms):
            if not term.effect.affine or term.dimension < 2:
                continue
            for j in np.flatnonzero(term.free):
                free = term.free.copy()
                free[j] = False
                theta = fit.thetas[i].copy()
                theta[j] = 0.0
                trial = problem.fit(fit.changed(i, replace(term, free=free), theta), FEW_STEPS)
                if trial.sse < fit.sse + usual.search.pruning:
                    options.append(trial)
        if not options:
            return fit
        fit = min(options, key=_natural_size)


def _natural_size(fit: Fit) -> float:
    return sum(
        float(np.sum((x / np.maximum(t.effect.scale, 1e-12))[t.free] ** 2))
        for t, x in zip(fit.terms, fit.thetas, strict=True)
        if t.effect.affine
    )


class Search:
    """Search sets of effects on one problem; `kind` tells how the recording is known."""

    def __init__(self, problem: Problem, effects: Iterable[Effect], kind: Kind = "exact") -> None:
        self.problem = problem
        self.criteria = Criteria(problem, kind)
        signals = problem.replay.signals
        self.terms = [make_term(effect, signals) for effect in effects if effect.kind in ("mean", "discrete")]
        self.explored: dict[frozenset[str], Fit] = {}
        # By the set that they stand beside, and how much of it is held.
        self._candidates: dict[tuple[frozenset[str], int], Candidates] = {}
        # Fits of candidates, by how many effects are held beside them, and of how many steps.
        self._fits: dict[tuple[int, int, tuple[Candidate, ...]], Fit] = {}

    def on(self, problem: Problem) -> Search:
        """Return a search of the same terms on other rows or under another noise, nothing explored yet."""
        other = Search(problem, (), self.criteria.kind)
        other.terms, other.criteria.overdispersion = self.terms, self.criteria.overdispersion
        return other

    def forget(self) -> None:
        """Let go of all derivatives: what was explored stays."""
        self._candidates.clear()
        self._fits.clear()

    def run(self, most: int = MOST_EFFECTS, likely: Sequence[Fit] = ()) -> Fit:
        """Return the best of sets of up to `most` effects, from the best of sets that are `likely` on."""
        null = self.explored.setdefault(frozenset(), self.problem.null())
        self._remember(likely)
        best = self._cheapest(null, most)
        as_known = Fit(nuisances=self.problem.prior.mean)
        turns = facing(self.problem, self.terms, as_known, null.sse)
        noise = 3 * len(self.problem.groups) * self.problem.count
        explained = min((fit.sse for fit in turns), default=np.inf)
        if explained < usual.search.unexplained * noise:
            best = self._rounds(null, most, (), best, 1)
        nearest = np.inf if best.is_turned else best.sse
        # A turn that leaves nothing, where nothing else comes near at once, needs no second look at others.
        if explained > min(usual.search.unexplained * noise, usual.search.hopeful * nearest):
            best = self._rounds(null, most, (), best)
        for turned in self._turned(null, best, turns):
            before = self.criteria.overdispersion
            rival = self._rounds(turned, most, turned.terms, turned)
            if self.criteria.score(rival) < self.criteria.score(best):
                best = rival
            else:
                self.criteria.overdispersion = before
        best = self.polished(best)
        other = self._beside_one(best)
        if other is not best:
            other = self.polished(self._rounds(null, most, (), other))
            best, other = sorted((best, other), key=self.criteria.score)
        self.explored |= {other.ids: other, best.ids: best}
        return best

    def _beside_one(self, best: Fit) -> Fit:
        """Return the best set that is seen beside the one effect that does best alone.

        Beside nothing what limits the readings, or lasts for a moment, hides or bends what others do.
        """
        if best.is_turned or len(best.terms) < 2:
            return best
        ones = [
            self.explored.get(frozenset({term.effect.id}))
            or self.problem.fit(Fit((term,), (theta,), best.nuisances))
            for term, theta in zip(best.terms, best.thetas, strict=True)
        ]
        empty, fits = Fit(), [best]
        for one in sorted(ones, key=self.criteria.score)[: usual.search.alone]:
            if (one.ids, 0) not in self._candidates:
                candidates = self._linearised(self.problem.refit(one), ())
                sets = likeliest_sets(candidates, self.criteria, 2).get(2, ())
                fits += [self._fitted(candidates, chosen, empty, FEW_STEPS) for chosen in sets]
        self._remember(fits)
        likeliest = min(fits, key=self.criteria.score)
        gained = self.criteria.score(best) - self.criteria.score(likeliest)
        return likeliest if gained > usual.search.far_likelier else best

    def nearest(self, most: int, held: Fit | None = None) -> Fit:
        """Return the fit that comes nearest with up to `most` effects, beside those `held`, needed or not.

        On noiseless readings its sum of squares is the squared distance to all that these effects can make.
        """
        kept = Fit() if held is None else held
        best = self.problem.null() if held is None else self.problem.refit(held)
        for _ in range(_ROUNDS):
            candidates = self._linearised(best, kept.terms)
            sets = likeliest_sets(candidates, self.criteria, most)
            trials = [s for size in sorted(sets) for s in sets[size][: 2 if size == max(sets) else 1]]
            fits = [self._fitted(candidates, chosen, kept, 8) for chosen in trials]
            better = min([best, *fits], key=lambda f: f.sse)
            if better.sse > 0.99 * best.sse:
                best = better
                break
            best = better
        return best

    def _turned(self, null: Fit, best: Fit, turns: Sequence[Fit]) -> list[Fit]:
        """Choose of fitted `turns` of the compass those that explain most of what there is to explain."""
        out = [
            f
            for f in turns
            if null.sse - f.sse > 0.5 * (null.sse - best.sse)
            and self.criteria.score(f) < self.criteria.score(null)
        ]
        self._remember(out)
        return sorted(out, key=lambda f: f.sse)[:2]

    def _rounds(
        self, first: Fit, most: int, held: Sequence[Term], best: Fit | None = None, rounds: int = _ROUNDS
    ) -> Fit:
        """Linearise beside the best set, weigh all sets, fit the likeliest; again until nothing changes."""
        kept = Fit(first.terms, first.thetas) if held else Fit()
        smallest, best = first, first if best is None else best
        # How blocks contradict each other beside another start says nothing of this one.
        self.criteria.overdispersion = 1.0
        for _ in range(rounds):
            base = nuisances_at_prior(self.problem, best, curves=True)
            candidates = self._linearised(base, held)
            sets = likeliest_sets(candidates, self.criteria, most - len(held))
            chosen = self._to_fit(candidates, sets, len(best.terms) - len(held))
            fits = [self._fitted(candidates, c, kept, FEW_STEPS) for c in chosen]
            self._remember(fits)
            if not self.criteria.exact and fits:
                likeliest = min(fits, key=lambda f: f.sse)
                self.criteria.overdispersion = max(1.0, self.criteria.overdispersion_of(smallest, likeliest))
            better = min(self._cheapest(smallest, most), best, key=self.criteria.score)
            same = better.ids == best.ids and better.sse > best.sse - usual.search.as_good
            best = min(better, best, key=lambda f: f.sse) if same else better
            if same:
                break
        return best

    def _linearised(self, base: Fit, held: Sequence[Term]) -> Candidates:
        """Linearise the catalogue beside a fit, once for fits of the same set that are as good."""
        key = (base.ids, len(held))
        known = self._candidates.get(key)
        if known is None or abs(known.base.sse - base.sse) > max(
            usual.search.as_good, usual.search.as_good_share * base.sse
        ):
            known = Candidates(self.problem, self.terms, base, self.criteria.blocks(), held)
            self._candidates[key] = known
        return known

    def _to_fit(
        self, candidates: Candidates, sets: dict[int, list[tuple[Candidate, ...]]], now: int
    ) -> list[tuple[Candidate, ...]]:
        """Choose the sets that could be the best one: those of the size that is needed, and its
        neighbours'."""
        if not sets:
            return []
        needed, (before, *expected) = 0, candidates.expected([(), *(ranked[0] for ranked in sets.values())])
        for (size, ranked), after in zip(sets.items(), expected, strict=True):
            least = self.criteria.cost(min(candidate.dimension for candidate in ranked[0]), 1)
            if before - after > usual.search.hopeful * self.criteria.overdispersion * least:
                needed, before = size, after
        chosen: list[tuple[Candidate, ...]] = list(sets.get(needed, ()))
        for size in sets:
            if size != needed and (size <= needed + 1 or size == now):
                chosen += sets[size][:1]
        return chosen

    def _fitted(
        self, candidates: Candidates, chosen: tuple[Candidate, ...], held: Fit, iterations: int
    ) -> Fit:
        key = len(held.terms), iterations, chosen
        if key in self._fits:
            return self._fits[key]
        fit = self.problem.fit(candidates.start(chosen, held), iterations)
        if any(fit.sse > smaller.sse for ids, smaller in self.explored.items() if ids < fit.ids):
            # More effects leave no more: it has not come to its end yet.
            fit = self.problem.fit(fit, FEW_STEPS)
        known = self.explored.get(fit.ids)
        self._fits[key] = fit if known is None or fit.sse < known.sse else known
        return self._fits[key]

    def _cheapest(self, smallest: Fit, most: int) -> Fit:
        """Return the cheapest explored set of `most` effects at most that holds all of another one."""
        held = (fit for fit in self.explored.values() if smallest.ids <= fit.ids and len(fit.terms) <= most)
        return min([smallest, *held], key=self.criteria.score)

    def _remember(self, fits: Iterable[Fit]) -> None:
        for fit in fits:
            if fit.ids not in self.explored or fit.sse < self.explored[fit.ids].sse:
                self.explored[fit.ids] = fit

    def polished(self, fit: Fit, moments: bool = False) -> Fit:
        """Fit to convergence; look again for moments, places and frequencies beside the other effects, or for
        `moments` only."""
        if not fit.terms:
            return fit
        problem, cost = self.problem, self.criteria.score
        best = problem.refit(fit)
        for i, term in enumerate(best.terms):
            if term.effect.starts is None or term.effect.kind == "discrete":
                continue
            if moments and MOMENTS.isdisjoint(term.effect.names):
                continue
            for start in term.effect.starts(misfit_of(problem, problem.signals(best.without(i)))):
                if (np.abs(start - best.thetas[i]) <= usual.search.same * term.effect.scale).all():
                    continue
                trial = problem.fit(best.changed(i, term, start), FEW_STEPS)
                if cost(trial) < cost(best) - 1e-6:
                    best = problem.refit(trial)
        return self._timed(best)

    def _timed(self, fit: Fit) -> Fit:
        """Move moments of change to the readings between which least is left: no derivative leads there."""
        problem, best = self.problem, fit
        reading_s = float(np.median(np.diff(problem.replay.time_s[problem.index])))

        for i, (term, theta) in enumerate(zip(fit.terms, fit.thetas, strict=True)):
            for moment in np.flatnonzero([name in MOMENTS for name in term.effect.names]):
                if not term.lower[moment] < theta[moment] < term.upper[moment]:
                    continue
                unit = reading_s * np.eye(theta.size)[moment]
                least = problem.squares(best)
                for readings in (8, -8, 4, -4, 2, -2, 1, -1):
                    while True:
                        trial = best.changed(i, term, best.thetas[i] + readings * unit)
                        if (now := problem.squares(trial)) >= least:
                            break
                        best, least = trial, now
        return fit if best is fit else problem.refit(best)
