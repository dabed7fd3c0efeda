"""What an export is: a file's text, the parameters in it, and what the simulator cannot hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.export.vehicle import affine_map
from mavcompass.gap.result import Cause
from mavcompass.simulation.effects import Setting, get

_OWN_MATRIX = 1e-3
_WORTH_SAYING_MGAUSS = 0.5


@dataclass(frozen=True, slots=True)
class Found:
    """Hold what is to be exported.

    Attributes:
        settings: the whole vehicle's, in the order in which they act.
        source: where they were found.
        heading_deg: what each named effect costs in heading, rms.
        shrink: by how much the gap in the field closes with all of them.
        shares: the part of that which each named effect has.
        known: in sentences, how well the parameters of each are known.
        place_mgauss: what they leave because the field of the place is not the world model's, rms.
    """

    settings: Sequence[Setting]
    source: str = ""
    heading_deg: Mapping[str, float] = field(default_factory=dict)
    shrink: float = 0.0
    shares: Mapping[str, float] = field(default_factory=dict)
    known: tuple[str, ...] = ()
    place_mgauss: float = 0.0

    def headed(self, simulator: str) -> list[str]:
        """Return the first sentences of a file: where this comes from, and how well it is known."""
        return [f"What was found in {self.source or 'a recording'}, for {simulator}", *self.known]

    def without(self, setting: Setting, simulator: str) -> str:
        """Say that a simulator has no such thing, and what error of the heading stays for it."""
        cost = self.heading_deg.get(setting.effect.id)
        stays = "" if cost is None else f" {cost:.1f} deg of heading stay unsimulated."
        return f"{setting.effect.id}: {setting.effect.title}. {simulator} has no such thing.{stays}"

    def of_the_place(self, simulator: str) -> list[str]:
        """Say by how much the field of the place differs from the one that a simulator has."""
        if self.place_mgauss < _WORTH_SAYING_MGAUSS:
            return []
        return [f"The field of the place, {self.place_mgauss:.1f} mG. {simulator} has the world model's."]

    def offset_alone(self, simulator: str) -> tuple[FloatArray, list[str], list[str]]:
        """Return the offset (3,) in mG for a simulator that has no matrix, what that leaves out, and its
        effects."""
        matrix, offset = affine_map([s for s in self.settings if s.effect.affine])
        if np.abs(matrix - np.eye(3)).max() <= _OWN_MATRIX:
            return offset, [], []
        bent = [s.effect.id for s in self.settings if s.effect.affine and s.effect.id != "hard_iron"]
        return offset, [f"Gains, oblique axes and turns of the compass: {simulator} has none."], bent

    def promised(self, exported: Exported) -> float:
        """Return by how much the gap closes with those effects alone that an export holds."""
        return max(self.shrink - sum(self.shares.get(effect, 0.0) for effect in set(exported.left_out)), 0.0)


@dataclass(frozen=True, slots=True)
class Exported:
    """Hold a file for a simulator.

    Attributes:
        text: of the file. use: how a person uses it, FILE in the place of its name.
        parameters: the simulator's own, where it has some.
        lacking: in sentences what it cannot hold; left_out: the effects among that.
    """

    text: str
    use: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lacking: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def known_to(cause: Cause) -> str:
    """Say how well the parameters of a cause are known: a vehicle that never tilts hardly tells z."""
    units = {p.name: "" if p.unit == "1" else f" {p.unit}" for p in get(cause.effect).parameters}
    parts = [f"{name} {low:.3g} to {high:.3g}{units[name]}" for name, (low, high) in cause.ci95.items()]
    return f"{cause.effect}, 95 %: {', '.join(parts)}"


def commented(mark: str, lines: Iterable[str]) -> list[str]:
    """Write sentences as comments."""
    return [f"{mark} {line}" for line in lines]
