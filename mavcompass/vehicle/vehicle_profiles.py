"""How each kind of vehicle is turned, read from `params/vehicles/*.toml`: plain numbers and words."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from mavcompass.data_files import params_path
from mavcompass.errors import MavCompassError
from mavcompass.units import RAD_PER_DEG


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Hold how one kind of vehicle is turned.

    Attributes:
        name: the file's name. autopilot: "ardupilot" or "px4". kinds: vehicles it is for, as in
            `procedure.vehicle_state`, with "ackermann-rover" for one that cannot pivot.
        ways: the ways to turn it by the names that a person is told, best first.
        turn_rate_radps: of the turn. slow_down_s: the rate is at most what is left divided by this.
        coast_s: angle coasted after the last command, per rate at that moment.
        dwell_s, settle_s, patience_s: how long it stands, rests before, and may hunt before.
        stream_rate_hz: at which the compass and the gyro are asked for.
        tilt_limit_rad, rate_limit_radps, drift_limit_m: beyond these the motion is ended.
    """

    name: str
    autopilot: str
    kinds: tuple[str, ...]
    ways: tuple[str, ...]
    turn_rate_radps: float
    slow_down_s: float
    coast_s: float
    dwell_s: float
    settle_s: float
    patience_s: float
    stream_rate_hz: float
    tilt_limit_rad: float
    rate_limit_radps: float
    drift_limit_m: float


def vehicle_profile(kind: str, autopilot: str, ackermann: bool = False) -> VehicleProfile | None:
    """Choose the profile of a vehicle; None where only a person can turn it."""
    wanted = "ackermann-rover" if ackermann and kind == "rover" else kind
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
    turn, dwell, limits = document["turn"], document["dwell"], document["limits"]
    return VehicleProfile(
        name=name,
        autopilot=str(document["autopilot"]),
        kinds=tuple(map(str, document["kinds"])),
        ways=tuple(map(str, turn["ways"])),
        turn_rate_radps=_positive(turn["rate_deg_s"]) * RAD_PER_DEG,
        slow_down_s=_positive(turn["slow_down_s"]),
        coast_s=_positive(turn["coast_s"]),
        dwell_s=_positive(dwell["dwell_s"]),
        settle_s=_positive(dwell["settle_s"]),
        patience_s=_positive(dwell["patience_s"]),
        stream_rate_hz=_positive(document["stream"]["rate_hz"]),
        tilt_limit_rad=_positive(limits["tilt_deg"]) * RAD_PER_DEG,
        rate_limit_radps=_positive(limits["rate_deg_s"]) * RAD_PER_DEG,
        drift_limit_m=_positive(limits["drift_m"]),
    )


def _positive(value: float) -> float:
    if not value > 0.0:
        raise ValueError(f"{value} is not positive")
    return float(value)
