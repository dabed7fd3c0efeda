"""Arrows between the rooms of mavcompass point one way, and so do those between the rooms within a room.

The table is the one of CONTRIBUTING.md. import-linter judges it, on a contract made from those rooms that
exist. A module or package that the table does not name belongs to the ground floor. An import that only
type checkers see is an arrow like any other.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import grimp
import pytest
from importlinter.cli import lint_imports

import mavcompass

MAY_IMPORT = {  # each also its own files and the ground floor
    "attitude": set(),
    "heading": {"attitude"},
    "calibration": {"attitude", "heading"},
    "simulation": {"heading"},
    "gap": {"simulation", "calibration"},
    "procedure": {"calibration", "heading"},
    "vehicle": {"attitude", "heading", "calibration", "simulation", "gap", "procedure", "logs"},
    "logs": set(),
}
# What lives in a room, from the top down: a row may import the rows below it, and nothing of its own row.
# A folder of one of these rooms holds about a dozen modules, and no module of them takes part in a circle.
ROWS = {
    "gap": [
        {"comparison", "rehearsal", "trial"},
        {"diagnose"},
        {"answer", "export"},
        {"selection"},
        {"residual"},
        {"detectors", "fit"},
        {"replay"},
        {"attitude"},
        {"result", "tables"},
    ],
    "simulation": [
        {"heading_error"},
        {"vehicle"},
        {"ardupilot", "px4"},
        {"autopilot", "effects"},
        {"physics"},
    ],
    "vehicle": [
        {"connection", "flying", "heading_stream", "session"},
        {"calibrating"},
        {"opening", "dialects", "driver"},
        {"replay"},
        {"links", "simulators"},
        {"wire", "transport", "parameters"},
        {"link", "lock", "stopping"},
    ],
    "procedure": [
        {"calibrate", "check", "flying"},
        {"writing"},
        {"autopilot_heading"},
        {"report", "settings"},
        {"motion"},
        {"desk"},
        {"positions"},
        {"turning", "commands"},
        {"modes", "dialect"},
        {"vehicle_state"},
        {"nameplate"},
        {"script"},
    ],
    "cli": [
        {"main"},
        {"calibrate", "check", "doctor", "fleet", "gap", "heading", "params", "replay", "serve", "simulate"},
        {"calibration"},
        {"source"},
        {"options"},
        {"terminal"},
    ],
    "logs": [{"reading"}, {"formats"}, {"common"}],
    "calibration": [
        {"calibrate"},
        {"judge"},
        {"mounting"},
        {"methods"},
        {"findings"},
        {"motion"},
        {"positions", "recorded"},
        {"result", "first_state", "cross_terms"},
        {"rigid"},
        {"observation", "model"},
    ],
    "service": [
        {"run", "mavproxy"},
        {"web"},
        {"station"},
        {"mavlink"},
        {"work"},
        {"view"},
        {"watch"},
        {"standing"},
        {"addresses", "config"},
        {"models"},
    ],
    "fleet": [
        {"run", "summary"},
        {"population"},
        {"columns", "engine", "journal"},
        {"examine"},
        {"recordings"},
    ],
    "report": [
        {"bag", "calibration", "compare", "fleet", "gap"},
        {"document", "figures", "gap_figures", "gap_words"},
        {"svg"},
    ],
    "workers": [{"__main__"}, {"child"}],
}
MODULES_IN_A_FOLDER = 13
MAY_IMPORT_EVERYTHING = {"service", "report", "cli", "fleet", "plot", "api", "__main__"}

THIRD_PARTIES_OF_THE_GROUND_FLOOR = {"numpy", "pygeomag"}
WITHOUT_MAVLINK = {"attitude", "heading", "calibration", "simulation", "gap", "procedure"}
MAVLINK = {"pymavlink", "mavsdk"}

FOR_TYPES_ONLY = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    "


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


def broken_rows(package: str, rooms: dict[str, list[set[str]]], tmp_path: Path) -> bool:
    """Tell whether an arrow within a room (its name, with a dot before) points up or aside, or a row lacks a
    name."""
    settings = ["[importlinter]", f"root_package = {package}"]
    for number, (room, rows) in enumerate(rooms.items()):
        settings += [
            f"[importlinter:contract:{number}]",
            f"name = Within {package}{room}, arrows point down",
            "type = layers",
            f"containers = {package}{room}",
            "exhaustive = True",
            "layers =",
            *("    " + " | ".join(sorted(row)) for row in rows),
        ]
    file = tmp_path / "importlinter.ini"
    file.write_text("\n".join(settings))
    with loggers_left_alone():
        return lint_imports(config_filename=str(file), no_cache=True) != 0


def circles(package: str, rooms: Iterable[str]) -> list[tuple[str, ...]]:
    """List the sets of modules of a room (its name, with a dot before) that import each other in a loop."""
    graph = grimp.build_graph(package, cache_dir=None)
    found = set()
    for room in rooms:
        inside = {package + room} | graph.find_descendants(package + room)
        reached = {module: graph.find_upstream_modules(module) & inside for module in inside}
        knots = {
            module: {other for other in reached[module] if module in reached[other]} for module in inside
        }
        found |= {tuple(sorted({module} | knot)) for module, knot in knots.items() if knot}
    return sorted(found)


def crowded_folders(folder: Path) -> list[str]:
    folders = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
    return [
        f"{path.name}: {number} modules"
        for path in folders
        if (number := len(list(path.glob("*.py"))) - 1) > MODULES_IN_A_FOLDER
    ]


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


def test_within_a_room_arrows_point_down(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rooms = {f".{room}": rows for room, rows in ROWS.items()}
    assert not broken_rows("mavcompass", rooms, tmp_path), capsys.readouterr().out


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert circles("mavcompass", [f".{room}" for room in ROWS]) == []


def test_a_folder_holds_about_a_dozen_modules() -> None:
    folder = Path(mavcompass.__file__).parent
    assert [crowd for room in ROWS for crowd in crowded_folders(folder / room)] == []


def test_scipy_is_used_only_where_an_extra_brings_it() -> None:
    """The plain installation is without it: 130 MB that a companion computer need not hold."""
    folder = Path(mavcompass.__file__).parent
    using = [
        file
        for file in folder.rglob("*.py")
        if re.search(r"^\s*(from|import) scipy", file.read_text("utf-8"), re.M)
    ]
    assert {file.relative_to(folder).parts[:2] for file in using} == {
        ("fleet", "population"),
        ("gap", "trial"),
    }


def test_the_ground_floor_needs_only_numpy_and_pygeomag() -> None:
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
    names = ("heading/tilt", "calibration/sphere", "logs/tlog", "api", "units")
    with built("house", names, tmp_path, monkeypatch) as house:
        (house / file).write_text(code)
        assert broken_arrows("house", tmp_path) is not allowed


@pytest.mark.parametrize(
    ("file", "code", "allowed"),
    [
        ("cellar.py", "", True),
        ("attic/roof.py", "from barn.hall import door", True),
        ("hall/door.py", "import barn.attic", False),
        ("hall/door.py", "from barn import yard", False),
        ("cellar.py", "def late():\n    from barn.hall import door", False),
        (
            "cellar.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import barn.hall.door",
            False,
        ),
        ("shed.py", "", False),  # which the rows do not name
    ],
)
def test_the_check_of_rows_sees_an_arrow_up_and_one_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, code: str, allowed: bool
) -> None:
    with built("barn", ("attic/roof", "hall/door", "yard/well", "cellar"), tmp_path, monkeypatch) as barn:
        (barn / file).write_text(code)
        assert broken_rows("barn", {"": [{"attic"}, {"hall", "yard"}, {"cellar"}]}, tmp_path) is not allowed


def test_the_check_of_circles_sees_one_of_types(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with built("mill", ("wheel", "stone", "sack"), tmp_path, monkeypatch) as mill:
        (mill / "wheel.py").write_text("from mill import stone")
        assert circles("mill", [""]) == []
        (mill / "stone.py").write_text(f"{FOR_TYPES_ONLY}from mill.wheel import turn")
        assert circles("mill", [""]) == [("mill.stone", "mill.wheel")]


@contextmanager
def built(
    package: str, modules: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """Stand a package of empty modules (paths) where it can be imported from."""
    house = tmp_path / package
    for name in modules:
        path = house / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.touch()
    (house / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        yield house
    finally:
        for module in [name for name in sys.modules if name.split(".")[0] == package]:
            del sys.modules[module]
