"""Put the answers into tables, and say where mavcompass is not first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compassbench.cases import KINDS
from compassbench.judge import RIGHT_DEG
from compassbench.rivals import RIVALS

Answers = Sequence[dict[str, Any]]
BEGIN, END = "<!-- made by scripts/bench world -- --docs -->\n", "<!-- end -->"


def outcome(answer: dict[str, Any]) -> str:
    """Say what became of a calibration."""
    if "crashed" in answer:
        return "crashed"
    if "refused" in answer:
        return "refused wrongly" if answer["answerable"] else "refused rightly"
    return "right" if answer["rms"] <= RIGHT_DEG else "wrong"


def of(answers: Answers) -> str:
    """Return all tables as Markdown."""
    parts = [
        _calibration(answers),
        _by_kind(answers),
        _headings(answers),
        _gaps(answers),
        _not_first(answers),
    ]
    return "\n".join(part for part in parts if part)


def put_into(page: Path, words: str) -> None:
    """Replace what stands between the marks of a page."""
    before, rest = page.read_text("utf-8").split(BEGIN, 1)
    page.write_text(f"{before}{BEGIN}\n{words}\n{END}{rest.split(END, 1)[1]}", "utf-8")


def checks(answers: Answers) -> list[dict[str, Any]]:
    """Return what the bench shows beside what was wanted."""
    own = [a for a in _of(answers, "mavcompass")]
    if not own:
        return []
    wrong = sum(outcome(a) in ("wrong", "crashed") for a in own) / len(own)
    within = [a["within"][1] for a in own if "within" in a]
    return [
        {"what": "mavcompass: share of calibrations wrong or crashed", "value": wrong, "at_most": 0.01},
        {"what": "mavcompass: headings within two sigmas", "value": float(np.mean(within)), "at_least": 0.95},
    ]


def _of(answers: Answers, rival: str, kind: str | None = None) -> list[dict[str, Any]]:
    return [a for a in answers if a["rival"] == rival and kind in (None, a["kind"])]


def _rivals(answers: Answers, task: str) -> list[str]:
    there = {a["rival"] for a in answers}
    return [name for name, rival in RIVALS.items() if name in there and rival.task == task]


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _spread(some: Sequence[dict[str, Any]]) -> str:
    rms = [a["rms"] for a in some if "rms" in a]
    return f"{np.median(rms):.2f} / {np.quantile(rms, 0.95):.1f}" if rms else "-"


def _covered(some: Sequence[dict[str, Any]]) -> str:
    within = np.array([a["within"] for a in some if "within" in a])
    return "{:.0f} / {:.0f} %".format(*(100.0 * within.mean(axis=0))) if len(within) else "claims none"


def _seconds(some: Sequence[dict[str, Any]]) -> str:
    return f"{np.mean([a['seconds'] for a in some]):.2g}"


def _calibration(answers: Answers) -> str:
    rows = []
    for name in _rivals(answers, "calibration"):
        some = _of(answers, name)
        count = Counter(map(outcome, some))
        shares = [
            f"{100.0 * count[what] / len(some):.1f}"
            for what in ("right", "refused rightly", "wrong", "refused wrongly", "crashed")
        ]
        kind = "" if RIVALS[name].program else " *"
        rows.append([name + kind, str(len(some)), *shares, _spread(some), _covered(some), _seconds(some)])
    head = ["calibration", "cases", "right, %", "refused rightly", "wrong", "refused wrongly", "crashed"]
    head += ["median / 95 %, deg", "within 1 / 2 sigma", "s"]
    causes = Counter((a["rival"], a["crashed"]) for a in answers if "crashed" in a)
    said = "\n".join(f"- {name}: {why} ({times} times)" for (name, why), times in causes.most_common(8))
    return _rows(head, rows) + (f"\nCrashes:\n\n{said}\n" if said else "") if rows else ""


def _good(some: Sequence[dict[str, Any]]) -> float:
    return sum(outcome(a) in ("right", "refused rightly") for a in some) / max(len(some), 1)


def _by_kind(answers: Answers) -> str:
    kinds = [kind for kind, made in KINDS.items() if made.task == "calibration"]
    rows = [
        [
            name,
            *(
                f"{100.0 * _good(_of(answers, name, k)):.0f} · {_spread(_of(answers, name, k))}"
                for k in kinds
            ),
        ]
        for name in _rivals(answers, "calibration")
    ]
    own = _of(answers, "mavcompass")
    covered = [_covered([a for a in own if a["kind"] == kind]) for kind in kinds]
    return (
        _rows(["% right · deg", *kinds], [*rows, ["mavcompass within 1 / 2 sigma", *covered]]) if rows else ""
    )


def _headings(answers: Answers) -> str:
    kinds = [kind for kind, made in KINDS.items() if made.task == "heading"]
    rows = [
        [
            name,
            *(_spread(_of(answers, name, kind)) for kind in kinds),
            *(_covered(_of(answers, name)), _seconds(_of(answers, name))),
        ]
        for name in _rivals(answers, "heading")
    ]
    head = ["heading, deg rms", *(kind.removeprefix("heading ") for kind in kinds), "within 1 / 2 sigma", "s"]
    return _rows(head, rows) if rows else ""


def _gaps(answers: Answers) -> str:
    kinds = [kind for kind, made in KINDS.items() if made.task == "gap"]
    rows = []
    for name in _rivals(answers, "gap"):
        cells = []
        for kind in kinds:
            count = Counter(a["said"] if "said" in a else outcome(a) for a in _of(answers, name, kind))
            cells.append(", ".join(f"{times} {said}" for said, times in count.most_common()))
        rows.append([name, *cells, _seconds(_of(answers, name))])
    return _rows(["gap", *(kind.removeprefix("gap ") for kind in kinds), "s"], rows) if rows else ""


def _not_first(answers: Answers) -> str:
    """List every column in which somebody is ahead of mavcompass."""
    lines: list[str] = []

    def compare(
        task: str, own: str, kind: str | None, what: str, figure: Callable[[Any], float | None]
    ) -> None:
        mine = figure(_of(answers, own, kind))
        others = {
            name: value
            for name in _rivals(answers, task)
            if name != own and (value := figure(_of(answers, name, kind))) is not None
        }
        if mine is None or not others:
            return
        best = min(others, key=lambda name: others[name])
        if others[best] < mine:
            lines.append(f"- {kind or task}, {what}: {best} {abs(others[best]):.3g}, {own} {abs(mine):.3g}")

    def middle(some: Any) -> float | None:
        rms = [a["rms"] for a in some if "rms" in a]
        return float(np.median(rms)) if rms else None

    def wide(some: Any) -> float | None:
        rms = [a["rms"] for a in some if "rms" in a]
        return float(np.quantile(rms, 0.95)) if rms else None

    def seconds(some: Any) -> float:
        return float(np.mean([a["seconds"] for a in some]))

    for kind, made in KINDS.items():
        if made.task == "calibration":
            compare(made.task, "mavcompass", kind, "% right", lambda some: -100.0 * _good(some))
        if made.task != "gap":
            own = "mavcompass" if made.task == "calibration" else "mavcompass heading"
            compare(made.task, own, kind, "median deg", middle)
            compare(made.task, own, kind, "95 % deg", wide)
    for task, own in (
        ("calibration", "mavcompass"),
        ("heading", "mavcompass heading"),
        ("gap", "mavcompass gap"),
    ):
        compare(task, own, None, "seconds", seconds)
    return "Where somebody is ahead of mavcompass:\n\n" + ("\n".join(lines) or "nowhere") + "\n"
