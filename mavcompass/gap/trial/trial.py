"""The blind trial: the diagnosis examined on cases whose labels were sealed before it ran."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mavcompass.errors import MavCompassError, UsageError
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.label import SHARES, Generator, Label, Tier
from mavcompass.gap.trial.score import Answer, Case, score, scoreboard, wilson
from mavcompass.gap.trial.sealed import read_case
from mavcompass.track import Track

SCHEMA = "mavcompass.gap-trial/1"


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
                    "true_shrink": c.true_shrink,
                    "own_separation": c.own_separation,
                    "truth_distance": c.truth_distance,
                    "seconds": c.answer.seconds,
                    "cpu_seconds": c.answer.cpu_seconds,
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
    """Seal cases in another process, diagnose them, then open the labels and score.

    Raises UsageError for a tier that the generator does not have, MavCompassError where the cases could not
    be made or the seal does not fit the labels.
    """
    if tier is not None and tier not in SHARES[generator]:
        raise UsageError(
            f"The generator {generator!r} has no tier {tier!r}.", f"Choose of {', '.join(SHARES[generator])}."
        )
    with tempfile.TemporaryDirectory(prefix="mavcompass-trial-") as name:
        folder = Path(name)
        command = [sys.executable, "-m", "mavcompass.gap.trial", str(folder), "--cases", str(cases)]
        command += ["--generator", generator, "--seed", str(seed), *(["--tier", tier] if tier else [])]
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
            answers.append(_answer(track, baseline))
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
                withheld = _answer(track, baseline, label.ids)
            scored.append(score(label, answer, withheld))
    return Trial(seed, seal, hashed, tuple(scored), generator)


def _label(entry: dict[str, object]) -> Label:
    values = dict(entry)
    values["effects"] = tuple(values["effects"])  # type: ignore[arg-type]
    return Label(**values)  # type: ignore[arg-type]


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
