"""Where a file can be changed by a little, and how: an operator, a condition, a number, what is returned."""

from __future__ import annotations

import ast
import gc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
_COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
# Assertions and hints in keyword arguments: without them a right program does the same.
_HINTS = frozenset({"strict", "repr", "slots", "frozen", "kw_only", "maxlen"})


@dataclass(frozen=True)
class Site:
    """Name a place that can be changed: the file, which of its places, the line.

    Attributes:
        in_function: it runs when a test runs, not when the file is loaded.
    """

    path: str
    number: int
    line: int
    in_function: bool

    def __str__(self) -> str:
        return f"{self.path}#{self.number}"


def sites(root: Path, path: str) -> list[Site]:
    """Return all places of a file, in the order of its text."""
    tree = ast.parse((root / path).read_text())
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for statement in (function.body if isinstance(function.body, list) else [function.body])
        for node in ast.walk(statement)
    }
    return [
        Site(path, number, node.lineno, id(node) in inside) for number, (node, _) in enumerate(_changes(tree))
    ]


def mutated(root: Path, site: Site) -> tuple[ast.Module, str]:
    """Return the file with the place changed, and a line that says what was done."""
    tree = ast.parse((root / site.path).read_text())
    node, change = list(_changes(tree))[site.number]
    before = ast.unparse(node)
    change()
    return ast.fix_missing_locations(tree), f"{_short(before)}  ->  {_short(ast.unparse(node))}"


def swap(tree: ast.Module, path: Path) -> bool:
    """Give the functions that a file has defined the code of the changed one; False where that cannot be."""
    code_of: dict[tuple[str, int], CodeType | None] = {}
    for code in _codes(compile(tree, str(path), "exec", dont_inherit=True)):
        place = code.co_qualname, code.co_firstlineno
        code_of[place] = None if place in code_of else code  # of two in a line none can be told
    for thing in gc.get_objects():
        if type(thing) is FunctionType and thing.__code__.co_filename == str(path):
            code = code_of.get((thing.__code__.co_qualname, thing.__code__.co_firstlineno))
            try:
                thing.__code__ = code or thing.__code__
            except ValueError:  # it uses other names of what is around it
                return False
    return True


def _codes(code: CodeType) -> Iterator[CodeType]:
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield part
            yield from _codes(part)


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 80 else line[:77] + "..."


def _changes(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, Callable[[], None]]]:
    """Give each node that can be changed with what changes it."""
    left_out = {id(node) for part in _left_out(tree) for node in ast.walk(part)}
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        match node:
            case ast.Compare(ops=operators):
                for which, operator in enumerate(operators):
                    if type(operator) in _COMPARED:
                        yield node, partial(operators.__setitem__, which, _COMPARED[type(operator)]())
            case ast.BinOp(op=operator) if type(operator) in _COMPUTED:
                yield node, partial(setattr, node, "op", _COMPUTED[type(operator)]())
            case ast.UnaryOp(op=ast.USub()):
                yield node, partial(setattr, node, "op", ast.UAdd())
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield node, partial(setattr, node, "operand", ast.UnaryOp(ast.Not(), operand))
            case ast.BoolOp(op=operator):
                yield node, partial(setattr, node, "op", ast.And() if type(operator) is ast.Or else ast.Or())
            case ast.Constant(value=bool(value)):
                yield node, partial(setattr, node, "value", not value)
            case ast.Constant(value=int(value)):
                yield node, partial(setattr, node, "value", value + 1)
            case ast.Constant(value=float(value)):
                other = 1.5 * value + (0.1 if abs(value) < 1e-3 else 0.0)
                yield node, partial(setattr, node, "value", other)
            case ast.Return(value=ast.expr()) if ast.unparse(node) != "return None":
                yield node, partial(setattr, node, "value", ast.Constant(None))
            case ast.If(test=test) | ast.IfExp(test=test):
                yield node, partial(setattr, node, "test", ast.UnaryOp(ast.Not(), test))


def _left_out(tree: ast.Module) -> Iterator[ast.AST]:
    """Find what is only said about the code: annotations, decorators, hints."""
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if isinstance(part := getattr(node, name, None), ast.AST):
                yield part
        yield from getattr(node, "decorator_list", [])
        if isinstance(node, ast.keyword) and node.arg in _HINTS:
            yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield node
