"""The command line as a whole: finding commands, exit codes, the options every command has."""

from __future__ import annotations

import errno
import json
import logging
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest

import mavcompass
from mavcompass.cli.main import COMMANDS, LazyCommands, main, program
from mavcompass.cli.options import Output, common_options, to_json
from mavcompass.errors import MavCompassError, PoorCalibration, Refused, WriteFailed

Probe = Callable[[Callable[[Output], object]], None]


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Iterator[Probe]:
    """Install a command `probe` with the common options that does what the test wants."""

    def install(body: Callable[[Output], object]) -> None:
        @click.command(help="Probe.")
        @common_options
        def command(output: Output) -> object:
            return body(output)

        module = ModuleType("mavcompass.cli.probe")
        module.command = command  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setitem(COMMANDS, "probe", "A command of the tests.")
        monkeypatch.setattr(LazyCommands, "list_commands", lambda self, ctx: ["probe"])

    root, ours = logging.getLogger(), logging.getLogger("mavcompass")
    handlers, level = root.handlers[:], ours.level
    yield install
    root.handlers[:] = handlers
    ours.setLevel(level)


def raising(error: BaseException) -> Callable[[Output], object]:
    def body(output: Output) -> object:
        raise error

    return body


def test_version_is_the_package_s(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"mavcompass {mavcompass.__version__}\n"


def test_help_lists_a_command_without_importing_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LazyCommands, "list_commands", lambda self, ctx: ["gap"])
    monkeypatch.delitem(sys.modules, "mavcompass.cli.gap", raising=False)
    assert main(["--help"]) == 0
    assert COMMANDS["gap"] in capsys.readouterr().out
    assert "mavcompass.cli.gap" not in sys.modules


def test_every_listed_command_has_a_file_and_helps_with_an_example(
    capsys: pytest.CaptureFixture[str],
) -> None:
    context = click.Context(program)
    for name in program.list_commands(context):
        assert program.get_command(context, name) is not None
        assert main([name, "--help"]) == 0
        assert f"mavcompass {name}" in capsys.readouterr().out.replace("Usage: mavcompass", "")


