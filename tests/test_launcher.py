"""scripts/mavcompass and scripts/test make the environment once, safely, and then stay out of the way.

These tests run a copy of the scripts with a stand-in for Python that plays `venv` and, but for one, `pip`.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]

STAND_IN = f"""#!/bin/sh
case "$1 $2" in
"-m venv")
    mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; cp "$0" "$3/bin/pip"
    echo "venv talks" ;;
"-m pip")
    if [ -e real-pip ]; then exec "{sys.executable}" "$@"; fi
    seconds="$(cat pip-seconds 2>/dev/null || echo 0)"
    echo "pip talks"
    echo "$*" >>pip-calls
    sleep "$seconds"
    if [ -e pip-error ]; then cat pip-error; exit 1; fi
    printf '#!/bin/sh\\necho "program: $*"; [ "$1" != stay ] || exec sleep 30\\n' >.venv/bin/mavcompass
    printf '#!/bin/sh\\necho "pytest: $*"\\n' >.venv/bin/pytest
    chmod +x .venv/bin/mavcompass .venv/bin/pytest ;;
*) exec "{sys.executable}" "$@" ;;
esac
"""


Start = Callable[..., subprocess.Popen[str]]


class Checkout:
    """A checkout whose Python is the stand-in."""

    def __init__(self, folder: Path, tools: Path, start_process: Start) -> None:
        self.start_process = start_process
        self.folder = folder
        self.tools = tools
        folder.mkdir(parents=True)
        shutil.copytree(PROJECT / "scripts", folder / "scripts")
        shutil.copy(PROJECT / "pyproject.toml", folder)
        tools.mkdir()
        self.make_tool("python3.13", "#!/bin/sh\nexit 127\n")  # like a version manager's empty promise
        self.make_tool("python3.11", STAND_IN)

    def make_tool(self, name: str, text: str) -> None:
        (self.tools / name).write_text(text)
        (self.tools / name).chmod(0o755)

    @property
    def environment(self) -> dict[str, str]:
        return {"PATH": f"{self.tools}:/usr/bin:/bin"}

    def start(self, *arguments: str, script: str = "mavcompass") -> subprocess.Popen[str]:
        words = [str(self.folder / "scripts" / script), *arguments]
        return self.start_process(*words, cwd="/", env=self.environment, start_new_session=True)

    def run(self, *arguments: str, script: str = "mavcompass") -> tuple[int, str, str]:
        running = self.start(*arguments, script=script)
        out, err = running.communicate()
        return running.returncode, out, err

    def write(self, name: str, text: str) -> None:
        (self.folder / name).parent.mkdir(exist_ok=True)
        (self.folder / name).write_text(text)

    @property
    def pip_calls(self) -> list[str]:
        file = self.folder / "pip-calls"
        calls = file.read_text().splitlines() if file.exists() else []
        locked, own = (
            calls[::2],
            calls[1::2],
        )  # what the lock names, then this folder
        assert all("--require-hashes" in call for call in locked) and all("--no-deps" in call for call in own)
        return [Path(call.split()[-1]).stem for call in locked]

    @property
    def venv(self) -> Path:
        return self.folder / ".venv"


@pytest.fixture
def checkout(tmp_path: Path, start_process: Start) -> Checkout:
    return Checkout(tmp_path / "a folder" / "mav compass", tmp_path / "tools", start_process)


def test_first_start_makes_the_environment_and_keeps_standard_output_clean(checkout: Checkout) -> None:
    code, out, err = checkout.run("--json", "-", "two words")
    assert (code, out) == (0, "program: --json - two words\n")
    assert [line.split(":")[0] for line in err.splitlines()] == ["mavcompass", "mavcompass"]
    assert "pip talks" in (checkout.folder / ".venv-setup.log").read_text()


def test_what_most_commands_load_is_compiled_once(checkout: Checkout) -> None:
    """Where a start may write nothing it would compile them each time, for half a second."""
    checkout.write("mavcompass/__init__.py", "")
    package = checkout.venv / "lib" / "python3.11" / "site-packages" / "numpy"
    (package / "tests").mkdir(parents=True)
    for file in (package / "core.py", package / "tests" / "test_core.py"):
        file.write_text("")
    checkout.run()
    compiled = [file.parent.parent.name for file in checkout.folder.rglob("*.pyc")]
    assert sorted(compiled) == ["mavcompass", "numpy"]


def test_second_start_is_silent_and_quick(checkout: Checkout) -> None:
    checkout.run()
    assert checkout.run("again") == (0, "program: again\n", "")
    assert checkout.pip_calls == ["all"]

    def quickest(command: list[Path]) -> float:
        seconds = []
        for _ in range(5):
            began = time.perf_counter()
            subprocess.run(command, env=checkout.environment, stdout=subprocess.DEVNULL, check=True)
            seconds.append(time.perf_counter() - began)
        return min(seconds)

    launcher, program = checkout.folder / "scripts" / "mavcompass", checkout.venv / "bin" / "mavcompass"
    assert quickest([launcher]) - quickest([program]) < 0.2


def test_second_start_needs_no_python_and_no_pip(checkout: Checkout) -> None:
    checkout.run()
    checkout.make_tool("python3.11", "#!/bin/sh\nexit 1\n")
    (checkout.venv / "bin" / "python").write_text("#!/bin/sh\nexit 1\n")
    assert checkout.run() == (0, "program: \n", "")


@pytest.mark.parametrize("relative", [False, True])
def test_a_symbolic_link_starts_the_checkout_it_points_into(checkout: Checkout, relative: bool) -> None:
    target = checkout.folder / "scripts" / "mavcompass"
    link = checkout.tools / "mavcompass"
    link.symlink_to(os.path.relpath(target, checkout.tools) if relative else target)
    done = subprocess.run(
        ["mavcompass", "linked"], env=checkout.environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "program: linked\n"
    assert checkout.venv.is_dir()


def test_started_by_bash_from_its_own_folder(checkout: Checkout) -> None:
    done = subprocess.run(
        ["bash", "mavcompass", "near"],
        cwd=checkout.folder / "scripts",
        env=checkout.environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "program: near\n"


def test_only_a_change_of_what_is_needed_installs_again(checkout: Checkout) -> None:
    checkout.run()
    text = (checkout.folder / "pyproject.toml").read_text()
    assert "line-length = 110" in text and '"click>=8.1"' in text
    checkout.write("pyproject.toml", text.replace("line-length = 110", "line-length = 90"))
    checkout.run()
    assert checkout.pip_calls == ["all"]
    checkout.write("pyproject.toml", text.replace('"click>=8.1"', '"click>=8.2"'))
    checkout.run()
    checkout.run()
    assert checkout.pip_calls == ["all", "all"]
    checkout.write("scripts/lock/dev.txt", "# another\n")
    checkout.run()
    checkout.run()
    assert checkout.pip_calls == ["all", "all", "all"]


def test_program_then_tests_then_program_installs_each_once(checkout: Checkout) -> None:
    checkout.run()
    code, out, _ = checkout.run("-k", "yaw or roll", script="test")
    assert (code, out) == (0, "pytest: -n 3 --dist worksteal -k yaw or roll\n")
    checkout.run()
    checkout.run("-x", script="test")
    assert checkout.pip_calls == ["all", "dev"]


def test_tests_first_leave_nothing_to_install_for_the_program(checkout: Checkout) -> None:
    checkout.run("-x", script="test")
    assert checkout.run("go") == (0, "program: go\n", "")
    assert checkout.pip_calls == ["dev"]


def test_two_first_starts_at_once_install_once(checkout: Checkout) -> None:
    checkout.write("pip-seconds", "0.5")
    first, second = checkout.start("one"), checkout.start("two")
    (out_1, err_1), (out_2, err_2) = first.communicate(), second.communicate()
    assert (out_1, out_2) == ("program: one\n", "program: two\n")
    assert (err_1 + err_2).count("waiting") == 1
    assert checkout.pip_calls == ["all"]


def test_a_running_program_does_not_hold_the_lock(checkout: Checkout) -> None:
    running = checkout.start("stay")
    try:
        assert running.stdout is not None and running.stdout.readline() == "program: stay\n"
        assert checkout.run("-x", script="test")[:2] == (0, "pytest: -n 3 --dist worksteal -x\n")
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()


UV = """#!/bin/sh
[ ! -e uv-error ] || { cat uv-error; exit 1; }
echo "$*" >>uv-calls
if [ "$1" = venv ]; then
    mkdir -p .venv/bin; printf '#!/bin/sh\n' >.venv/bin/python
