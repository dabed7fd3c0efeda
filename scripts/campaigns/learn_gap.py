"""Make the tables of the gap's criterion anew: `params/gap/criterion.json`.

    nice -n 10 .venv/bin/python scripts/campaigns/learn_gap.py --evidence evidence.json --write
    .venv/bin/python scripts/campaigns/learn_gap.py --evidence evidence.json --picture reliability.svg

Where the evidence lacks cases they are made from their seeds and examined: vehicles of two makers are
learnt from, with and without a baseline; a third maker's only judge. Printed are how reliable the stated
probability is, out of fold and on the third maker's, false alarms with Wilson's bounds, and how each
effect fares. The same evidence makes the same file.
"""

from __future__ import annotations

import collections
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from campaign import ended, options, share, tried

from mavcompass.frames import FloatArray
from mavcompass.gap.answer.evidence import figures, statistics
from mavcompass.gap.diagnose import examine, withheld_effects
from mavcompass.gap.tables import KINDS, OUTCOMES, SCHEMA, Penalty, ProbabilityMap, parsed
from mavcompass.gap.trial.cases import Label, case_of, draw_case
from mavcompass.gap.trial.trial import Answer, score
from mavcompass.installation.parts import params_path

# What is learnt from, and what judges: maker, tier, with a baseline, first seed, how many.
LOT: tuple[tuple[str, str, bool, int, int], ...] = (
    ("vehicles", "none", True, 941000, 80),
    ("vehicles", "none", True, 942000, 160),
    ("vehicles", "single", True, 941000, 80),
    ("vehicles", "pair", True, 941000, 40),
    ("vehicles", "outside", True, 941000, 40),
    ("vehicles", "withheld", True, 946000, 24),
    ("vehicles", "none", False, 944000, 40),
    ("vehicles", "none", False, 945000, 60),
    ("vehicles", "single", False, 944000, 32),
    ("vehicles", "pair", False, 944000, 16),
    ("vehicles", "outside", False, 944000, 20),
    *(("bench", "none", True, 9421 + k, 7) for k in range(4)),
    *(("bench", "single", True, 9421 + k, 9) for k in range(4)),
    *(("bench", "pair", True, 9421 + k, 6) for k in range(4)),
    ("bench", "withheld", True, 9460, 40),
    *(("bench", "none", False, 9440 + k, 25) for k in range(2)),
    *(("bench", "single", False, 9440 + k, 15) for k in range(2)),
    *(("bench", "pair", False, 9440 + k, 10) for k in range(2)),
    ("another", "none", True, 943000, 32),
    ("another", "single", True, 943000, 48),
    ("another", "pair", True, 943000, 28),
)
JUDGES = "another"
# What a parameter costs, in ln n, and an effect: of those that choose best a middle one; others to compare.
# Where the attitude is independent chance gains no more than the noise makes.
PENALTY: dict[str, tuple[float, float]] = {
    "exact": (1.0, 10.0),
    "baseline": (1.5, 40.0),
    "reference": (1.0, 10.0),
    "alone": (1.0, 20.0),
}
OTHERS = [(a, b) for a in (0.5, 1.0, 1.5, 2.0) for b in (5.0, 10.0, 20.0, 30.0, 40.0, 60.0)]
# All thresholds of decision (gap/tables.py): chosen rates of false alarms, and limits of what is reported.
LEVELS = {"gain": 0.01, "fit": 0.005, "sure": 0.9, "above": 1.3, "held": 0.9, "coarsest_deg": 15.0}
# What the map and the score of healthy vehicles are made of (gap/answer/evidence.py).
MAPPED = (
    "lead", "residual", "held_out", "structure", "strain", "confirmed", "members", "unlikely", "exact",
    "alone",
)  # fmt: skip
LEFT = ("residual", "fitted", "held_out", "structure", "strain", "field", "heading")
# Ridge of the standardised weights; folds; the least size of a statistic's spread.
RIDGE, FOLDS, LEAST = 1.0, 5, 0.05
# What is nearer, in sigmas, nobody could tell: d_perp, and d_sep of the lesser of a pair.
APART = {"outside": 12.0, "withheld": 12.0, "pair": 5.0}
# A tenth of the values of healthy vehicles, the largest, is kept.
KEPT = 10

Line = dict[str, Any]


class Wanted(NamedTuple):
    """Name a case to be made."""

    maker: str
    tier: str
    with_baseline: bool
    seed: int
    index: int