@pytest.mark.parametrize(
    "arguments", [["no-such-command"], ["--no-such-option"], ["probe", "--nonsense"], []]
)
def test_wrong_usage_is_two_and_says_so_on_standard_error(
    arguments: list[str], probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(lambda output: None)
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and "Usage: mavcompass" in said.err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (PoorCalibration("The vehicle did not turn.", "Turn it."), 5),
        (Refused("The vehicle is armed.", "Disarm it."), 7),
        (MavCompassError("Something.", "Do this."), 1),
    ],
)
def test_an_error_of_ours_is_one_sentence_and_its_exit_code(
    error: MavCompassError, code: int, probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raising(error))
    assert main(["probe"]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"mavcompass: {error}\n"


@pytest.mark.parametrize(
    ("set_by_the_person", "threads"),
    [
        ({}, "1"),
        ({"OMP_NUM_THREADS": "3"}, "3"),
        ({"OMP_NUM_THREADS": "3", "OPENBLAS_NUM_THREADS": "2"}, "2"),
    ],
)
def test_linear_algebra_has_one_thread_unless_a_person_says_otherwise(
    set_by_the_person: dict[str, str], threads: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "")  # so that it is put back
        monkeypatch.delenv(name)
    for name, value in set_by_the_person.items():
        monkeypatch.setenv(name, value)
    assert main(["--version"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == threads


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_an_interrupt_is_seven(
    error: BaseException, probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raising(error))
    assert main(["probe"]) == 7
    assert capsys.readouterr().err.strip() == "mavcompass: stopped."


def test_ctrl_c_does_not_cut_off_what_was_about_to_be_said(
    probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    def overtaken(output: Output) -> None:
        try:
            raise WriteFailed("Half is written.", "Put it back.")
        finally:
            raise KeyboardInterrupt

    probe(overtaken)
    assert main(["probe"]) == 6
    assert capsys.readouterr().err.strip() == "mavcompass: Half is written. Put it back."


def test_an_ordinary_refusal_is_a_sentence_with_v_too(
    probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raising(Refused("It is armed.", "Disarm it.")))
    assert main(["-v", "probe"]) == 7
    assert capsys.readouterr().err.strip() == "mavcompass: It is armed. Disarm it."
    assert main(["-vv", "probe"]) == 7
    assert "Traceback" in capsys.readouterr().err


_NASTY = "f\x1b[31mred\x07\nmavcompass: all is well"


@pytest.mark.parametrize(
    "arguments",
    [
        ["heading", f"{_NASTY}.tlog"],
        ["gap", "diagnose", f"{_NASTY}.tlog"],
        ["calibrate", f"{_NASTY}.tlog", "--params-out", f"{_NASTY}.txt"],
        ["params", "show", f"{_NASTY}.bin"],
        ["params", "backup", "sim:rover", f"{_NASTY}.param"],
        ["heading", "sim:rover", "--json", f"{_NASTY}/out.json"],
    ],
)
def test_a_file_name_neither_colours_the_terminal_nor_forges_a_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    main(arguments)
    said = "".join(capsys.readouterr())
    assert r"f\x1b[31mred\x07\nmavcompass: all is well" in said
    assert "\x1b" not in said and "\nmavcompass: all is well" not in said


def test_a_terminal_gets_its_colours_and_nothing_else(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    Output().say("\x1b[31mred\x1b[0m \x1b[2J", "second")
    assert capsys.readouterr().out == "\x1b[31mred\x1b[0m \\x1b[2J\nsecond\n"


def test_a_mistake_of_ours_is_owned_up_to_and_traced_with_v(
    probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raising(KeyError("yaw")))
    assert main(["probe"]) == 1
    said = capsys.readouterr().err
    assert "unexpected KeyError: 'yaw'" in said and "Traceback" not in said
    assert main(["-v", "probe"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_a_command_may_return_its_exit_code(probe: Probe) -> None:
    probe(lambda output: 5)
    assert main(["probe"]) == 5
    probe(lambda output: True)
    assert main(["probe"]) == 0


@pytest.mark.parametrize(
    ("arguments", "heard"),
    [(["probe"], []), (["-v", "probe"], ["info"]), (["probe", "-v"], ["info"]),
     (["-v", "probe", "-v"], ["info", "debug"]), (["probe", "-vv"], ["info", "debug"])],
)  # fmt: skip
def test_v_logs_to_standard_error_before_and_after_the_command(
    arguments: list[str], heard: list[str], probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    def body(output: Output) -> None:
        logging.getLogger("mavcompass.probe").info("word info")
        logging.getLogger("mavcompass.probe").debug("word debug")

    probe(body)
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert [line.split()[-1] for line in said.err.splitlines() if "word" in line] == heard


@pytest.mark.parametrize(("arguments", "heard"), [(["probe"], False), (["-v", "probe"], True)])
def test_a_library_s_warning_goes_to_the_log(
    arguments: list[str], heard: bool, probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(lambda output: warnings.warn("Degrees of freedom <= 0", RuntimeWarning, stacklevel=1))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(arguments) == 0
    assert ("Degrees of freedom" in capsys.readouterr().err) == heard


def speak_and_write(output: Output) -> None:
    output.say("For a person.")
    output.write_json({"schema": "probe/1"})


def test_json_to_standard_output_is_all_there_is(probe: Probe, capsys: pytest.CaptureFixture[str]) -> None:
    probe(speak_and_write)
    assert main(["probe", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == {"schema": "probe/1"}


def test_json_to_a_file_leaves_the_words(
    probe: Probe, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(speak_and_write)
    assert main(["probe", "--json", str(tmp_path / "result.json")]) == 0
    assert capsys.readouterr().out == "For a person.\n"
    assert json.loads((tmp_path / "result.json").read_text()) == {"schema": "probe/1"}


def test_json_into_a_folder_that_is_missing_is_refused_before_the_work(
    probe: Probe, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raising(AssertionError("the work began")))
    assert main(["probe", "--json", str(tmp_path / "missing" / "result.json")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_json_that_cannot_be_written_is_wrong_usage(
    probe: Probe, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(speak_and_write)
    assert main(["probe", "--json", str(tmp_path)]) == 2
    assert "could not be written" in capsys.readouterr().err


def test_a_full_disk_is_no_mistake_of_ours(probe: Probe, capsys: pytest.CaptureFixture[str]) -> None:
    probe(raising(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
    assert main(["probe"]) == 2
    told = capsys.readouterr().err
    assert "No space left on device" in told and "mistake" not in told


def test_json_takes_arrays_and_writes_null_for_what_is_not_finite() -> None:
    document = {"a": np.array([1.0, np.nan]), "b": np.float64(np.inf), "c": (np.int64(2), Path("x")), 3: None}
    assert json.loads(to_json(document)) == {"a": [1.0, None], "b": None, "c": [2, "x"], "3": None}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_for_the_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", shell]) == 0
    assert f"_MAVCOMPASS_COMPLETE={shell}_complete" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("mavcompass cal", "plain,calibrate"), ("mavcompass gap dia", "plain,diagnose"),
     ("x check --st", "plain,--strict")],
)  # fmt: skip
def test_completion_completes_commands_and_options(typed: str, offered: str) -> None:
    asked = {
        "_MAVCOMPASS_COMPLETE": "bash_complete",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(typed.count(" ")),
    }
    done = subprocess.run(
        [sys.executable, "-m", "mavcompass"], env=asked, capture_output=True, text=True, timeout=300
    )
    assert done.stdout.splitlines() == [offered]


TALKING_COMMAND = """
import sys, types, click
from mavcompass.cli import main as cli
module = types.ModuleType("mavcompass.cli.probe")
@click.command()
def command():
    for number in range(100000):
        print("σ = ±3°", number)
module.command = command
sys.modules[module.__name__] = module
cli.LazyCommands.list_commands = lambda self, ctx: ["probe"]
sys.exit(cli.main(["probe"]))
"""


def test_a_reader_that_goes_away_ends_the_program_quietly(
    start_process: Callable[..., subprocess.Popen[str]],
) -> None:
    running = start_process(sys.executable, "-c", TALKING_COMMAND)
    assert running.stdout is not None and running.stderr is not None
    running.stdout.readline()
    running.stdout.close()
    assert running.stderr.read() == ""
    assert running.wait() == 141


def test_a_result_whose_reader_goes_away_is_completed(
    start_process: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    report, result = tmp_path / "page.html", tmp_path / "result.json"
    command = ("calibrate", "sim:rover", "--dry-run", "--report", str(report), "--json", str(result))
    running = start_process(sys.executable, "-m", "mavcompass", *command)
    assert running.stdout is not None and running.stderr is not None
    running.stdout.close()
    assert "Errno" not in running.stderr.read()
    assert running.wait() == 0
    assert "</html>" in report.read_text() and json.loads(result.read_text())["compasses"]


def test_a_terminal_without_the_letters_gets_question_marks() -> None:
    done = subprocess.run(
        [sys.executable, "-X", "utf8=0", "-c", TALKING_COMMAND.replace("100000", "1")],
        env={"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        timeout=300,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"? = ?3? 0\n", b"")
