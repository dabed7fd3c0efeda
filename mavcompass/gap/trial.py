"""The blind trial: the diagnosis examined on cases whose labels were sealed before it ran."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mavcompass.errors import MavCompassError
from mavcompass.gap.blas import single_thread
from mavcompass.gap.cases import Recipe, ideal, stimulus_of, to_track
from mavcompass.gap.diagnose import diagnose_gap, withheld_effects
from mavcompass.gap.model import Problem
from mavcompass.gap.noise import Noise, SensorNoise
from mavcompass.gap.replay import replay
from mavcompass.gap.result import Diagnosis
from mavcompass.gap.sealed import Label, read_case
from mavcompass.gap.search import Search
from mavcompass.gap.split import split_blocks
from mavcompass.simulation.effects import Distortion, catalogue, parse
from mavcompass.simulation.effects.effect import Effect

SCHEMA = "mavcompass.gap-trial/1"
_NOISE: Noise = {
    "mag": SensorNoise(np.array([0.3]), np.full(3, 3.0 * math.sqrt(0.91)), np.full(3, 3.0), 6000.0),
    "acc": SensorNoise(np.zeros(0), np.full(3, 0.03), np.full(3, 0.03), 6000.0),
    "gyro": SensorNoise(np.zeros(0), np.full(3, 0.003), np.full(3, 0.003), 6000.0),
}


@dataclass(frozen=True, slots=True)
class Answer:
    """Hold what the diagnosis said of one case, before the label was opened."""

    verdict: str
    effects: tuple[str, ...]
    in_set: tuple[tuple[str, ...], ...]
    nominal: float
    after: float
    shrink: float
    shrink_ci95: tuple[float, float]
    seconds: float


@dataclass(frozen=True, slots=True)
class Case:
    """Hold one scored case.

    Attributes:
        label: the truth; answer: with the whole catalogue; withheld: without the truth and its aliases.
        separation: d_sep in sigmas (single) or d_perp (withheld); nan where it was not computed.
        exact, in_set: whether the answer names the truth, alone or among its set.
        oracle_shrink: shrink of the answer over that of the true effect, on the same held-out rows.
    """

    label: Label
    answer: Answer
    withheld: Answer | None
    separation: float
    exact: bool
    in_set: bool
    oracle_shrink: float


@dataclass(frozen=True, slots=True)
class Trial:
    """Hold a scored trial."""

    seed: int
    seal: str
    predictions_sha256: str
    cases: tuple[Case, ...]

    def figures(self) -> dict[str, tuple[int, int]]:
        """Return counts (hits, of) of every figure."""
        return scoreboard(self.cases)

    def lines(self) -> list[str]:
        """Put the scoreboard in lines for a terminal."""
        lines = [f"{len(self.cases)} sealed cases, seed {self.seed}", f"labels sealed  {self.seal}"]
        lines.append(f"answers hashed {self.predictions_sha256}")
        for name, (hits, of) in self.figures().items():
            low, high = wilson(hits, of)
            share = 100.0 * hits / of if of else math.nan
            lines.append(f"  {name}: {hits}/{of} = {share:.1f} % (95 % {100 * low:.1f} .. {100 * high:.1f})")
        seconds = sorted(c.answer.seconds for c in self.cases)
        if seconds:
            p95 = seconds[min(int(0.95 * len(seconds)), len(seconds) - 1)]
            lines.append(f"  seconds per case: median {seconds[len(seconds) // 2]:.2f}, 95 % below {p95:.2f}")
        return lines

    def to_json(self) -> dict[str, object]:
        """Return the machine-readable trial."""
        return {
            "schema": SCHEMA,
            "seed": self.seed,
            "seal_sha256": self.seal,
            "predictions_sha256": self.predictions_sha256,
            "figures": {
                name: {"hits": hits, "of": of, "wilson95": list(wilson(hits, of))}
                for name, (hits, of) in self.figures().items()
            },
            "cases": [
                {
                    "tier": c.label.tier,
                    "motion": c.label.motion,
                    "truth": list(c.label.effects),
                    "size_sigma": c.label.size_sigma,
                    "separation": c.separation,
                    "verdict": c.answer.verdict,
                    "effects": list(c.answer.effects),
                    "exact": c.exact,
                    "in_set": c.in_set,
                    "verdict_withheld": c.withheld.verdict if c.withheld else None,
                    "effects_withheld": list(c.withheld.effects) if c.withheld else None,
                    "nominal": c.answer.nominal,
                    "after": c.answer.after,
                    "shrink": c.answer.shrink,
                    "shrink_ci95": list(c.answer.shrink_ci95),
                    "oracle_shrink": c.oracle_shrink,
                    "seconds": c.answer.seconds,
                }
                for c in self.cases
            ],
        }


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    if of == 0:
        return (0.0, 1.0)
    z, p = 1.96, hits / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return (max(middle - half, 0.0), min(middle + half, 1.0))


def run_trial(
    cases: int, seed: int, tier: str | None = None, progress: Callable[[int], None] | None = None
) -> Trial:
    """Seal cases in another process, diagnose them, then open the labels and score.

    Raises MavCompassError where the cases could not be made or the seal does not fit the labels.
    """
    with tempfile.TemporaryDirectory(prefix="mavcompass-trial-") as name:
        folder = Path(name)
        command = [sys.executable, "-m", "mavcompass.gap.sealed", str(folder), "--cases", str(cases)]
        command += ["--seed", str(seed), *(["--tier", tier] if tier else [])]
        made = subprocess.run(command, capture_output=True, text=True, check=False)
        if made.returncode:
            raise MavCompassError(
                f"The sealed cases could not be made: {made.stderr.strip()[-300:]}",
                "Check that the temporary folder has space.",
            )
        seal = (folder / "seal").read_text(encoding="utf-8").strip()
        answers = []
        for index in range(cases):
            track, baseline = read_case(folder / f"{index:04d}.npz")
            answers.append(_answer(diagnose_gap(track, baseline)))
            if progress is not None:
                progress(index + 1)
        hashed = hashlib.sha256(repr(answers).encode()).hexdigest()
        text = (folder / "labels.json").read_text(encoding="utf-8")
        if hashlib.sha256(text.encode()).hexdigest() != seal:
            raise MavCompassError(
                "The labels do not have the hash they were sealed with.", "Run the trial again."
            )
        labels = [_label(entry) for entry in json.loads(text)["labels"]]
        scored = []
        for index, (label, answer) in enumerate(zip(labels, answers, strict=True)):
            withheld = None
            if label.tier == "withheld":
                track, baseline = read_case(folder / f"{index:04d}.npz")
                names = [parse(t).effect.id for t in label.effects]
                withheld = _answer(diagnose_gap(track, baseline, names))
            scored.append(score(label, answer, withheld))
    return Trial(seed, seal, hashed, tuple(scored))


def _label(entry: dict[str, object]) -> Label:
    values = dict(entry)
    values["effects"] = tuple(values["effects"])  # type: ignore[arg-type]
    return Label(**values)  # type: ignore[arg-type]


def _answer(d: Diagnosis) -> Answer:
    return Answer(
        verdict=d.verdict,
        effects=tuple(sorted(d.effects)),
        in_set=tuple(ids for ids, _ in d.ambiguity_set),
        nominal=d.field.nominal,
        after=d.field.after,
        shrink=d.field.shrink,
        shrink_ci95=d.field.shrink_ci95,
        seconds=d.seconds,
    )


def score(label: Label, answer: Answer, withheld: Answer | None) -> Case:
    """Compare an answer with its label."""
    truth = tuple(sorted(parse(text).effect.id for text in label.effects))
    exact = answer.effects == truth and answer.verdict in ("named", "ambiguous", "no_gap")
    in_set = exact or truth in {tuple(sorted(ids)) for ids in answer.in_set}
    separation = math.nan
    oracle = math.nan
    if label.effects:
        with single_thread():
            removed = withheld_effects(truth) if label.tier == "withheld" else frozenset(truth)
            separation = distance_to_others(
                label, removed, most=3 if label.tier == "withheld" else len(truth)
            )
            oracle = shrink_over_oracle(label, answer)
    return Case(label, answer, withheld, separation, exact, in_set, oracle)


def distance_to_others(label: Label, removed: frozenset[str], most: int) -> float:
    """Return how far, in sigmas of the whole recording, the case is from what other effects can make.

    For a pair it is the lesser of the two distances with one member removed.
    """
    truth = [parse(text) for text in label.effects]
    if any(s.effect.kind not in ("mean", "discrete") for s in truth):
        return math.nan
    if label.tier == "pair":
        return min(_distance(label, frozenset({s.effect.id}), most) for s in truth)
    return _distance(label, removed, most)


def _distance(label: Label, removed: frozenset[str], most: int) -> float:
    stimulus = stimulus_of(Recipe(label.motion, seed=label.seed))
    settings = [parse(text) for text in label.effects]
    reading = Distortion(settings).apply(stimulus, ideal(stimulus), np.random.default_rng(0))
    replayed = replay(to_track(stimulus, reading))
    problem = Problem(replayed, _NOISE, replayed.valid, ())
    others: list[Effect] = [e for e in catalogue().values() if e.id not in removed]
    search = Search(problem, others)
    return math.sqrt(max(search.nearest(most).sse, 0.0))


def shrink_over_oracle(label: Label, answer: Answer) -> float:
    """Return the fall of the mean square that was reached over that which the true effects reach.

    Both on the same held-out rows of the case, the truth's without any fitting.
    """
    from mavcompass.gap.sealed import tracks_of

    if answer.verdict not in ("named", "ambiguous", "named_with_remainder"):
        return math.nan
    settings = [parse(text) for text in label.effects]
    if any(s.effect.kind not in ("mean", "discrete") for s in settings):
        return math.nan
    if not all(s.effect.groups == ("mag",) for s in settings):
        return math.nan
    replayed = replay(tracks_of(label)[0])
    test = split_blocks(replayed.time_s, replayed.valid).test
    stimulus = stimulus_of(Recipe(label.motion, seed=label.seed))
    made = Distortion(settings).apply(stimulus, ideal(stimulus), np.random.default_rng(0))
    measured = replayed.measured.mag_mgauss[test]
    left = float(np.mean((measured - made.mag_mgauss[test]) ** 2))
    before = float(np.mean((measured - ideal(stimulus).mag_mgauss[test]) ** 2))
    if before <= left:
        return math.nan
    return (answer.nominal**2 - answer.after**2) / (before - left)


def scoreboard(cases: Sequence[Case]) -> dict[str, tuple[int, int]]:
    """Count the figures of a trial, stratified by separability."""

    def count(chosen: list[Case], hit: Callable[[Case], bool]) -> tuple[int, int]:
        return sum(map(hit, chosen)), len(chosen)

    none = [c for c in cases if c.label.tier == "none"]
    single = [c for c in cases if c.label.tier == "single" and math.isfinite(c.separation)]
    traces = [c for c in cases if c.label.tier == "single" and not math.isfinite(c.separation)]
    pairs = [c for c in cases if c.label.tier == "pair"]
    withheld = [c for c in cases if c.label.tier == "withheld"]
    clear = [c for c in single if c.separation >= 9.0]
    middling = [c for c in single if 5.0 <= c.separation < 9.0]
    both = [c for c in pairs if c.separation >= 9.0]
    new = [c for c in withheld if c.separation >= 12.0]
    oracle = [c for c in new if math.isfinite(c.oracle_shrink)]
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
        "restored, d_perp >= 12: exact": count(new, lambda c: c.exact),
        "restored: within 5 % of the oracle": count(oracle, lambda c: abs(c.oracle_shrink - 1.0) <= 0.05),
        "after above nominal": count(list(cases), lambda c: c.answer.after > c.answer.nominal * (1 + 1e-9)),
    }


_NOT_SURE = ("unknown", "ambiguous", "named_with_remainder")