def main() -> int:
    """Make what is lacking, learn, and tell how reliable it is."""
    wanted = options(
        __doc__,
        evidence=(Path, "made where it lacks cases"),
        workers=2,
        write=(False, "write params/gap/criterion.json"),
        every=(1, "a try, with every so many of the cases"),
        picture=(Path, "write the reliability diagram"),
    )
    if wanted.evidence is None or (wanted.write and wanted.every != 1):
        sys.exit("Give --evidence FILE; the tables are made of all cases: --write goes without --every.")
    lines = collected(wanted.evidence, wanted.workers, wanted.every)
    learnt = [line for line in lines if line["maker"] != JUDGES]
    judged = [line for line in lines if line["maker"] == JUDGES]
    penalties(learnt)
    document = learn(learnt, lines)
    told = probabilities(parsed(document).map, judged)
    bins = report("out of fold", learnt, out_of_fold(learnt))
    bins += report(f"on {JUDGES!r}, which nothing was learnt from", judged, told)
    false_alarms(lines, document)
    if wanted.picture:
        wanted.picture.write_text(drawn(bins), encoding="utf-8")
    if wanted.write:
        ended(params_path("gap/criterion.json"), document, wrong=False)
    return ended(wanted.json, document, wrong=False)


def collected(path: Path, workers: int, every: int = 1) -> list[Line]:
    """Read the evidence, and make what it lacks."""
    known: list[Line] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    have = {json.dumps(line["case"]) for line in known}
    lot = (Wanted(*kind, index) for *kind, count in LOT for index in range(0, count, every))
    missing = [one for one in lot if json.dumps(one) not in have]
    for done, line in enumerate(tried(examined, missing, workers=workers, every=20), 1):
        known += [line] if line is not None else []
        if done % 20 == 0 or done == len(missing):
            path.write_text(json.dumps(known), encoding="utf-8")
    return known


def examined(of: Wanted) -> Line | None:
    """Make a case, examine it, keep what is to be learnt from; None where a calibration does not cure it.

    Of what is withheld the truth, and all that looks like it, may not be used.
    """
    if of.maker == "bench":
        label, track, baseline = draw_case("bench", of.seed, of.index, of.tier)  # type: ignore[arg-type]
        cured = True
    else:
        case = case_of(of.maker, of.tier, of.seed + of.index)  # type: ignore[arg-type]
        track, baseline = case.track, case.baseline
        cured = case.vehicle is None or case.vehicle.cure != "old"
        spelt = (
            f"{name}:" + ",".join(f"{key}={value:.9g}" for key, value in values.items())
            for name, values in case.effects
        )
        label = Label(of.tier, "", of.seed + of.index, tuple(spelt), generator=of.maker)  # type: ignore[arg-type]
    if not (of.with_baseline or cured):
        return None
    withheld = withheld_effects(label.ids) if of.tier == "withheld" else frozenset()
    evidence = examine(track, baseline if of.with_baseline else None, withheld)
    if evidence.frozen:
        return None
    posterior = evidence.identified.posterior
    known = statistics(evidence, *figures(evidence, evidence.identified.fit, with_scatter=True))
    nothing = Answer("unknown", (), (), 1.0, 1.0, 0.0, (0.0, 0.0), 1.0)
    return {
        "case": list(of), "maker": of.maker, "tier": of.tier, "truth": list(label.ids),
        "beside": sorted(evidence.beside_ids), "kind": known.kind, "gain": known.gain,
        "found": bool(posterior.best.fit.terms or evidence.beside_ids),
        "values": known.values, "rows": evidence.identified.first.count,
        "overdispersion": posterior.overdispersion,
        "separation": score(label, nothing, None).separation if of.tier in APART else None,
        "sets": [
            {"ids": sorted(e.fit.ids), "sse": e.fit.sse, "strain": e.mahalanobis2, "d": e.fit.dimension,
             "same": posterior.restates(e)}
            for e in posterior.explanations
        ],
    }  # fmt: skip


def outcome(line: Line) -> str:
    """Tell what the best set is of the truth. Sets that are the same in more words are one answer."""
    if line["tier"] in ("none", "outside", "withheld"):
        return "unknown"
    truth, beside = set(line["truth"]), set(line["beside"])
    best, *rest = ({*one["ids"], *beside} for one in line["sets"])
    same = [ids for ids, one in zip(rest, line["sets"][1:], strict=True) if one["same"]]
    if truth in (best, *same):
        return "whole"
    if best and best < truth:
        return "part"
    return "other" if truth in rest else "unknown"


