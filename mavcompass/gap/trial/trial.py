"""The blind trial: the diagnosis examined on cases whose labels were sealed before it ran, and its scores."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mavcompass.blas import single_thread
from mavcompass.chance import wilson
from mavcompass.errors import UsageError
from mavcompass.frames import FloatArray
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import (
    SHARES,
    Generator,
    Label,
    Tier,
    affected,
    draw_case,
    recipe_of,
    stimulus_of,
    tracks_of,
)
from mavcompass.gap.trial.distance import akin, apart
from mavcompass.printable import plain
from mavcompass.simulation.effects import parse
from mavcompass.simulation.physics.signals import ideal
from mavcompass.track import Track

_NOT_SURE = ("unknown", "ambiguous", "named_with_remainder")


@dataclass(frozen=True, slots=True)
class Answer:
    """Hold what the diagnosis said of one case, before the label was opened.

    `residuals_mgauss` are those of the field without and with the named effects, (N, 3) each, `held_out` the
    rows that the closing was measured on, (N,).
    """

    verdict: str
    effects: tuple[str, ...]
    in_set: tuple[tuple[str, ...], ...]
    nominal: float
    after: float
    shrink: float
    shrink_ci95: tuple[float, float]
    seconds: float
    cpu_seconds: float = math.nan
    residuals_mgauss: tuple[FloatArray, FloatArray] | None = field(default=None, repr=False, compare=False)
    held_out: NDArray[np.bool_] | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Case:
    """Hold one scored case.

    Attributes:
        label: the truth; answer: with the whole catalogue; withheld: without the truth and its aliases.
        separation: d_sep in sigmas (single, pair) or d_perp (withheld, outside); nan where an effect only
            scatters or leaves traces, 0 where the flight cannot test it. In vehicles, beside the noise and
            priors of the diagnosis, from what the catalogue's own model makes of the truth: by what another
            make's model differs from that, no other effect is farther.
        own_separation: of a withheld case, d_sep from all others once it is restored.
        truth_distance: how far the catalogue's model of the truth stays from what another make's has done
            (of vehicles). nan where the flight cannot test it.
        exact, in_set: whether the answer names the truth, alone or among its set.
        true_shrink: what the named effects take away of the true gap, free of noise; nan where none is named.
        oracle_shrink: shrink of the answer over that of the true effect, on the same held-out rows. Both need
            the exact attitude that the diagnosis of the bench has: nan in vehicles.
    """

    label: Label
    answer: Answer
    withheld: Answer | None
    separation: float
    exact: bool
    in_set: bool
    oracle_shrink: float
    true_shrink: float = math.nan
    own_separation: float = math.nan
    truth_distance: float = math.nan

    @property
    def flagged(self) -> bool:
        """Tell whether the answer owns up to something that it does not know."""
        return self.answer.verdict in _NOT_SURE

    @property
    def wrong_name(self) -> bool:
        """Tell whether something is named, without remainder, that is neither the truth nor like it."""
        named = set(self.answer.effects) if self.answer.verdict == "named" else set()
        return not named <= akin(self.label.ids)


def score(label: Label, answer: Answer, withheld: Answer | None) -> Case:
    """Compare an answer with its label."""
    truth = label.ids
    exact = answer.effects == truth and answer.verdict in ("named", "ambiguous", "no_gap")
    in_set = exact or truth in {tuple(sorted(ids)) for ids in answer.in_set}
    separation = own = oracle = true_shrink = truth_distance = math.nan
    if label.effects:
        with single_thread():
            if label.generator == "bench":
                oracle, true_shrink = closing_of_the_truth(label, answer)
            label, separation, own, truth_distance = apart(label)
    return Case(label, answer, withheld, separation, exact, in_set, oracle, true_shrink, own, truth_distance)


def closing_of_the_truth(label: Label, answer: Answer) -> tuple[float, float]:
    """Return the shrink over the oracle's, and the true shrink; nan where neither is defined.

    The oracle is the true effect, without any fitting, on the same held-out rows. The true shrink is free
    of noise: 1 - |made - true|^2 / |nominal - true|^2 over all rows, with the noise of the case known.
    """
    if answer.verdict not in ("named", "ambiguous", "named_with_remainder"):
        return math.nan, math.nan
    settings = [parse(text) for text in label.effects]
    if any(s.effect.kind not in ("mean", "discrete") or s.effect.groups != ("mag",) for s in settings):
        return math.nan, math.nan
    replayed = replay(tracks_of(label)[0])
    test = answer.held_out
    if test is None:
        return math.nan, math.nan
    stimulus = stimulus_of(recipe_of(label))
    nominal = ideal(stimulus).mag_mgauss
    made = affected(stimulus, settings).mag_mgauss
    noise = replayed.measured.mag_mgauss - made
    left = float(np.mean(noise[test] ** 2))
    before = float(np.mean((noise + made - nominal)[test] ** 2))
    oracle = (answer.nominal**2 - answer.after**2) / (before - left) if before > left else math.nan
    if answer.residuals_mgauss is None:
        return oracle, math.nan
    unclosed, closed = (float(np.mean((r - noise)[replayed.valid] ** 2)) for r in answer.residuals_mgauss)
    return oracle, 1.0 - closed / unclosed if unclosed > 0.0 else math.nan


def scoreboard(cases: Sequence[Case]) -> dict[str, tuple[int, int]]:
    """Count the figures of a trial, stratified by separability."""

    def count(chosen: list[Case], hit: Callable[[Case], bool]) -> tuple[int, int]:
        return sum(map(hit, chosen)), len(chosen)

    def of(tier: Tier, low: float, high: float = math.inf) -> list[Case]:
        return [c for c in cases if c.label.tier == tier and low <= c.separation < high]

    none = [c for c in cases if c.label.tier == "none"]
    traces = [c for c in cases if c.label.tier == "single" and not math.isfinite(c.separation)]
    clear, middling, both = of("single", 9.0), of("single", 5.0, 9.0), of("pair", 9.0)
    new, outside = of("withheld", 12.0), of("outside", 12.0)
    told = [c for c in new if c.own_separation >= 9.0]
    oracle = [c for c in new if math.isfinite(c.oracle_shrink)]
    claimed = [c for c in cases if math.isfinite(c.true_shrink) and math.isfinite(c.answer.shrink_ci95[0])]
    return {
        "no effect: named or unknown": count(none, lambda c: c.answer.verdict != "no_gap"),
        "single, d_sep >= 9: exact": count(clear, lambda c: c.exact),
        "single, d_sep 5 to 9: in the set": count(middling, lambda c: c.in_set),
        "single without shift (noise, steps, repeats): exact": count(traces, lambda c: c.exact),
        "pair, both d_sep >= 9: exact": count(both, lambda c: c.exact),
        "pair, both d_sep >= 9: in the set": count(both, lambda c: c.in_set),
        "withheld, d_perp >= 12: flagged": count(
            new, lambda c: c.withheld is not None and c.withheld.verdict in _NOT_SURE
        ),
        "withheld, d_perp >= 12: misnamed": count(
            new, lambda c: c.withheld is not None and c.withheld.verdict == "named"
        ),
        "outside, d_perp >= 12: flagged": count(outside, lambda c: c.flagged),
        "outside, d_perp >= 12: misnamed": count(outside, lambda c: c.answer.verdict == "named"),
        "restored, d_perp >= 12 and d_sep >= 9: exact": count(told, lambda c: c.exact),
        "restored, d_perp >= 12: in the set": count(new, lambda c: c.in_set),
        "restored: within 5 % of the oracle": count(oracle, lambda c: abs(c.oracle_shrink - 1.0) <= 0.05),
        "shrink's interval covers the true shrink": count(
            claimed, lambda c: c.answer.shrink_ci95[0] <= c.true_shrink <= c.answer.shrink_ci95[1]
        ),
        "confident wrong names": count(list(cases), lambda c: c.wrong_name),
        "after above nominal": count(list(cases), lambda c: c.answer.after > c.answer.nominal * (1 + 1e-9)),
    }


SCHEMA = "mavcompass.gap-trial/1"
_OF_THE_ANSWER = ("verdict", "effects", "nominal", "after", "shrink", "shrink_ci95", "seconds", "cpu_seconds")
_OF_THE_CASE = (
    "separation", "exact", "in_set", "oracle_shrink", "true_shrink", "own_separation", "truth_distance",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Trial:
    """Hold a scored trial."""

    seed: int
    seal: str
    predictions_sha256: str
    cases: tuple[Case, ...]
    generator: Generator = "bench"

    def figures(self) -> dict[str, tuple[int, int]]:
        """Return counts (hits, of) of every figure."""
        return scoreboard(self.cases)

    def lines(self) -> list[str]:
        """Put the scoreboard in lines for a terminal."""
        lines = [f"{len(self.cases)} sealed cases, seed {self.seed}", f"labels sealed  {self.seal}"]
        lines.append(f"answers hashed {self.predictions_sha256}")
        for name, (hits, of) in self.figures().items():
            if not of:  # no case of its kind was drawn
                continue
            low, high = wilson(hits, of)
            share = 100.0 * hits / of
            lines.append(f"  {name}: {hits}/{of} = {share:.1f} % (95 % {100 * low:.1f} .. {100 * high:.1f})")
        for name, (median, p95) in self.seconds().items():
            lines.append(f"  {name} per case: median {median:.2f}, 95 % below {p95:.2f}")
        return lines

    def seconds(self) -> dict[str, tuple[float, float]]:
        """Return median and 95 % point of what a diagnosis takes, by the clock and of the processor."""
        taken = {
            "seconds": sorted(c.answer.seconds for c in self.cases),
            "CPU seconds": sorted(c.answer.cpu_seconds for c in self.cases),
        }
        return {
            name: (values[len(values) // 2], values[min(int(0.95 * len(values)), len(values) - 1)])
            for name, values in taken.items()
            if values
        }

    def to_json(self) -> dict[str, object]:
        """Return the machine-readable trial."""
        return {
            "schema": SCHEMA,
            "generator": self.generator,
            "seed": self.seed,
            "seal_sha256": self.seal,
            "predictions_sha256": self.predictions_sha256,
            "figures": {
                name: {"hits": hits, "of": of, "wilson95": list(wilson(hits, of))}
                for name, (hits, of) in self.figures().items()
            },
            "cpu_seconds": dict(zip(("median", "p95"), self.seconds()["CPU seconds"], strict=True)),
            "cases": [
                {
                    "tier": c.label.tier,
                    "motion": c.label.motion,
                    "truth": list(c.label.effects),
                    "size_sigma": c.label.size_sigma,
                    "verdict_withheld": c.withheld.verdict if c.withheld else None,
                    "effects_withheld": list(c.withheld.effects) if c.withheld else None,
                    **{name: plain(getattr(c.answer, name)) for name in _OF_THE_ANSWER},
                    **{name: getattr(c, name) for name in _OF_THE_CASE},
                }
                for c in self.cases
            ],
        }


def run_trial(
    cases: int,
    seed: int,
    tier: Tier | None = None,
    generator: Generator = "bench",
) -> Trial:
    """Publish the hash of all labels, with salt; diagnose each case, drawn anew without its label; score.

    Raises UsageError for a tier that the generator does not have.
    """
    if tier is not None and tier not in SHARES[generator]:
        raise UsageError(
            f"The generator {generator!r} has no tier {tier!r}.", f"Choose of {', '.join(SHARES[generator])}."
        )
    draw = partial(draw_case, generator)
    labels = [draw(seed, index, tier)[0] for index in range(cases)]
    text = json.dumps({"salt": secrets.token_hex(16), "labels": [asdict(label) for label in labels]})
    seal = hashlib.sha256(text.encode()).hexdigest()
    answers = []
    for index in range(cases):
        _, track, baseline = draw(seed, index, tier)
        answers.append(_answer(untold(track), untold(baseline)))
    hashed = hashlib.sha256(repr(answers).encode()).hexdigest()
    scored = []
    for index, (label, answer) in enumerate(zip(labels, answers, strict=True)):
        withheld = None
        if label.tier == "withheld":
            _, track, baseline = draw(seed, index, tier)
            withheld = _answer(untold(track), untold(baseline), label.ids)
        scored.append(score(label, answer, withheld))
    return Trial(seed, seal, hashed, tuple(scored), generator)


def untold(track: Track) -> Track:
    """Return a recording without its true attitude, and without a word of who made it."""
    return replace(track, source="case", truth_q=None, notes=())


def _answer(track: Track, baseline: Track, withhold: tuple[str, ...] = ()) -> Answer:
    started = time.process_time()
    d = diagnose_gap(track, baseline, withhold)
    taken = time.process_time() - started
    return Answer(
        verdict=d.verdict,
        effects=tuple(sorted(d.effects)),
        in_set=tuple(ids for ids, _ in d.ambiguity_set),
        nominal=d.field.nominal,
        after=d.field.after,
        shrink=d.field.shrink,
        shrink_ci95=d.field.shrink_ci95,
        seconds=d.seconds,
        cpu_seconds=taken,
        residuals_mgauss=(d.picture.before_mgauss, d.picture.after_mgauss)
        if d.picture is not None and d.causes
        else None,
        held_out=d.picture.test if d.picture is not None else None,
    )
