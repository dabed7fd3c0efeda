"""Where a file can be changed by a little, and how: an operator, a condition, a number, what is returned.

What nobody can tell apart is not drawn: `return None` in place of `return False`, and the border of an order
of quantities with a unit or a decimal point, which no measurement meets: such an order is turned round. Nor
is half as much again of what has a private name at the top of a file and is tuned: ten times it is tried.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import shorten
from types import CodeType, FunctionType

_OTHER = ((ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.In, ast.NotIn), (ast.Is, ast.IsNot))
_COMPARED = {one: other for pair in _OTHER for one, other in (pair, pair[::-1])}
_TURNED = {**_COMPARED, ast.Lt: ast.Gt, ast.LtE: ast.Gt, ast.Gt: ast.Lt, ast.GtE: ast.Lt}
_CONTINUOUS = re.compile(r"\d\.\d|_(s|rad|deg|hz|mgauss|mps|radps|m|km|a)\b", re.IGNORECASE)
_COMPUTED = {
    **dict.fromkeys((ast.Div, ast.FloorDiv, ast.Mod, ast.Pow, ast.MatMult), ast.Mult),
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd},
}
# Assertions and hints in keyword arguments: without them a right program does the same.
_HINTS = frozenset({"strict", "repr", "slots", "frozen", "kw_only", "maxlen"})


@dataclass(frozen=True)
class Site:
    """Name a place that can be changed: the file, which of its places, the line.

    Attributes:
        names: what gets a value there as the file is loaded; None in a function, which runs when a test does.
    """

    path: str
    number: int
    line: int
    names: frozenset[str] | None

    def __str__(self) -> str:
        return f"{self.path}#{self.number}"


def sites(root: Path, path: str) -> list[Site]:
    """Return all places of a file, in the order of its text."""
    tree = ast.parse((root / path).read_text())
    names: dict[int, frozenset[str] | None] = {}
    for part in ast.walk(tree):  # from the outside in
        match part:
            case ast.Module() | ast.ClassDef():
                for statement in part.body:
                    names |= dict.fromkeys(map(id, ast.walk(statement)), _names(statement))
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda():
                body = part.body if isinstance(part.body, list) else [part.body]
                names |= dict.fromkeys((id(node) for one in body for node in ast.walk(one)), None)
    places = ((number, node) for number, (node, _) in enumerate(_changes(tree)))
    return [Site(path, number, node.lineno, names[id(node)]) for number, node in places]


def _names(statement: ast.stmt) -> frozenset[str]:
    """Return the names that a statement gives a value; for the defaults of a function, its arguments."""
    if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)):
        return frozenset(node.arg for node in ast.walk(statement.args) if isinstance(node, ast.arg))
    stored = (node for node in ast.walk(statement) if isinstance(node, ast.Name))
    return frozenset(node.id for node in stored if isinstance(node.ctx, ast.Store))


def mutated(root: Path, site: Site) -> tuple[ast.Module, str]:
    """Return the file with the place changed, and a line that says what was done."""
    tree = ast.parse((root / site.path).read_text())
    node, change = list(_changes(tree))[site.number]
    before = shorten(ast.unparse(node), 80)
    change()
    return ast.fix_missing_locations(tree), f"{before}  ->  {shorten(ast.unparse(node), 80)}"


def swap(tree: ast.Module, path: Path, functions: Iterable[FunctionType]) -> bool:
    """Give functions of a file the code that they have in the changed one; False where that cannot be."""
    code_of: dict[tuple[str, int], CodeType | None] = {}
    for code in _codes(compile(tree, str(path), "exec", dont_inherit=True)):
        place = code.co_qualname, code.co_firstlineno
        code_of[place] = None if place in code_of else code  # of two in a line none can be told
    for function in functions:
        if function.__code__.co_filename != str(path):
            continue
        code = code_of.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
        try:
            function.__code__ = code or function.__code__
        except ValueError:  # it uses other names of what is around it
            return False
    return True


def _codes(code: CodeType) -> Iterator[CodeType]:
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield part
            yield from _codes(part)


def _changes(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, Callable[[], None]]]:
    """Give each node that can be changed with what changes it."""
    left_out = {id(node) for part in _left_out(tree) for node in ast.walk(part)}
    private = [s for s in tree.body if isinstance(s, ast.Assign) and all(n[0] == "_" for n in _names(s))]
    tuned = {id(node) for statement in private for node in ast.walk(statement)}
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        match node:
            case ast.Compare(ops=operators):
                other = _TURNED if _CONTINUOUS.search(ast.unparse(node)) else _COMPARED
                for which, operator in enumerate(operators):
                    if type(operator) in other:
                        yield node, partial(operators.__setitem__, which, other[type(operator)]())
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
            case ast.Constant(value=int(value)) if value == 0 or id(node) not in tuned:
                yield node, partial(setattr, node, "value", value + 1)
            case ast.Constant(value=int(value) | float(value)):
                more = (10 if id(node) in tuned else 1.5) * value + (0.1 if abs(value) < 1e-3 else 0)
                yield node, partial(setattr, node, "value", more)
            case ast.Return(value=ast.expr()) if ast.unparse(node) not in ("return None", "return False"):
                yield node, partial(setattr, node, "value", ast.Constant(None))
            case ast.If(test=test) | ast.IfExp(test=test):
                yield node, partial(setattr, node, "test", ast.UnaryOp(ast.Not(), test))


def _left_out(tree: ast.Module) -> Iterator[ast.AST]:
    """Find what is only said about the code: annotations, decorators, hints; how finely a number is told."""
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if isinstance(part := getattr(node, name, None), ast.AST):
                yield part
        yield from getattr(node, "decorator_list", [])
        if isinstance(node, ast.keyword) and node.arg in _HINTS:
            yield node
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "round":
            yield from node.args[1:]
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield node
