"""How each kind of vehicle is turned, read from `params/vehicles/*.toml`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from mavcompass.data_files import params_path
from mavcompass.errors import MavCompassError
from mavcompass.procedure.positions import DwellSettings
from mavcompass.procedure.safety import SafetyLimits
from mavcompass.procedure.turning import (
    STAND_AND_YAW_RATE,
    YAW_RATE_ONLY,
    ConditionYawTurn,
    TurnStrategy,
    YawRateTurn,
)


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Hold how one kind of vehicle is turned.

    Attributes:
        name: the file's name. autopilot: "ardupilot" or "px4". kinds: vehicles it is for, as in
            `procedure.vehicle_state`, with "ackermann-rover" for one that cannot pivot.
        strategies: the ways to turn it, best first.
        stream_rate_hz: at which the compass and the gyro are asked for.
    """

    name: str
    autopilot: str
    kinds: tuple[str, ...]
    strategies: tuple[TurnStrategy, ...]
    dwell: DwellSettings
    stream_rate_hz: float
    limits: SafetyLimits


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
    dwell, limits = document["dwell"], document["limits"]
    return VehicleProfile(
        name=name,
        autopilot=str(document["autopilot"]),
        kinds=tuple(document["kinds"]),
        strategies=tuple(_strategy(entry) for entry in document["turn"]["strategies"]),
        dwell=DwellSettings(
            dwell_s=float(dwell["dwell_s"]),
            settle_s=float(dwell["settle_s"]),
            patience_s=float(dwell["patience_s"]),
        ),
        stream_rate_hz=float(document["stream"]["rate_hz"]),
        limits=SafetyLimits(
            tilt_rad=math.radians(limits["tilt_deg"]),
            rate_radps=math.radians(limits["rate_deg_s"]),
            drift_m=float(limits["drift_m"]),
        ),
    )


def _strategy(entry: Mapping[str, Any]) -> TurnStrategy:
    return _WAYS[entry["way"]](entry)


def _yaw_rate(entry: Mapping[str, Any]) -> TurnStrategy:
    return YawRateTurn(YAW_RATE_ONLY, _radps(entry, "rate"), _radps(entry, "slowest"))


def _standing_yaw_rate(entry: Mapping[str, Any]) -> TurnStrategy:
    rate, slowest = _radps(entry, "rate"), _radps(entry, "slowest")
    return YawRateTurn(STAND_AND_YAW_RATE, rate, slowest, name="yaw rate targets at a standstill")


def _arcs(entry: Mapping[str, Any]) -> TurnStrategy:
    rate, slowest = _radps(entry, "rate"), _radps(entry, "slowest")
    return YawRateTurn(STAND_AND_YAW_RATE, rate, slowest, float(entry["forward_mps"]), "slow arcs")


def _condition_yaw(entry: Mapping[str, Any]) -> TurnStrategy:
    return ConditionYawTurn(_radps(entry, "rate"))


def _radps(entry: Mapping[str, Any], which: str) -> float:
    return math.radians(entry[f"{which}_deg_s"])


_WAYS: dict[str, Callable[[Mapping[str, Any]], TurnStrategy]] = {
    "yaw-rate": _yaw_rate,
    "standing-yaw-rate": _standing_yaw_rate,
    "arcs": _arcs,
    "condition-yaw": _condition_yaw,
}