else
    printf '#!/bin/sh\necho "program: $*"\n' >.venv/bin/mavcompass
fi
chmod +x .venv/bin/*
"""


def test_uv_is_used_where_it_is(checkout: Checkout) -> None:
    checkout.make_tool("uv", UV)
    assert checkout.run("fast")[:2] == (0, "program: fast\n")
    assert checkout.pip_calls == []
    assert checkout.run("again") == (0, "program: again\n", "")


def test_uv_brings_a_python_where_there_is_none(checkout: Checkout) -> None:
    for name in ("python3", "python3.12", "python3.11"):
        checkout.make_tool(name, "#!/bin/sh\nexit 1\n")
    checkout.make_tool("uv", UV)
    assert checkout.run("on")[:2] == (0, "program: on\n")
    assert "--python >=3.11" in (checkout.folder / "uv-calls").read_text()


def test_pip_is_used_where_uv_fails(checkout: Checkout) -> None:
    checkout.make_tool("uv", UV)
    checkout.write("uv-error", "error: Failed to fetch")
    assert checkout.run("slow")[:2] == (0, "program: slow\n")
    assert checkout.pip_calls == ["all"]


def test_without_python_one_sentence_says_what_to_install(checkout: Checkout) -> None:
    checkout.make_tool("python3.11", "#!/bin/sh\nexit 1\n")
    bash = shutil.which("bash") or "/bin/bash"
    done = subprocess.run(
        [bash, checkout.folder / "scripts" / "mavcompass"],
        env={"PATH": str(checkout.tools)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert "no Python 3.11 or newer was found; install one" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not checkout.venv.exists()


@pytest.mark.parametrize(
    ("words_of_pip", "sentence"),
    [
        ("NewConnectionError: Connection refused", "index cannot be reached"),
        ("Error: ensurepip is not available", "python3-venv"),
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("error: subprocess-exited-with-error", "could not be installed"),
    ],
)
def test_a_failed_first_set_up_explains_itself_and_leaves_nothing(
    checkout: Checkout, words_of_pip: str, sentence: str
) -> None:
    checkout.write("pip-error", words_of_pip)
    code, out, err = checkout.run()
    assert (code, out) == (1, "")
    last = err.splitlines()[-1]
    log = checkout.folder / ".venv-setup.log"
    assert sentence in last and str(log) in last
    assert words_of_pip in log.read_text()
    assert not checkout.venv.exists()

    (checkout.folder / "pip-error").unlink()
    assert checkout.run("now")[:2] == (0, "program: now\n")


def test_a_failed_update_leaves_the_environment_of_before(checkout: Checkout) -> None:
    checkout.run()
    text = (checkout.folder / "pyproject.toml").read_text()
    checkout.write("pyproject.toml", text.replace('"click>=8.1"', '"click>=8.2"'))
    checkout.write("pip-error", "Read timed out")
    code, out, err = checkout.run()
    assert (code, out) == (1, "")
    assert f"still there: {checkout.venv}/bin/mavcompass" in err.splitlines()[-1]
    assert (checkout.venv / "bin" / "mavcompass").exists()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_what_an_ended_set_up_left_is_thrown_away(checkout: Checkout, how: signal.Signals) -> None:
    checkout.write("pip-seconds", "20")
    running = checkout.start()
    while not checkout.pip_calls and running.poll() is None:
        time.sleep(0.02)
    time.sleep(0.2)  # now it sleeps; a shell between two commands may lose an interrupt
    os.killpg(running.pid, how)
    out, _ = running.communicate()
    assert (running.returncode, out) == (130 if how == signal.SIGINT else -how, "")
    (checkout.venv / "half-made").touch()
    checkout.write("pip-seconds", "0")
    assert checkout.run("after")[:2] == (0, "program: after\n")
    assert not (checkout.venv / "half-made").exists()


def test_a_moved_checkout_gets_a_new_environment(checkout: Checkout) -> None:
    checkout.run()
    (checkout.venv / "old").touch()
    moved = checkout.folder.with_name("moved")
    checkout.folder.rename(moved)
    checkout.folder = moved
    assert checkout.run("here")[:2] == (0, "program: here\n")
    assert not (checkout.venv / "old").exists()


def test_an_environment_made_by_hand_is_used_and_kept(checkout: Checkout) -> None:
    (checkout.venv / "bin").mkdir(parents=True)
    shutil.copy(checkout.tools / "python3.11", checkout.venv / "bin" / "python")
    (checkout.venv / "mine").touch()
    checkout.write("pip-error", "Read timed out")
    assert checkout.run()[0] == 1
    (checkout.folder / "pip-error").unlink()
    assert checkout.run()[0] == 0
    assert (checkout.venv / "mine").exists()


def test_the_real_pip_without_an_index(checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pip")
    checkout.write("real-pip", "")
    unreachable = {"PIP_INDEX_URL": "http://127.0.0.1:9", "PIP_RETRIES": "0", "PIP_IGNORE_INSTALLED": "1"}
    environment = checkout.environment | unreachable | {"PIP_CONFIG_FILE": os.devnull}
    monkeypatch.setattr(Checkout, "environment", environment)
    code, out, err = checkout.run()
    assert (code, out) == (1, "")
    assert "the Python package index cannot be reached" in err.splitlines()[-1]
    assert not checkout.venv.exists()
