"""Pages of the documentation that are made from the code when the site is built (a hook of mkdocs).

The command line from the commands, the Python interface from its docstrings, the refusals from every place
that raises one: none of them can go stale.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

import mavcompass
from mavcompass import errors
from mavcompass.cli.main import program

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

_PYTHONS = set("self join str map sorted len error if else for in or s r f".split())
PACKAGE = Path(mavcompass.__file__).parent
_FURTHER = {  # from Python alone: the further pose, the turn back, the mounting
    "mavcompass.calibration.observation": ("observe",),
    "mavcompass.calibration.positions": ("next_pose",),
    "mavcompass.calibration.mounting": ("find_rotation",),
}
MEANING = {
    2: "the command is not right",
    3: "no vehicle, or the link was lost",
    4: "the recording cannot be used",
    5: "the calibration is not accepted",
    6: "writing failed",
    7: "stopped for safety",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages to the site."""
    from mkdocs.structure.files import File

    for name, make in (("commands", commands), ("python", python), ("refusals", refusals)):
        files.append(File.generated(config, f"reference/{name}.md", content=make()))
    return files


def on_page_markdown(markdown: str, config: MkDocsConfig, **_: object) -> str:
    """Let links to files beside docs/ lead to the repository; set equations beside their numbers."""
    linked = re.sub(r"\]\(\.\./([^)]+)\)", rf"]({config.repo_url}/blob/main/\1)", markdown)
    return re.sub(r"^\$\$\n(.*) \\tag\{(.*)\}\n\$\$\n", _equation, linked, flags=re.MULTILINE)


def _equation(found: re.Match[str]) -> str:
    """Set an equation in MathML, which browsers draw by themselves, its number beside it."""
    from latex2mathml.converter import convert

    return f'<div class="equation">{convert(found[1], display="block")}<span>({found[2]})</span></div>\n'


def commands() -> str:
    """Write what `--help` says of every command."""
    lines = ["# Commands", "", "What `--help` says, of every command.", ""]
    context = click.Context(program, info_name="mavcompass")
    for name in program.list_commands(context):
        command = program.get_command(context, name)
        assert command is not None
        lines += _command(command, click.Context(command, context, info_name=name), 2)
    return "\n".join(lines)


def _command(command: click.Command, context: click.Context, level: int) -> Iterator[str]:
    yield f"{'#' * level} {context.command_path}"
    yield ""
    text = inspect.cleandoc(command.help or "").partition("\f")[0]
    for paragraph in text.split("\n\n"):
        if paragraph.startswith("\b\n"):
            yield from ("```text", paragraph.removeprefix("\b\n").replace("Example: ", ""), "```")
        else:
            yield _cell(paragraph)
        yield ""
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from _command(inner, click.Context(inner, context, info_name=name), level + 1)
        return
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    yield from ("```text", usage, "```", "")
    records = [r for p in command.get_params(context) if (r := p.get_help_record(context)) is not None]
    yield from ("| option | |", "|---|---|")
    for option, about in records:
        if about:
            yield f"| <code>{_cell(option)}</code> | {_cell(about)} |"
    yield ""


def python() -> str:
    """Write the docstrings of the public interface."""
    lines = ["# Python", "", "`import mavcompass` offers these; plots are in `mavcompass.plot`.", ""]
    for name in ("read_track", "calibrate", "heading", "diagnose_gap", "connect"):
        lines += _function(f"mavcompass.{name}", getattr(import_module("mavcompass.api"), name))
    vehicle = import_module("mavcompass.vehicle.connection").Vehicle
    lines += ["## Vehicle", "", *_text(vehicle), ""]
    for name, method in inspect.getmembers(vehicle, inspect.isfunction):
        if not name.startswith("_"):
            lines += _function(f"Vehicle.{name}", method, "###")
    for name in ("circle", "deviation", "residuals", "waterfall"):
        lines += _function(f"mavcompass.plot.{name}", getattr(import_module("mavcompass.plot"), name))
    lines += [
        "## Questions that no command asks",
        "",
        "Of the still positions of a recording, and of its field.",
        "",
    ]
    for place, names in _FURTHER.items():
        for name in names:
            lines += _function(f"{place}.{name}", getattr(import_module(place), name), "###")
    return "\n".join(lines)


def _function(name: str, function: object, head: str = "##") -> list[str]:
    assert callable(function)
    parameters = inspect.signature(function).parameters.values()
    written = ", ".join(_parameter(parameter) for parameter in parameters if parameter.name != "self")
    return [f"{head} {name}", "", "```python", f"{name}({written})", "```", "", *_text(function), ""]


def _parameter(parameter: inspect.Parameter) -> str:
    default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
    return f"{parameter.name}: {parameter.annotation}{default}"


def _text(thing: object) -> list[str]:
    head, _, rest = (inspect.getdoc(thing) or "").partition("\n\n")
    return [_cell(head), "", "```text", rest, "```"] if rest else [_cell(head)]


def refusals() -> str:
    """List what the program may refuse, by exit code, with its remedy."""
    by_code: dict[int, set[tuple[str, str]]] = defaultdict(set)
    for code, what, remedy in found_refusals():
        by_code[code].add((what, remedy))
    lines = [
        "# Refusals and their remedies",
        "",
        "Every refusal says what happened and what to do next. ‹Names› stand for what is filled in.",
        "",
    ]
    for code in sorted(by_code):
        lines += [f"## Exit code {code}: {MEANING[code]}", "", "| what it says | what to do |", "|---|---|"]
        lines += [
            f"| {_cell(what)} | {_cell(remedy) or '(depends on the case)'} |"
            for what, remedy in sorted(by_code[code])
        ]
        lines.append("")
    return "\n".join(lines)


@cache
def found_refusals() -> frozenset[tuple[int, str, str]]:
    """Return exit code, sentence and remedy of every place that makes an error of ours with its own words."""
    kinds = {
        name: kind
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, errors.MavCompassError) and kind.exit_code in MEANING
    }
    found = set()
    for file in PACKAGE.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        constants = _constants(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in kinds:
                words = [_words(argument, constants) for argument in node.args[:2]]
                if words and words[0]:
                    remedy = words[1] if len(words) > 1 and words[1] else ""
                    found.add((kinds[node.func.id].exit_code, words[0], remedy))
    return frozenset(found)


def _constants(tree: ast.Module) -> dict[str, ast.expr]:
    """Return what a module's capital letters stand for."""
    return {
        node.targets[0].id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }


def _words(node: ast.expr, constants: Mapping[str, ast.expr]) -> str | None:
    """Return the text of a string, or of a module's constant, with its fields as ‹names›; else None."""
    match node:
        case ast.Name(id=name) if name in constants:
            return _words(constants[name], {})
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_words(part, constants) or "" for part in parts)
        case ast.FormattedValue(value=value):
            return f"‹{_name(value)}›"
    return None


def _name(value: ast.expr) -> str:
    """Name what is filled in by the last name in the expression that is not one of Python's own."""
    names = [n for n in re.findall(r"[A-Za-z_]+", ast.unparse(value)) if n not in _PYTHONS]
    return names[-1].strip("_").replace("_", " ").lower() if names else "…"


def _cell(text: str) -> str:
    """Make a line of Markdown of a text: nothing in it is to be taken for a tag or the end of a cell."""
    line = " ".join(textwrap.dedent(text).split())
    for sign, spelt in (("&", "&amp;"), ("<", "&lt;"), ("|", "&#124;"), ("*", "&#42;"), ("[", "&#91;")):
        line = line.replace(sign, spelt)
    return line
