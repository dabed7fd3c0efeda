"""What the documents tell people to type works."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

from mavcompass.cli.main import main
from mavcompass.vehicle.opening import open_link

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAM = "./scripts/mavcompass "
# What waits for somebody or for ever is only checked for its options.
ENDLESS = {"simulate", "serve", "replay"}


def commands() -> list[str]:
    """Return the commands of each block, which may need what those before them did, once."""
    found: set[str] = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL)
        for block in [*blocks, *re.findall(r"`(\./scripts/mavcompass [^`]*)`", text)]:
            lines = [line.strip() for line in block.splitlines() if line.startswith(PROGRAM)]
            if any("restore" in line for line in lines):
                found.add("\n".join(lines))
            else:
                found.update(lines)
    return sorted(found)


def one_of_each(shown: list[str]) -> set[str]:
    """Return those to run: what differs in the vehicle, its seed or a dry run alone is shown to work by one.

    What every vehicle does, tests/procedure/test_calibrate_vehicles.py and its neighbours look at.
    """

    def order(lines: str) -> tuple[bool, bool, int]:
        # An autopilot's own calibration takes long, and is written in tests/procedure/test_autopilots_own.py.
        dry = ("--dry-run" in lines) is not ("--method autopilot" in lines)
        return dry, "sim:rover" not in lines, -len(lines)

    chosen: dict[str, str] = {}
    for lines in sorted(shown, key=order):
        alike = [re.sub(r"sim:[\w-]+(,seed=\d+)?", "sim:", line) for line in lines.splitlines()]
        for line in alike:
            chosen.setdefault(line.replace("--dry-run", "--yes"), lines)
    return set(chosen.values())


def is_runnable(words: list[str]) -> bool:
    return any(word.startswith("sim:") for word in words) and words[0] not in ENDLESS


SHOWN = commands()
RUN = one_of_each(SHOWN)


@pytest.mark.parametrize("lines", SHOWN)
def test_a_command_in_the_documents_is_one_that_works(
    lines: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for line in lines.splitlines():
        works(shlex.split(line.removeprefix(PROGRAM)), lines in RUN, tmp_path, monkeypatch, capsys)


def works(
    words: list[str],
    run: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if "COMMAND" in words:
        words = ["--help"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path))
    if "--help" in words or (run and is_runnable(words)):
        # A check finds the simulated rover's bad compass: that is its answer, not a failure.
        assert main(words) in ((0, 5) if words[0] == "check" else (0,)), capsys.readouterr().err
        return
    for word in words:
        if word.startswith("sim:"):
            open_link(word).close()  # a vehicle that there is
    options = [word for word in words if word.startswith("--")]
    group = words[:2] if words[0] in ("params", "gap", "fleet") else words[:1]
    assert main([*group, "--help"]) == 0
    explained = capsys.readouterr().out
    assert all(option in explained for option in options)


@pytest.mark.parametrize("name", ["terminal", "service", "calibration", "gap", "ground-station"])
def test_a_picture_is_there_for_light_and_dark_and_small(name: str) -> None:
    """They are made by scripts/documentation/pictures.py."""
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for scheme in ("light", "dark"):
        picture = ROOT / "docs" / "pictures" / f"{name}-{scheme}.png"
        assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size < 150_000
        assert f"pictures/{picture.name}" in shown


def test_the_terminals_picture_shows_what_is_said_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "documentation"))
    pictures = import_module("pictures")
    if request.config.getoption("--store"):
        pictures.main()
    assert pictures.terminal_text(tmp_path) == pictures.SHOWN.read_text("utf-8"), (
        "make the pictures anew: ./scripts/test tests/test_docs.py --store"
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_the_documents_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target
