"""What an export is: a file's text, the parameters in it, and what the simulator cannot hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mavcompass.simulation.effects import Setting


@dataclass(frozen=True, slots=True)
class Found:
    """Hold what is to be exported.

    Attributes:
        settings: the whole vehicle's, in the order in which they act.
        source: where they were found.
        heading_deg: what each named effect costs in heading, rms.
    """

    settings: Sequence[Setting]
    source: str = ""
    heading_deg: Mapping[str, float] = field(default_factory=dict)

    def without(self, setting: Setting, simulator: str) -> str:
        """Say that a simulator has no such thing, and what error of the heading stays for it."""
        cost = self.heading_deg.get(setting.effect.id)
        stays = "" if cost is None else f" {cost:.1f} deg of heading stay unsimulated."
        return f"{setting.effect.id}: {setting.effect.title}. {simulator} has no such thing.{stays}"


@dataclass(frozen=True, slots=True)
class Exported:
    """Hold a file for a simulator.

    Attributes:
        text: of the file. use: how a person uses it, FILE in the place of its name.
        parameters: the simulator's own, where it has some; lacking: in sentences what it cannot hold.
    """

    text: str
    use: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lacking: tuple[str, ...] = ()


def commented(mark: str, lines: Iterable[str]) -> list[str]:
    """Write sentences as comments."""
    return [f"{mark} {line}" for line in lines]
