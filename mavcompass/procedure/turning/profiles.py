"""How each kind of vehicle is turned: its ways, best first, read from `params/vehicles/*.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

from mavcompass.errors import MavCompassError
from mavcompass.installation.doors import modules_in
from mavcompass.installation.parts import params_path
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.turning import ways
from mavcompass.procedure.turning.pilots_controls import TurnBy, turn_by_controls
from mavcompass.procedure.turning.steered import Builder, SteeredTurn, TurnWay
from mavcompass.units import RAD_PER_DEG


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Hold how one kind of vehicle is turned.

    Attributes:
        name: the file's name. autopilot: "ardupilot" or "px4". kinds: vehicles it is for, as in
            `vehicle_state`, with "ackermann-rover" and "ackermann-boat" for those that cannot pivot.
        ways: best first; the next is tried where the gyro sees no motion.
        drift_m: the room that its turning takes, where that is more than usual; else 0.
    """

    name: str
    autopilot: str
    kinds: tuple[str, ...]
    ways: tuple[TurnWay, ...]
    drift_m: float = 0.0


def vehicle_profile(kind: str, autopilot: str, ackermann: bool = False) -> VehicleProfile | None:
    """Choose the profile of a vehicle; None where only a person can turn it."""
    wanted = f"ackermann-{kind}" if ackermann and kind in ("rover", "boat") else kind
    for profile in vehicle_profiles():
        if profile.autopilot == autopilot and wanted in profile.kinds:
            return profile
    return None


@lru_cache
def vehicle_profiles() -> tuple[VehicleProfile, ...]:
    """Read all profiles; raises MavCompassError where a file is damaged."""
    profiles = []
    for path in sorted(params_path("vehicles").glob("*.toml")):
        try:
            profiles.append(_profile(path.stem, tomllib.loads(path.read_text(encoding="utf-8"))))
        except (ValueError, KeyError, TypeError) as error:
            raise MavCompassError(
                f"The vehicle profile {path} cannot be used ({type(error).__name__}: {error}).",
                "Correct the file, or install mavcompass again.",
            ) from error
    return tuple(profiles)


def _profile(name: str, document: Mapping[str, Any]) -> VehicleProfile:
    known = {"autopilot", "kinds", "turn", "drift_m"}
    if not known.issuperset(document):
        raise ValueError(f"unknown: {', '.join(sorted(set(document) - known))}")
    ways = tuple(_way(table) for table in document["turn"])
    if not ways:
        raise ValueError("no way to turn")
    return VehicleProfile(
        name=name,
        autopilot=str(document["autopilot"]),
        kinds=tuple(map(str, document["kinds"])),
        ways=ways,
        drift_m=_positive(document["drift_m"]) if "drift_m" in document else 0.0,
    )


def _way(table: Mapping[str, Any]) -> TurnWay:
    numbers = {key: _positive(value) for key, value in table.items() if key != "way"}
    rates = {name: numbers.pop(f"{name}_deg_s", 0.0) * RAD_PER_DEG for name in ("rate", "round")}
    return TurnWay(
        str(table["way"]), rate_radps=_positive(rates["rate"]), round_radps=rates["round"], **numbers
    )


def _positive(value: float) -> float:
    if not value > 0.0:
        raise ValueError(f"{value} is not positive")
    return float(value)


def strategies_for(
    kind: str,
    autopilot: str,
    ackermann: bool = False,
    by: TurnBy = "auto",
    modes: ModeKeeper | None = None,
    continuous: bool = False,
) -> tuple[SteeredTurn, ...]:
    """List the ways to turn a vehicle, best first; empty where only a person can turn it.

    Which and how fast stands in `params/vehicles`. `by` other than "auto" moves the pilot's own controls
    instead, in a mode in which they steer. `modes` knows the mode before and puts it back. `continuous` lists
    those that turn it all the way round without a stop, at the rate of that.
    Raises MavCompassError where a profile names a way that does not exist.
    """
    if by != "auto":
        turn = turn_by_controls(kind, by) if autopilot == "ardupilot" else None
        return () if turn is None else (turn,)
    profile = vehicle_profile(kind, autopilot, ackermann)
    found = () if profile is None else profile.ways
    if continuous:
        found = tuple(way.all_round() for way in found if way.round_radps)
    return tuple(_strategy(way, modes) for way in found)


def turned_otherwise(kind: str, autopilot: str) -> str:
    """Say what else turns a vehicle that does not turn itself by targets; "" where that is only a person."""
    if strategies_for(kind, autopilot, by="manual-control"):
        return "; the pilot's controls do, where you allow that: --turn-by manual-control"
    return ", unless it can hover, and does (ArduPilot: QLOITER)" if kind == "plane" else ""


def _strategy(way: TurnWay, modes: ModeKeeper | None) -> SteeredTurn:
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
