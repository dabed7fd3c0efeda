"""The files around the program: one version everywhere, forms that parse, archives that work."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from mavcompass import __version__

PROJECT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("CHANGELOG.md", r"^## \[(\d.*?)\]"),
        ("CITATION.cff", r"^version: (.*)"),
        ("scripts/deploy/blueos/Dockerfile", r'^LABEL version="(.*)"'),
    ],
)
def test_the_version_is_the_same_everywhere(file: str, pattern: str) -> None:
    found = re.search(pattern, (PROJECT / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None and found[1] == __version__


def test_the_files_of_the_forge_parse() -> None:
    files = [*PROJECT.glob(".github/**/*.yml"), PROJECT / ".pre-commit-config.yaml", PROJECT / "CITATION.cff"]
    for file in files:
        assert isinstance(yaml.safe_load(file.read_text(encoding="utf-8")), dict), file


def test_continuous_integration_runs_what_a_person_runs() -> None:
    workflow = yaml.safe_load((PROJECT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    steps = workflow["jobs"]["checks"]["steps"]
    assert [step["run"] for step in steps if "run" in step] == ["./.ci/run"]
    assert os.access(PROJECT / ".ci/run", os.X_OK)


@pytest.mark.parametrize("lock", ["all", "dev", "service", "audit"])
def test_a_lock_names_each_release_with_its_hashes_and_no_place(lock: str) -> None:
    first, _, rest = (PROJECT / f"scripts/lock/{lock}.txt").read_text(encoding="utf-8").partition("\n")
    assert first == f"# {hashlib.sha256(rest.encode()).hexdigest()}", "edited by hand: run scripts/lock/renew"
    for block in re.split(r"\n(?=\S)", rest.strip()):
        assert re.match(r"[\w.-]+(\[[\w,]+\])?==\S+ ", block) and "--hash=sha256:" in block, block
    assert "://" not in rest and "@" not in rest


@pytest.mark.parametrize(("lock", "extra"), [("all", "all"), ("dev", "dev"), ("service", "serial")])
def test_a_lock_is_one_of_what_pyproject_asks_for(lock: str, extra: str) -> None:
    text = (PROJECT / f"scripts/lock/{lock}.txt").read_text(encoding="utf-8")
    locked = {canonicalize_name(n): v for n, v in re.findall(r"^([\w.-]+)\S*==(\S+)", text, re.MULTILINE)}
    asked = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = [*asked["project"]["dependencies"], *asked["project"]["optional-dependencies"][extra]]
    wanted += asked["build-system"]["requires"]
    for requirement in map(Requirement, wanted):
        if requirement.name != "mavcompass":
            assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), requirement


def test_what_is_fetched_from_elsewhere_is_named_by_its_digest() -> None:
    image = r"(?:container|FROM)\S*[: ]+(\S+)|- (python:\S+)|uses: (\S+)"
    for file in (".github/workflows/ci.yml", "scripts/deploy/blueos/Dockerfile"):
        named = ["".join(found) for found in re.findall(image, (PROJECT / file).read_text(encoding="utf-8"))]
        assert named
        for name in named:
            assert re.search(r"@(sha256:[0-9a-f]{64}|[0-9a-f]{40})$", name) or name == "${{", (file, name)


def test_a_wrong_calibration_is_reported_with_its_recording_and_result() -> None:
    form = yaml.safe_load((PROJECT / ".github/ISSUE_TEMPLATE/calibration.yml").read_text(encoding="utf-8"))
    required = {f["id"] for f in form["body"] if f.get("validations", {}).get("required")}
    assert {"recording", "json"} <= required


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from the source archive, as a packager does."""
    folder = tmp_path_factory.mktemp("dist")
    [archive] = SdistBuilder(str(PROJECT)).build(directory=str(folder), versions=["standard"])
    with tarfile.open(archive) as source:
        source.extractall(folder, filter="data")
    [built] = WheelBuilder(str(folder / f"mavcompass-{__version__}")).build(
        directory=str(folder), versions=["standard"]
    )
    return Path(built)


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel, away from the checkout."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_the_source_archive_gives_the_same_wheel_as_the_checkout(wheel: Path, tmp_path: Path) -> None:
    [ours] = WheelBuilder(str(PROJECT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(ours) as one, zipfile.ZipFile(wheel) as other:
        names = set(one.namelist())
        assert names == set(other.namelist()) and "mavcompass/py.typed" in names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"mavcompass"}


@pytest.mark.parametrize(
    "line",
    [
        "calibrate sim:rover --yes --report report.html",
        "params show sim:px4-copter",
        "gap catalogue",
        "doctor",
    ],
)
def test_the_wheel_works_from_an_empty_folder(site: Path, line: str, tmp_path: Path) -> None:
    search = os.pathsep.join([str(site), sysconfig.get_path("purelib")])
    done = subprocess.run(
        # -S leaves out what points this environment to the checkout
        [sys.executable, "-S", "-m", "mavcompass", *line.split()],
        cwd=tmp_path,
        env={"PYTHONPATH": search, "PATH": os.defpath, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert str(PROJECT) not in done.stdout.replace(sys.executable, "")
