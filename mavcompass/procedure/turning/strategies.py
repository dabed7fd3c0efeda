"""Which ways there are to turn a vehicle, best first."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from mavcompass.errors import MavCompassError
from mavcompass.installation.additions import modules_in
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.turning import ways
from mavcompass.procedure.turning.pilots_controls import TurnBy, turn_by_controls
from mavcompass.procedure.turning.profiles import TurnWay, vehicle_profile
from mavcompass.procedure.turning.steered import Builder, TurnStrategy


def strategies_for(
    kind: str,
    autopilot: str,
    ackermann: bool = False,
    by: TurnBy = "auto",
    modes: ModeKeeper | None = None,
) -> tuple[TurnStrategy, ...]:
    """List the ways to turn a vehicle, best first; empty where only a person can turn it.

    Which and how fast stands in `params/vehicles`. `by` other than "auto" moves the pilot's own controls
    instead, in a mode in which they steer. `modes` knows the mode before and puts it back.
    Raises MavCompassError where a profile names a way that does not exist.
    """
    if by != "auto":
        turn = turn_by_controls(kind, by) if autopilot == "ardupilot" else None
        return () if turn is None else (turn,)
    profile = vehicle_profile(kind, autopilot, ackermann)
    return () if profile is None else tuple(_strategy(way, modes) for way in profile.ways)


def _strategy(way: TurnWay, modes: ModeKeeper | None) -> TurnStrategy:
    if way.name not in known_ways():
        raise MavCompassError(
            f"A vehicle profile names a way to turn that does not exist: {way.name!r}.",
            f"Choose from: {', '.join(known_ways())}.",
        )
    return known_ways()[way.name](way, modes)


@cache
def known_ways() -> Mapping[str, Builder]:
    """Return the ways to turn by name; each file of `ways/` names its own in `WAYS`."""
    return {name: build for module in modules_in(ways) for name, build in module.WAYS.items()}
