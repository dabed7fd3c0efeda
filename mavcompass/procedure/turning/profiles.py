"""How each kind of vehicle is turned, read from `params/vehicles/*.toml`: plain numbers and words."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from mavcompass.errors import MavCompassError
from mavcompass.installation.data_files import params_path
from mavcompass.units import RAD_PER_DEG


@dataclass(frozen=True, slots=True)
class TurnWay:
    """Hold one way to turn a vehicle.

    Attributes:
        name: as a person is told; a file of `ways/` knows the message behind it.
        rate_radps: of the turn. slow_down_s: the rate is at most what is left divided by this.
        coast_s: angle coasted after the last command, per rate at that moment.
        gain_per_s: rate of turn per radian of heading error, for ways that name a heading.
        forward_mps: speed while turning, for what cannot turn on the spot.
        speed_up_s: the rate grows to its full size in so long.
        ends_within_s: the vehicle stands so soon after the last heading that it was told, its link dead.
    """

    name: str
    rate_radps: float
    slow_down_s: float = 0.6
    coast_s: float = 0.3
    gain_per_s: float = 2.0
    forward_mps: float = 0.0
    speed_up_s: float = 0.0
    ends_within_s: float = 1.0


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
    rate_radps = numbers.pop("rate_deg_s") * RAD_PER_DEG
    return TurnWay(str(table["way"]), rate_radps, **numbers)


def _positive(value: float) -> float:
    if not value > 0.0:
        raise ValueError(f"{value} is not positive")
    return float(value)
