"""The notebooks of examples/ run from top to bottom, and print what they are stored with."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples").glob("*.ipynb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_prints_what_it_is_stored_with(
    notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot", reason="pip install 'mavcompass[report]'")
    pyplot.switch_backend("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, cell in enumerate(json.loads(notebook.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "code":
            with redirect_stdout(io.StringIO()) as printed:
                exec(compile("".join(cell["source"]), f"{notebook.name}, cell {number}", "exec"), names)
            stored = [line for said in cell["outputs"] for line in said.get("text", ())]
            assert printed.getvalue() == "".join(stored), "run it anew before storing it"
            pictures = sum("image/png" in said.get("data", {}) for said in cell["outputs"])
            assert pictures == len(pyplot.get_fignums())
            pyplot.close("all")


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) == 3
