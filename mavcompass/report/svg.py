"""A self-contained HTML file from a template of this room, and small plots in it as inline SVG.

They are scalable, light, and coloured by the page's style sheet, dark or light. A plot is built from text
pieces; dots are rounded to a tenth of a pixel, so a thousand stay below twenty kilobytes. Marks carry
classes (`old`, `new`, `point`, ...), never colours. The picture is all that paper and a reader without
scripts need, and it holds its own data: templates/plot.js reads them from the paths, and adds values under
the pointer, zoom and turning.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mavcompass import __version__
from mavcompass.files import write_text
from mavcompass.installation.parts import require
from mavcompass.printable import figure

_TEMPLATES = Path(__file__).with_name("templates")
# What makes plots answer to hands, and how they look: of the reports and of the service's page.
PLOT_PARTS = (_TEMPLATES / "plot.js", _TEMPLATES / "plot.css")
_SCRIPT = PLOT_PARTS[0].read_text("utf-8")
# Nothing is loaded, and no script runs but ours, whatever a recording's words may hold.
_HASH = base64.b64encode(hashlib.sha256(_SCRIPT.encode()).digest()).decode()
POLICY = (
    f"default-src 'none'; script-src 'sha256-{_HASH}'; style-src 'unsafe-inline'; img-src data:;"
    " base-uri 'none'; form-action 'none'"
)


def write_page(path: Path, template: str, values: Mapping[str, object]) -> None:
    """Fill a template and write the page; everything is escaped but the figures.

    Raises UsageError where the package that does it is not installed or the file cannot be written.
    """
    require("An HTML report")
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = figure
    made = {
        "policy": POLICY,
        "script": _SCRIPT,
        "made_at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": __version__,
    }
    html = environment.get_template(template).render({**values, **made})
    write_text(path, html, "The report")


_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 12.0, 12.0, 34.0


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Return about `count` round numbers that lie in [low, high]."""
    span = high - low
    if not (span > 0.0 and math.isfinite(span)):
        return [low] if math.isfinite(low) else []
    rough = span / count
    magnitude = 10.0 ** math.floor(math.log10(rough))
    step = magnitude * next(s for s in (1.0, 2.0, 5.0, 10.0) if s * magnitude >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 10) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def limits(*values: ArrayLike, least: float = 0.0) -> tuple[float, float]:
    """Return an axis's range that holds all finite values, at least `least` long."""
    everything = np.concatenate([np.ravel(np.asarray(v, dtype=np.float64)) for v in values])
    finite = everything[np.isfinite(everything)]
    if not finite.size:
        return (0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    spare = max(least - (high - low), 0.0) / 2.0 + 0.06 * max(high - low, least, 1e-9)
    return (low - spare, high + spare)


@dataclass(slots=True)
class Plot:
    """Draw in data coordinates; `render` returns the <svg> element.

    Attributes:
        x_range, y_range: what the axes show. equal: one unit is as long on both axes (for circles).
        title: for screen readers. turns: coordinates are a view of three, without axes.
    """

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    title: str = ""
    width: float = 420.0
    height: float = 300.0
    equal: bool = False
    x_ticks: Sequence[float] | None = None
    turns: bool = False
    _pieces: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Stretch the shorter axis of a plot with equal units."""
        if not self.equal:
            return
        wide, high = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
        per_pixel = max(
            (self.x_range[1] - self.x_range[0]) / wide, (self.y_range[1] - self.y_range[0]) / high
        )
        self.x_range = _about_middle(self.x_range, per_pixel * wide)
        self.y_range = _about_middle(self.y_range, per_pixel * high)

    def x(self, value: float) -> float:
        """Return the pixel of an abscissa within the axes."""
        low, high = self.x_range
        return (value - low) / (high - low) * (self.width - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        """Return the pixel of an ordinate within the axes; up is more."""
        low, high = self.y_range
        return (high - value) / (high - low) * (self.height - _TOP - _BOTTOM)

    def line(self, x: ArrayLike, y: ArrayLike, css: str, name: str = "", z: ArrayLike = ()) -> None:
        """Draw a line through points; it is broken where a value is not finite. z: towards the viewer."""
        path, pen_down = [], False
        for px, py in self._pixels(x, y):
            if px is not None:
                path.append(f"{'L' if pen_down else 'M'}{px:.2f} {py:.2f}")
            pen_down = px is not None
        self._path(f"line {css}", "".join(path), name, z)

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, css: str) -> None:
        """Fill between two lines."""
        there = [f"{px:.1f} {py:.1f}" for px, py in self._pixels(x, high) if px is not None]
        back = [f"{px:.1f} {py:.1f}" for px, py in self._pixels(x, low) if px is not None]
        self._path(f"band {css}", f"M{'L'.join(there + back[::-1])}Z" if there else "")

    def dots(
        self, x: ArrayLike, y: ArrayLike, css: str, radius: float = 1.6, name: str = "", z: ArrayLike = ()
    ) -> None:
        """Draw many dots as one element: lines without length, with round ends."""
        path = [f"M{px:.1f} {py:.1f}h0" for px, py in self._pixels(x, y) if px is not None]
        self._path(f"dots {css}", "".join(path), name, z, f' stroke-width="{2.0 * radius:.1f}"')

    def circle(self, radius: float, css: str, name: str = "") -> None:
        """Draw a circle about the origin, of a radius in data units; for plots with equal units."""
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        self.line(radius * np.sin(turn), radius * np.cos(turn), css, name)

    def text(self, x: float, y: float, words: str, dx: float = 0.0, dy: float = 0.0, z: float = 0.0) -> None:
        """Write words at a point."""
        at = f'x="{self.x(x):.1f}" y="{self.y(y):.1f}" dx="{dx:g}" dy="{dy:g}"{self._depths([z])}'
        self._pieces.append(f'<text class="mark" {at}>{escape(words)}</text>')

    def render(self) -> str:
        """Return the whole element."""
        (x0, x1), (y0, y1) = self.x_range, self.y_range
        labels = "" if self.turns else f' data-labels="{escape(self.x_label)}|{escape(self.y_label)}"'
        ticks = "" if self.x_ticks is None else f' data-ticks="{" ".join(f"{t:g}" for t in self.x_ticks)}"'
        return (
            f'<svg class="plot{" turns" * self.turns}{" equal" * self.equal}" role="img"'
            f' viewBox="0 0 {self.width:.0f} {self.height:.0f}" aria-label="{escape(self.title)}"'
            f' data-x="{x0:.6g} {x1:.6g}" data-y="{y0:.6g} {y1:.6g}"{labels}{ticks}>'
            f'<g class="axes">{"" if self.turns else self._axes()}</g>'
            f'<svg class="area" x="{_LEFT}" y="{_TOP}" width="{self.width - _LEFT - _RIGHT}"'
            f' height="{self.height - _TOP - _BOTTOM}">{"".join(self._pieces)}</svg></svg>'
        )

    def _path(self, css: str, path: str, name: str = "", z: ArrayLike = (), more: str = "") -> None:
        if path:
            title = f"<title>{escape(name)}</title>" if name else ""
            self._pieces.append(f'<path class="{css}" d="{path}"{self._depths(z)}{more}>{title}</path>')

    def _depths(self, z: ArrayLike) -> str:
        scale = (self.width - _LEFT - _RIGHT) / (self.x_range[1] - self.x_range[0])
        depths = " ".join(f"{scale * v:.1f}" for v in np.ravel(z))
        return f' data-z="{depths}"' if self.turns else ""

    def _pixels(self, x: ArrayLike, y: ArrayLike) -> Iterable[tuple[float | None, float]]:
        for vx, vy in zip(np.ravel(x), np.ravel(y), strict=True):
            known = math.isfinite(vx) and math.isfinite(vy)
            yield (self.x(float(vx)), self.y(float(vy))) if known else (None, 0.0)

    def _axes(self) -> str:
        bottom, right = self.height - _BOTTOM, self.width - _RIGHT
        pieces = []
        x_ticks = nice_ticks(*self.x_range) if self.x_ticks is None else self.x_ticks
        for tick in x_ticks:
            at = f"{_LEFT + self.x(tick):.1f}"
            css = "zero" if tick == 0.0 else "grid"
            pieces.append(
                f'<line class="{css}" x1="{at}" x2="{at}" y1="{_TOP}" y2="{bottom}"/>'
                f'<text class="tick" x="{at}" y="{bottom + 14:.1f}">{tick + 0.0:g}</text>'
            )
        for tick in nice_ticks(*self.y_range):
            at = f"{_TOP + self.y(tick):.1f}"
            css = "zero" if tick == 0.0 else "grid"
            pieces.append(
                f'<line class="{css}" x1="{_LEFT}" x2="{right}" y1="{at}" y2="{at}"/>'
                f'<text class="tick side" x="{_LEFT - 6}" y="{at}" dy="0.32em">{tick + 0.0:g}</text>'
            )
        middle_x, middle_y = (_LEFT + right) / 2, (_TOP + bottom) / 2
        label = f'<text class="label" x="{middle_x}" y="{self.height - 4}">{escape(self.x_label)}</text>'
        turned = f'transform="translate(11 {middle_y}) rotate(-90)"'
        side = f'<text class="label" {turned}>{escape(self.y_label)}</text>'
        return "".join(pieces) + label + side


def _about_middle(span: tuple[float, float], length: float) -> tuple[float, float]:
    middle = (span[0] + span[1]) / 2.0
    return (middle - length / 2.0, middle + length / 2.0)


def bars(rows: Sequence[tuple[str, float]], unit: str, title: str) -> str:
    """Draw one horizontal bar per row, longest first given, with its value beside it."""
    known = [(name, value) for name, value in rows if math.isfinite(value)]
    if not known:
        return ""
    width, step, right = 420.0, 26.0, 76.0
    left = max(6.4 * max(len(name) for name, _ in known) + 12.0, 60.0)
    most = max(value for _, value in known) or 1.0
    pieces = []
    for k, (name, value) in enumerate(known):
        y = 6.0 + k * step
        length = (width - left - right) * value / most
        pieces.append(
            f'<text class="tick side" x="{left - 8}" y="{y + 9}" dy="0.32em">{escape(name)}</text>'
            f'<rect class="bar" x="{left}" y="{y}" width="{max(length, 1.0):.1f}" height="18" rx="3"/>'
            f'<text class="mark" x="{left + max(length, 1.0) + 6:.1f}" y="{y + 9}" dy="0.32em">'
            f"{_shown(value)} {escape(unit)}</text>"
        )
    height = 10.0 + step * len(known)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(title)}">'
        f"{''.join(pieces)}</svg>"
    )


def _shown(value: float) -> str:
    if value < 0.001:
        return "&lt; 0.001"
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
