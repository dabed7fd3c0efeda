"""The documentation's site builds without a warning; what is made from the code tells all of it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace

import click
import pytest

from mavcompass.cli.main import program

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    spec = spec_from_file_location(
        "generated_pages", PROJECT / "scripts" / "documentation" / "generated_pages.py"
    )
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_equation_has_its_number_beside_it(pages: ModuleType) -> None:
    theory = (PROJECT / "docs" / "theory.md").read_text("utf-8")
    config = SimpleNamespace(repo_url="https://there")
    shown = pages.on_page_markdown(theory, config)
    numbers = re.findall(r"\\tag\{([A-Z]\d)\}", theory)
    assert len(numbers) > 10 and re.findall(r"</math><span>\(([A-Z]\d)\)</span>", shown) == numbers
    assert "$$" not in shown and "\\" not in shown and "<mi>&#x003C8;</mi>" in shown


def test_every_command_and_option_is_in_the_reference(pages: ModuleType) -> None:
    text = pages.commands()
    context = click.Context(program)
    for name in program.list_commands(context):
        command = program.get_command(context, name)
        assert f"\n## mavcompass {name}\n" in text
        inner = command.commands.values() if isinstance(command, click.Group) else [command]
        for one in inner:
            assert one is not None
            options = [
                o for p in one.params if isinstance(p, click.Option) for o in p.opts if o.startswith("--")
            ]
            assert all(option in text for option in options)
            assert [o.name for o in one.params if isinstance(o, click.Option) and not o.help] == []


def test_refusals_have_their_exit_code_and_their_remedy(pages: ModuleType) -> None:
    found = pages.found_refusals()
    assert (2, "--yes and --dry-run exclude each other.", "Give one of them.") in found
    assert any(code == 4 and "no magnetometer" in what for code, what, _ in found)
    assert {code for code, _, _ in found} == {2, 3, 4, 5, 6, 7}
    assert len(found) > 100
    assert len([what for _, what, remedy in found if not remedy]) < 15  # filled in where it happens
    assert "Give one of them." in pages.refusals()


def test_the_python_reference_has_the_public_functions(pages: ModuleType) -> None:
    text = pages.python()
    for name in ("read_track", "calibrate", "heading", "diagnose_gap", "connect", "plot.circle"):
        assert f"\n## mavcompass.{name}\n" in text
    for name in (
        "observation.observe",
        "positions.next_pose",
        "mounting.find_rotation",
    ):
        assert f"\n### mavcompass.calibration.{name}\n" in text


@pytest.mark.skipif(find_spec("material") is None, reason="pip install mkdocs-material")
def test_the_site_builds_without_a_warning_and_with_every_page(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path],
        cwd=PROJECT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    made = {path.parent.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("index.html")}
    written = {path.stem for path in (PROJECT / "docs").glob("*.md")} - {"index"}
    assert written | {"reference/commands", "reference/refusals", "reference/python"} <= made
