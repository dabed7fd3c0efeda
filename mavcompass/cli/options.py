"""What every command understands: `-v`, and `--json FILE` for the machine-readable result."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from mavcompass.cli.terminal.lines import wrapped
from mavcompass.files import write_text
from mavcompass.printable import did_you_mean, plain, printable

Function = TypeVar("Function", bound=Callable[..., Any])

_VERBOSITY = "mavcompass.verbosity"


class _Range:
    """Spell a range of numbers as people write it."""

    name = "number"
    min: float
    max: float | None

    def _describe_range(self) -> str:
        return f"at least {self.min:g}" if self.max is None else f"{self.min:g} to {self.max:g}"


class Number(_Range, click.FloatRange):  # type: ignore[misc]
    """Be a number in a range."""


class Whole(_Range, click.IntRange):  # type: ignore[misc]
    """Be a whole number in a range."""


class Commands(click.Group):
    """Be a command with commands: each with its whole first sentence, and a guess where none is meant."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; a near miss is told, and a SOURCE that lacks its command."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            guess = did_you_mean(args[0], self.list_commands(ctx)).removeprefix(", ")
            if not guess:
                raise
            raise click.UsageError(f"{error.message} {guess[0].upper()}{guess[1:]}", ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write them."""
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(n, c.get_short_help_str(_WHOLE)) for n, c in found if c is not None])


_WHOLE = 1000  # letters: more than any first sentence has


class Grouped(click.Command):
    """Be a command with so many options that its help tells them in groups, each with an example."""

    def __init__(self, *args: Any, groups: Mapping[str, tuple[str, tuple[str, ...]]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, group by group; what is in none comes last."""
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        left = {option.name: r for option in options if (r := option.get_help_record(ctx)) is not None}
        for title, (example, names) in self.groups.items():
            with formatter.section(title):
                formatter.write_dl([left.pop(name) for name in names if name in left])
                formatter.write_text(f"e.g. {ctx.command_path} {example}")
        with formatter.section("Beside"):
            formatter.write_dl(list(left.values()))


def to_json(document: object, indent: int | None = None) -> str:
    """Write plain values, arrays, paths and enums as JSON; a number that is not finite becomes null."""
    return json.dumps(plain(document), indent=indent, allow_nan=False)


class Output:
    """Carry a command's words to a person, and its result to a program.

    With `--json -` standard output holds the JSON document and nothing else.
    """

    def __init__(self, json_file: str | None = None, verbose: bool = False) -> None:
        self.json_file = json_file
        self.verbose = verbose

    def say(self, *lines: str) -> None:
        """Print lines for a person on standard output, unless that belongs to the JSON document.

        What is no letter is spelt out, but for a terminal's colours: names of files may hold anything.
        """
        if self.json_file != "-":
            kept = r"(\x1b\[[\d;]*m)" if sys.stdout.isatty() else "(?!)()"
            for line in lines or ("",):
                parts = re.split(kept, line)
                text = "".join(part if at % 2 else printable(part) for at, part in enumerate(parts))
                _print(wrapped(text, sys.stdout))

    def write_json(self, document: Mapping[str, object]) -> None:
        """Write the result where `--json` asked for it; without `--json` do nothing."""
        if self.json_file is None:
            return
        text = to_json(document, indent=2)
        if self.json_file == "-":
            _print(text)
            return
        write_text(Path(self.json_file), f"{text}\n")


def _print(text: str) -> None:
    """Print a result; that its reader has gone away is no reason to leave the rest undone."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        discard_standard_output()


def discard_standard_output() -> None:
    """Send what is still buffered, and what is to come, nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _output(context: click.Context, parameter: click.Parameter, value: str | None) -> Output:
    if value is not None and value != "-" and not Path(value).absolute().parent.is_dir():
        raise click.BadParameter(f"the folder of {value} does not exist.", context, parameter)
    return Output(value, verbose=bool(context.meta.get(_VERBOSITY)))


def _raise_verbosity(context: click.Context, parameter: click.Parameter, value: int) -> None:
    if not value:
        return
    import logging

    total = context.meta[_VERBOSITY] = context.meta.get(_VERBOSITY, 0) + value  # before and after the command
    form = "%(asctime)s %(levelname)s %(name)s: %(message)s"
    logging.basicConfig(stream=sys.stderr, format=form, force=True)
    logging.getLogger("mavcompass").setLevel(logging.INFO if total == 1 else logging.DEBUG)


# A file to be written, and one to be read.
FILE = click.Path(dir_okay=False, path_type=Path)
THERE = click.Path(exists=True, dir_okay=False, path_type=Path)
report_option = click.option("--report", "report_file", type=FILE, help="Write an HTML report.")


def gathered(kind: type[Any], name: str) -> Callable[[Function], Function]:
    """Hand a command those of its options that are fields of a dataclass as one argument of this name."""

    def decorate(function: Function) -> Function:
        @wraps(function)
        def call(**options: Any) -> Any:
            own = {item.name: options.pop(item.name) for item in fields(kind)}
            return function(**{name: kind(**own)}, **options)

        return cast(Function, call)

    return decorate


def verbose_option(function: Function) -> Function:
    """Let a command take `-v`; it handles it itself and passes nothing to the function."""
    return click.option(
        "-v",
        "--verbose",
        count=True,
        expose_value=False,
        is_eager=True,
        callback=_raise_verbosity,
        help="Tell more, and log to standard error; -vv logs more.",
    )(function)


def common_options(function: Function) -> Function:
    """Let a command take `-v` and `--json FILE`; the function gets the argument `output: Output`."""
    json_option = click.option(
        "--json",
        "output",
        metavar="FILE",
        callback=_output,
        help="Write the machine-readable result to FILE; - is standard output.",
    )
    return json_option(verbose_option(function))