def told_apart(line: Line) -> bool:
    """Tell whether anybody could know better.

    Nothing outside the catalogue is told from a set of it that makes the same within `APART` sigmas, nor a
    member of a pair that shows by less.
    """
    near = line["separation"]
    if near is None or not math.isfinite(near):
        return True
    asked = line["tier"] != "pair" or outcome(line) == "part"
    return not asked or bool(near >= APART[line["tier"]])


def learn(learnt: Sequence[Line], lines: Sequence[Line]) -> Line:
    """Make the tables. Healthy vehicles of all makers count in the p values, which nothing is fitted to."""
    known = fitted([line for line in learnt if line["found"] and told_apart(line)])
    return {
        "schema": SCHEMA,
        "made": {
            "by": "scripts/campaigns/learn_gap.py",
            "cases": dict(sorted(collections.Counter(f"{x['maker']} {x['tier']}" for x in lines).items())),
            "lot": [list(one) for one in LOT],
        },
        "penalty": {kind: {"parameter": a, "effect": b} for kind, (a, b) in PENALTY.items()},
        "levels": LEVELS,
        "healthy": healthy(_healthy(lines)),
        "map": {
            "names": list(known.names), "centre": _rounded(known.centre), "size": _rounded(known.size),
            "weights": [_rounded(row) for row in known.weights],
        },
    }  # fmt: skip


def _healthy(lines: Sequence[Line]) -> list[Line]:
    return [line for line in lines if line["tier"] == "none"]


def penalties(lines: Sequence[Line]) -> None:
    """Print how many choices are exact with other penalties, healthy ones counted three times.

    The statistics are those of the sets that are best with the one in force.
    """
    for kind in KINDS:
        own = [line for line in lines if line["kind"] == kind]
        scores = {
            pair: sum(3 if x["tier"] == "none" else 1 for x in own if _chosen(x, pair) == set(x["truth"]))
            for pair in OTHERS
        }
        print(f"exact choices, {kind}, {PENALTY[kind]}: {scores[PENALTY[kind]]}; others {scores}")


def _chosen(line: Line, pair: tuple[float, float]) -> set[str]:
    def cost(one: Line) -> float:
        free = (one["sse"] - one["strain"]) / line["overdispersion"] + one["strain"]
        return float(free + Penalty(*pair).of(one["d"], len(one["ids"]), line["rows"]))

    return {*min(line["sets"], key=cost)["ids"], *line["beside"]}


