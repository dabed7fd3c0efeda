"""The blind trial: the diagnosis examined on cases whose labels were sealed before it ran."""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial

from mavcompass.chance import wilson
from mavcompass.errors import UsageError
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.result import plain
from mavcompass.gap.trial import cases as bench
from mavcompass.gap.trial import foreign
from mavcompass.gap.trial.cases import SHARES, Generator, Tier
from mavcompass.gap.trial.score import Answer, Case, score, scoreboard
from mavcompass.track import Track

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
    progress: Callable[[int], None] | None = None,
    generator: Generator = "bench",
) -> Trial:
    """Publish the hash of all labels, with salt; diagnose each case, drawn anew without its label; score.

    Raises UsageError for a tier that the generator does not have.
    """
    if tier is not None and tier not in SHARES[generator]:
        raise UsageError(
            f"The generator {generator!r} has no tier {tier!r}.", f"Choose of {', '.join(SHARES[generator])}."
        )
    draw = bench.draw_case if generator == "bench" else partial(foreign.draw_case, generator)
    labels = [draw(seed, index, tier)[0] for index in range(cases)]
    text = json.dumps({"salt": secrets.token_hex(16), "labels": [asdict(label) for label in labels]})
    seal = hashlib.sha256(text.encode()).hexdigest()
    answers = []
    for index in range(cases):
        _, track, baseline = draw(seed, index, tier)
        answers.append(_answer(untold(track), untold(baseline)))
        if progress is not None:
            progress(index + 1)
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
