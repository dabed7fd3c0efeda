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
OWN = {"calibration": "mavcompass", "heading": "mavcompass heading", "gap": "mavcompass gap"}
OUTCOMES = ("right", "refused rightly", "wrong", "refused wrongly", "crashed")


def of(answers: Answers) -> str:
    """Return all tables as Markdown."""
    return "\n".join(
        [_calibration(answers), _by_kind(answers), _headings(answers), _gaps(answers), _ahead(answers)]
    )


def put_into(page: Path, words: str) -> None:
    """Replace what stands between the marks of a page."""
    before, rest = page.read_text("utf-8").split(BEGIN, 1)
    page.write_text(f"{before}{BEGIN}\n{words}\n{END}{rest.split(END, 1)[1]}", "utf-8")


def checks(answers: Answers) -> list[dict[str, Any]]:
    """Return what the bench shows beside what was wanted."""
    own = _of(answers, OWN["calibration"])
    if not own:
        return []
    wrong = sum(outcome(a) in ("wrong", "crashed") for a in own) / len(own)
    within = float(np.mean([a["within"][1] for a in own if "within" in a]))
    return [
        {"what": "mavcompass: share of calibrations wrong or crashed", "value": wrong, "at_most": 0.01},
        {"what": "mavcompass: headings within two sigmas", "value": within, "at_least": 0.95},
    ]


def outcome(answer: dict[str, Any]) -> str:
    """Say what became of an answer."""
    if "crashed" in answer:
        return "crashed"
    if "refused" in answer:
        return "refused wrongly" if answer["answerable"] else "refused rightly"
    return answer.get("said") or ("right" if answer["rms"] <= RIGHT_DEG else "wrong")


def _of(answers: Answers, rival: str, kind: str | None = None) -> list[dict[str, Any]]:
    return [a for a in answers if a["rival"] == rival and kind in (None, a["kind"])]


def _who(answers: Answers, task: str) -> tuple[list[str], list[str]]:
    """Return the rivals and the kinds of a task that there are."""
    names, kinds = ({a[what] for a in answers} for what in ("rival", "kind"))
    return (
        [name for name, rival in RIVALS.items() if name in names and rival.task == task],
        [kind for kind, made in KINDS.items() if kind in kinds and made.task == task],
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _quantile(some: Answers, share: float) -> float | None:
    rms = [a["rms"] for a in some if "rms" in a]
    return float(np.quantile(rms, share)) if rms else None


def _good(some: Answers) -> float:
    return sum(outcome(a) in ("right", "refused rightly") for a in some) / max(len(some), 1)


def _mean_s(some: Answers) -> float:
    return float(np.mean([a["seconds"] for a in some]))


def _spread(some: Answers) -> str:
    middle, wide = _quantile(some, 0.5), _quantile(some, 0.95)
    return "-" if middle is None else f"{middle:.2f} / {wide:.1f}"


def _covered(some: Answers) -> str:
    within = np.array([a["within"] for a in some if "within" in a])
    return "{:.0f} / {:.0f} %".format(*(100.0 * within.mean(axis=0))) if len(within) else "-"


def _calibration(answers: Answers) -> str:
    rows = []
    for name in _who(answers, "calibration")[0]:
        some = _of(answers, name)
        count = Counter(map(outcome, some))
        shares = [f"{100.0 * count[what] / len(some):.1f}" for what in OUTCOMES]
        shown = name + ("" if RIVALS[name].program else " *")
        rows.append([shown, str(len(some)), *shares, _spread(some), _covered(some), f"{_mean_s(some):.2g}"])
    head = [
        "calibration",
        "cases",
        "right, %",
        *OUTCOMES[1:],
        "median / 95 %, deg",
        "within 1 / 2 sigma",
        "s",
    ]
    causes = Counter((a["rival"], a["crashed"]) for a in answers if "crashed" in a)
    said = [f"- {name} crashed {times} times: {why}" for (name, why), times in causes.most_common(8)]
    return _table(head, rows) + "\n" + "\n".join(said) + "\n"


def _by_kind(answers: Answers) -> str:
    names, kinds = _who(answers, "calibration")
    rows = []
    for name in names:
        each = [_of(answers, name, kind) for kind in kinds]
        rows.append([name, *(f"{100.0 * _good(some):.0f} · {_spread(some)}" for some in each)])
    covered = [_covered(_of(answers, OWN["calibration"], kind)) for kind in kinds]
    return _table(["% right · deg", *kinds], [*rows, ["mavcompass within 1 / 2 sigma", *covered]])


def _headings(answers: Answers) -> str:
    names, kinds = _who(answers, "heading")
    rows = []
    for name in names:
        some = _of(answers, name)
        each = [_spread(_of(answers, name, kind)) for kind in kinds]
        rows.append([name, *each, _covered(some), f"{_mean_s(some):.2g}"])
    short = [kind.removeprefix("heading ") for kind in kinds]
    return _table(["heading, deg rms", *short, "within 1 / 2 sigma", "s"], rows)


def _gaps(answers: Answers) -> str:
    names, kinds = _who(answers, "gap")
    rows = []
    for name in names:
        counts = [Counter(map(outcome, _of(answers, name, kind))).most_common() for kind in kinds]
        rows.append([name, *(", ".join(f"{times} {said}" for said, times in one) for one in counts)])
    return _table(["gap", *(kind.removeprefix("gap ") for kind in kinds)], rows)


def _ahead(answers: Answers) -> str:
    """List every column in which somebody is ahead of mavcompass.

    Shares are compared on the cases that both were given, errors on those that both answered.
    """
    lines: list[str] = []

    def case(answer: dict[str, Any]) -> tuple[str, int]:
        return answer["kind"], answer["index"]

    def compare(task: str, kind: str | None, what: str, figure: Callable[[Answers], float | None]) -> None:
        best: tuple[float, str] | None = None
        for name in _who(answers, task)[0]:
            mine, theirs = _of(answers, OWN[task], kind), _of(answers, name, kind)
            if what.endswith("deg"):
                mine, theirs = ([a for a in some if "rms" in a] for some in (mine, theirs))
            both = set(map(case, mine)) & set(map(case, theirs))
            mine, theirs = ([a for a in some if case(a) in both] for some in (mine, theirs))
            own, other = (figure(some) if some else None for some in (mine, theirs))
            if name == OWN[task] or own is None or other is None or not other < own:
                continue
            said = f"{name} {abs(other):.3g}, mavcompass {abs(own):.3g} ({len(mine)} cases)"
            best = min(best or (np.inf, ""), (other - own, said))
        if best is not None:
            lines.append(f"- {kind or task}, {what}: {best[1]}")

    for task in ("calibration", "heading"):
        for kind in _who(answers, task)[1]:
            if task == "calibration":
                compare(task, kind, "% right", lambda some: -100.0 * _good(some))
            compare(task, kind, "median deg", lambda some: _quantile(some, 0.5))
            compare(task, kind, "95 % deg", lambda some: _quantile(some, 0.95))
        compare(task, None, "seconds", _mean_s)
    compare("gap", None, "seconds", _mean_s)
    return "Where somebody is ahead of mavcompass:\n\n" + ("\n".join(lines) or "nowhere") + "\n"
