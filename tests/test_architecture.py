"""Arrows between the rooms of mavcompass point one way.

The table is the one of CONTRIBUTING.md. import-linter judges it, on a contract made from those rooms that
exist. A module or package that the table does not name belongs to the ground floor.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import grimp
import pytest
from importlinter.cli import lint_imports

MAY_IMPORT = {  # each also its own files and the ground floor
    "heading": set(),
    "calibration": {"heading"},
    "simulation": {"heading"},
    "gap": {"simulation", "calibration"},
    "procedure": {"calibration", "heading"},
    "vehicle": {"heading", "calibration", "simulation", "gap", "procedure"},
    "logs": set(),
}
MAY_IMPORT_EVERYTHING = {"service", "report", "cli", "fleet", "plot", "api", "__main__"}

THIRD_PARTIES_OF_THE_GROUND_FLOOR = {"numpy", "scipy", "pygeomag"}
WITHOUT_MAVLINK = {"heading", "calibration", "simulation", "gap", "procedure"}
MAVLINK = {"pymavlink", "mavsdk"}


def graph_of(package: str) -> grimp.ImportGraph:
    return grimp.build_graph(package, include_external_packages=True, cache_dir=None)


def floors(package: str, graph: grimp.ImportGraph) -> tuple[set[str], set[str]]:
    """Tell the rooms from the modules of the ground floor, by their names without the package's."""
    modules = {module.removeprefix(f"{package}.") for module in graph.find_children(package)}
    rooms = modules & (MAY_IMPORT.keys() | MAY_IMPORT_EVERYTHING)
    return rooms, modules - rooms


def contracts(package: str, graph: grimp.ImportGraph) -> Iterator[tuple[str, set[str], set[str]]]:
    """Yield a title, the modules that import, and what they must not import."""
    rooms, ground = floors(package, graph)
    full = {name: f"{package}.{name}" for name in rooms | ground}
    yield "The ground floor imports no room", {full[name] for name in ground}, {full[name] for name in rooms}
    for name in rooms - MAY_IMPORT_EVERYTHING:
        above = {full[other] for other in rooms - MAY_IMPORT[name] - {name}}
        yield f"{name} imports only what the table allows", {full[name]}, above
    pure = {full[name] for name in rooms & WITHOUT_MAVLINK}
    yield "The pure rooms know no MAVLink library", pure, MAVLINK & graph.modules


def broken_arrows(package: str, tmp_path: Path) -> bool:
    settings = ["[importlinter]", f"root_package = {package}", "include_external_packages = True"]
    for number, (title, sources, forbidden) in enumerate(contracts(package, graph_of(package))):
        if sources and forbidden:
            settings += [
                f"[importlinter:contract:{number}]",
                f"name = {title}",
                "type = forbidden",
                "source_modules =",
                *(f"    {module}" for module in sorted(sources)),
                "forbidden_modules =",
                *(f"    {module}" for module in sorted(forbidden)),
                "allow_indirect_imports = True",
            ]
    file = tmp_path / "importlinter.ini"
    file.write_text("\n".join(settings))
    with loggers_left_alone():
        return lint_imports(config_filename=str(file), no_cache=True) != 0


@contextmanager
def loggers_left_alone() -> Iterator[None]:
    """The linter sets up logging for a program of its own, which switches every other logger off."""
    loggers = [item for item in logging.root.manager.loggerDict.values() if isinstance(item, logging.Logger)]
    before = {logger: logger.disabled for logger in loggers}
    try:
        yield
    finally:
        for logger, disabled in before.items():
            logger.disabled = disabled


def strangers_on_the_ground_floor(package: str) -> set[tuple[str, str]]:
    graph = graph_of(package)
    known = sys.stdlib_module_names | THIRD_PARTIES_OF_THE_GROUND_FLOOR | {package}
    return {
        (module, imported)
        for name in floors(package, graph)[1]
        for module in {f"{package}.{name}"} | graph.find_descendants(f"{package}.{name}")
        for imported in graph.find_modules_directly_imported_by(module)
        if imported.split(".")[0] not in known
    }


def test_every_arrow_points_the_way_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not broken_arrows("mavcompass", tmp_path), capsys.readouterr().out


def test_the_ground_floor_needs_only_numpy_scipy_and_pygeomag() -> None:
    assert strangers_on_the_ground_floor("mavcompass") == set()


@pytest.mark.parametrize(
    ("file", "code", "allowed"),
    [
        ("units.py", "import house.heading.tilt", False),
        ("units.py", "def late():\n    from house import api", False),
        ("heading/tilt.py", "from house import units", True),
        ("heading/tilt.py", "from house.calibration import sphere", False),
        ("calibration/sphere.py", "from house.heading import tilt", True),
        ("calibration/sphere.py", "import pymavlink.dialects.v20.ardupilotmega", False),
        ("logs/tlog.py", "from house.heading import tilt", False),
        ("logs/tlog.py", "import pymavlink", True),
        ("api.py", "import house.logs.tlog, house.calibration.sphere", True),
    ],
)
def test_the_check_itself_sees_a_wrong_arrow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, code: str, allowed: bool
) -> None:
    house = tmp_path / "house"
    for name in ("heading/tilt", "calibration/sphere", "logs/tlog", "api", "units"):
        path = house / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.touch()
    (house / file).write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        assert broken_arrows("house", tmp_path) is not allowed
    finally:
        for module in [name for name in sys.modules if name.split(".")[0] == "house"]:
            del sys.modules[module]


def test_the_check_itself_sees_a_stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lodge = tmp_path / "lodge"
    lodge.mkdir()
    (lodge / "__init__.py").touch()
    (lodge / "units.py").write_text("import numpy, math, click")
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        assert strangers_on_the_ground_floor("lodge") == {("lodge.units", "click")}
    finally:
        sys.modules.pop("lodge", None)