def healthy(lines: Sequence[Line]) -> Line:
    """Describe what healthy vehicles show: what is usual by kind, and the largest of all."""
    usual, scores = {}, []
    for kind in KINDS:
        own = [line for line in lines if line["kind"] == kind]
        if not own:  # of a try
            continue
        values = np.array([[line["values"][name] for name in LEFT] for line in own])
        centre = np.median(values, axis=0)
        size = np.maximum(np.percentile(values, 84, axis=0) - centre, LEAST)
        scores += ((values - centre) / size).max(axis=1).tolist()
        usual[kind] = {"count": len(own), "centre": _rounded(centre), "size": _rounded(size)}
    kept = max(len(lines) // KEPT, 1)
    return {
        "count": len(lines),
        "names": list(LEFT),
        "usual": usual,
        "gains": _rounded(np.sort([line["gain"] for line in lines])[-kept:]),
        "scores": _rounded(np.sort(scores)[-kept:]),
    }


def fitted(lines: Sequence[Line]) -> ProbabilityMap:
    """Fit the logistic map from statistics to outcomes, with a ridge."""
    from scipy.optimize import minimize

    values = np.array([[line["values"][name] for name in MAPPED] for line in lines])
    centre, size = values.mean(axis=0), np.maximum(values.std(axis=0), LEAST)
    x = np.column_stack([np.ones(len(lines)), (values - centre) / size])
    y = np.eye(len(OUTCOMES))[[OUTCOMES.index(outcome(line)) for line in lines]]  # type: ignore[arg-type]
    ridge = np.concatenate([[1e-3], np.full(len(MAPPED), RIDGE)])[:, np.newaxis]

    def loss(flat: FloatArray) -> tuple[float, FloatArray]:
        weights = flat.reshape(x.shape[1], -1)
        scores = x @ weights
        scores -= scores.max(axis=1, keepdims=True)
        log_p = scores - np.log(np.exp(scores).sum(axis=1, keepdims=True))
        slope = x.T @ (np.exp(log_p) - y) + ridge * weights
        return float(-(y * log_p).sum() + 0.5 * (ridge * weights**2).sum()), slope.ravel()

    solved = minimize(loss, np.zeros(x.shape[1] * y.shape[1]), jac=True, method="L-BFGS-B")
    return ProbabilityMap(MAPPED, centre, size, solved.x.reshape(x.shape[1], -1))


def probabilities(known: ProbabilityMap, lines: Sequence[Line]) -> FloatArray:
    """Return what a map says of each line, (N, outcomes)."""
    return np.array([list(known.probabilities(line["values"]).values()) for line in lines])


def out_of_fold(lines: Sequence[Line]) -> FloatArray:
    """Return what maps say of lines that they were not learnt from."""
    fold = np.random.default_rng(0).permutation(len(lines)) % FOLDS
    said = np.zeros((len(lines), len(OUTCOMES)))
    for k in range(FOLDS):
        others = [x for x, f in zip(lines, fold, strict=True) if f != k and x["found"] and told_apart(x)]
        own = np.flatnonzero(fold == k)
        said[own] = probabilities(fitted(others), [lines[i] for i in own])
    return said


def report(title: str, lines: Sequence[Line], said: FloatArray) -> list[tuple[str, float, float, int]]:
    """Print the reliability of the best set's probability, and how each effect fares; return the bins."""
    found = np.array([line["found"] and told_apart(line) for line in lines])
    stated = said[found, OUTCOMES.index("whole")]
    true = np.array([outcome(line) == "whole" for line in lines])[found]
    print(f"{title}: {found.sum()} sets, Brier {np.mean((stated - true) ** 2):.3f}")
    bins = []
    for low, high in ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 1.01)):
        rows = (stated >= low) & (stated < high)
        if rows.any():
            hits, of = int(true[rows].sum()), int(rows.sum())
            print(f"  stated {stated[rows].mean():.2f}: true {share(hits, of)}")
            bins.append((title, float(stated[rows].mean()), hits / of, of))
    per: dict[str, list[bool]] = collections.defaultdict(list)
    for line in lines:
        if line["tier"] == "single":
            per[line["truth"][0]].append(outcome(line) == "whole")
    fares = (f"{name} {sum(hits)}/{len(hits)}" for name, hits in sorted(per.items()))
    print("  the best set is the truth, or the same:", ", ".join(fares))
    return bins


def false_alarms(lines: Sequence[Line], document: Line) -> None:
    """Print how many healthy vehicles fail one of the two tests; each is one of the population itself."""
    known = parsed(document).healthy

    def alarmed(line: Line) -> bool:
        score = known.score(line["kind"], line["values"])
        tests = ((line["gain"], known.gains, "gain"), (score, known.scores, "fit"))
        return any(
            np.sum(most >= one - 1e-4) / (1 + known.count) <= LEVELS[name] for one, most, name in tests
        )

    for kind in KINDS:
        own = [line for line in _healthy(lines) if line["kind"] == kind]
        found = [line for line in own if alarmed(line)]
        print(f"healthy, {kind}: {share(len(found), len(own))} alarmed")
        for one in found:
            print("   ", one["case"], one["sets"][0]["ids"], f"gain {one['gain']:.0f}")


def drawn(bins: Sequence[tuple[str, float, float, int]]) -> str:
    """Draw stated against true shares."""
    colours = dict(zip(dict.fromkeys(title for title, *_ in bins), ("#2b6cb0", "#c05621"), strict=False))
    discs = "".join(
        f'<circle cx="{40 + 320 * stated:.1f}" cy="{360 - 320 * true:.1f}" r="{3 + math.sqrt(of):.1f}"'
        f' fill="{colours[title]}" fill-opacity="0.6"><title>{title}: {of}</title></circle>'
        for title, stated, true, of in bins
    )
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 400 400" font-family="sans-serif"'
        ' font-size="12">'
        '<path d="M40 360H360M40 360V40M40 360L360 40" stroke="#888" fill="none"/>'
        '<text x="150" y="390">stated probability</text>'
        f'<text x="5" y="30">share that is true</text>{discs}</svg>\n'
    )


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 4) for value in values]


if __name__ == "__main__":
    sys.exit(main())
