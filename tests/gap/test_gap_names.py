"""An effect is one file: what the diagnosis must know of it stands in its registry entry."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import mavcompass.gap
from mavcompass.simulation.effects import catalogue

GAP = Path(mavcompass.gap.__file__).parent
# What makes cases, writes files or rehearses remedies speaks of single effects; the keys of the document are
# the contract's.
BESIDE_INFERENCE = {"trial", "export", "rehearsal", "result.py"}
INFERENCE = sorted(
    path for path in GAP.rglob("*.py") if path.relative_to(GAP).parts[0] not in BESIDE_INFERENCE
)


@pytest.mark.parametrize("path", INFERENCE, ids=lambda path: str(path.relative_to(GAP)))
def test_no_effect_is_named_in_inference(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    words = {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert not words & catalogue().keys()


def test_the_rooms_that_infer_are_looked_through() -> None:
    rooms = {path.relative_to(GAP).parts[0] for path in INFERENCE}
    inferring = "answer attitude detectors fit replay residual selection diagnose.py"
    assert set(inferring.split()) <= rooms
