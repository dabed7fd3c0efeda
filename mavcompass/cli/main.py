"""Find the command, run it, and turn what went wrong into one sentence and an exit code.

A command is a file or folder here, named after it, with a click command called `command`. Only the one that
is asked for is imported: `mavcompass --help` and `--version` load nothing but click.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Literal, TextIO

import click

from mavcompass import __version__
from mavcompass.cli.options import Commands, discard_standard_output, verbose_option
from mavcompass.cli.terminal.lines import styled, wrapped
from mavcompass.errors import MavCompassError
from mavcompass.printable import printable

COMMANDS = {
    "calibrate": "Calibrate the compass of a vehicle or from a recording.",
    "heading": "Stream the tilt-compensated heading with its uncertainty.",
    "check": "Check the compass before a flight: pass, warn or fail.",
    "params": "Show, compare, write, back up or restore compass parameters.",
    "replay": "Play a recording as if the vehicle were there.",
    "simulate": "Run a simulated flight controller on a socket.",
    "gap": "Explain the gap between the simulation and a recording.",
    "fleet": "Work through many recordings, on one machine or a cluster.",
    "serve": "Run as a service on a companion computer.",
    "doctor": "Say what on this computer stands in the way, and its remedy.",
}

WRONG_USAGE = 2
STOPPED_BY_PERSON = 7
COMPLETION_VARIABLE = "_MAVCOMPASS_COMPLETE"  # click's: set by the script, read at every start
READER_WENT_AWAY = 141  # what the shell reports for a program that ended by SIGPIPE
UNEXPECTED = 1


class LazyCommands(Commands):
    """Import a command when it is called, not when it is listed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        command = import_module(f"mavcompass.cli.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if ":" in args[0] or "." in args[0]:
            raise click.UsageError(
                f"{args[0]!r} is no command. Say what to do with it: mavcompass calibrate {args[0]}", ctx
            )
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
        except BrokenPipeError:
            discard_standard_output()
            ctx.exit(READER_WENT_AWAY)
        return result


def _print_completion(context: click.Context, parameter: click.Parameter, shell: str | None) -> None:
    """Print a shell's completion script; the shell asks the program itself what can follow."""
    if shell is None:
        return
    from click.shell_completion import get_completion_class

    chosen = get_completion_class(shell)
    assert chosen is not None
    click.echo(chosen(program, {}, "mavcompass", COMPLETION_VARIABLE).source())
    context.exit()


@click.command(
    cls=LazyCommands, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(__version__, prog_name="mavcompass", message="%(prog)s %(version)s")
@click.option(
    "--completion",
    type=click.Choice(("bash", "zsh", "fish")),
    expose_value=False,
    is_eager=True,
    callback=_print_completion,
    help="Print what makes this shell complete commands and options.",
)
@verbose_option
@click.pass_context
def program(context: click.Context) -> int | None:
    """Calibrate a vehicle's compass in four 90 degree turns, read its heading with an honest uncertainty,
    and explain the gap between the simulator and the real vehicle.

    SOURCE is an address (udpin:0.0.0.0:14550, tcp:HOST:PORT, /dev/ttyACM0:115200), a simulated vehicle
    (sim:rover) or a recording (.tlog, .bin, .ulg, .csv, .mcap).

    Without a command it looks for vehicles, and asks what to do.

    \b
    Example: mavcompass calibrate sim:rover --yes
    Completion of words by TAB: eval "$(mavcompass --completion bash)"
    """
    if context.invoked_subcommand is not None:
        return None
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        click.echo(context.get_help(), err=True)
        context.exit(WRONG_USAGE)
    from mavcompass.cli.doctor import NOBODY, look_around

    command = look_around()
    return int(program.main(command, "mavcompass", standalone_mode=False) or 0) if command else NOBODY


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program with these arguments (default: the command line's) and return its exit code."""
    # Matrices of a handful of columns: threads of linear algebra only wait for each other. Read when numpy is
    # first imported, which is when a command is; what a person has set holds.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal that lacks a letter shows "?" for it
    warnings.showwarning = _log_warning
    code, ended = 0, None
    try:
        code = program.main(args=arguments, prog_name="mavcompass", standalone_mode=False)
    except (Exception, KeyboardInterrupt) as error:
        ended = error
    if arguments is None:  # the program ends: what is said last is not cut off by one Ctrl-C more
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if ended is not None:
        return _told(ended)
    return code if type(code) is int else 0  # a command may return its exit code


def _told(error: BaseException) -> int:
    """Say what ended the program; return its exit code."""
    if isinstance(error, click.Abort | KeyboardInterrupt):
        error = _overtaken(error)
    match error:
        case click.Abort() | KeyboardInterrupt():
            _complain("stopped.")
            return STOPPED_BY_PERSON
        case click.ClickException():
            error.message = printable(error.message)  # type: ignore[misc]
            error.show()
            return WRONG_USAGE
        case MavCompassError():
            _complain(str(error))
            _log_traceback(error, "debug")  # an ordinary refusal says all in its sentence
            return error.exit_code
        case OSError(errno=errno.ENOSPC | errno.EDQUOT | errno.EFBIG | errno.EROFS):
            _complain(f"{error}: what was to be written is not whole. Make room, or name another place.")
            return WRONG_USAGE
    _complain(
        f"unexpected {type(error).__name__}: {error}. This is a mistake in mavcompass: please report it"
        " with what `mavcompass -v ...` prints."
    )
    _log_traceback(error, "info")
    return UNEXPECTED


def _overtaken(stopped: BaseException) -> BaseException:
    """Return what was about to be told when Ctrl-C came in between."""
    found: BaseException | None = stopped
    while found is not None and not isinstance(found, MavCompassError):
        found = found.__cause__ or found.__context__
    return found or stopped


def _log_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Keep what libraries warn of off the terminal: it is for the log (`-v`)."""
    import logging

    logging.getLogger("mavcompass").info("%s:%d: %s: %s", filename, lineno, category.__name__, message)


def _complain(sentence: str) -> None:
    head = styled("mavcompass:", fg="red", bold=True, err=True)
    print(wrapped(f"{head} {sentence}", sys.stderr), file=sys.stderr)


def _log_traceback(error: BaseException, level: Literal["debug", "info"]) -> None:
    import logging

    getattr(logging.getLogger("mavcompass"), level)("where it happened", exc_info=error)
