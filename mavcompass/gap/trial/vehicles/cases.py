"""Make a case: a vehicle, a healthy baseline of it, and a flight with effects that are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.gap.trial.vehicles.draw import KINDS, Site, Vehicle, draw_site, draw_vehicle
from mavcompass.gap.trial.vehicles.effects.known import (
    ELECTRONICS,
    FIELDS,
    FLOOR_MGAUSS,
    LARGEST,
    SMALLEST,
    Kind,
    sized,
)
from mavcompass.gap.trial.vehicles.effects.outside import OUTSIDE
from mavcompass.gap.trial.vehicles.motion import MOTIONS, ON_THE_WAY, Motion, move
from mavcompass.gap.trial.vehicles.record import record
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, loads_of, scene_of
from mavcompass.track import Track

Tier = Literal["none", "single", "pair", "outside"]
TIERS: tuple[Tier, ...] = ("none", "single", "pair", "outside")
CATALOGUE = (*FIELDS, *ELECTRONICS)
_SHORTEST_S = 60.0
_LONGEST_BASELINE_S = 240.0
_WARMER_BY_DEGC = 3.0
_NEAR_M = 40.0
# Within one of these a second effect would only be another size of the first, or hide it.
_NOT_TOGETHER = (
    {"transport_lag", "low_pass", "eddy_current"},
    {"orientation", "misalignment"},
    {"quantisation", "noise_excess"},
)


@dataclass(frozen=True)
class VehicleCase:
    """Hold a case and all that is true of it.

    Attributes:
        track: the flight to be diagnosed; baseline: the same vehicle in its healthy state, or None.
        effects: (id, parameters) in the order in which they act, named and in the units of the catalogue.
        clean_nominal_mgauss, clean_mgauss: the raw readings without noise, without and with the effects, at
            the times of `track`'s compass rows, (N, 3). What an effect draws by chance is in the latter.
        words: what it is like. vehicle: as it was drawn; None of another maker's.

    Both tracks hold the true attitude as `truth_q`, for judging only.
    """

    track: Track
    baseline: Track | None
    effects: tuple[tuple[str, dict[str, float]], ...]
    clean_nominal_mgauss: Array
    clean_mgauss: Array
    words: str
    vehicle: Vehicle | None = None


def make_case(seed: int, tier: Tier, baseline: bool = True) -> VehicleCase:
    """Make the case of a seed: the same each time. The flight is the same with and without a baseline.

    Raises ValueError for a tier that does not exist.
    """
    if tier not in TIERS:
        raise ValueError(f"no tier {tier!r}: there are {', '.join(TIERS)}")
    root = np.random.default_rng([seed, TIERS.index(tier)])
    choosing, building, flying, grounding, sizing, noise, other_noise = root.spawn(7)
    wanted = _choose(tier, choosing)
    needs = frozenset[str]().union(*(kind.needs for kind in wanted))
    kind, motion_name = _vehicle_for(needs, choosing)
    vehicle = draw_vehicle(
        building, kind, averaged=False if "each_row" in needs else None, precise="way" in needs
    )
    elsewhere = building.random() < 0.1
    site = draw_site(building, vehicle.utc_s, near=vehicle.site) if elsewhere else vehicle.site
    ambient = float(building.uniform(-2.0, 32.0))
    flight = _scene(vehicle, motion_name, site, ambient, needs, _duration(flying), flying)
    effects = tuple(sorted(_effects(wanted, flight, sizing, tier), key=_order))
    lost = float(flying.uniform(0.0, 0.05)) if flying.random() < 1.0 / 3.0 else 0.0
    flown = record(flight, site, effects, lost, noise)
    before = None
    base_name = _baseline_motion(kind, motion_name, grounding)
    if baseline:
        seconds = min(_duration(grounding), _LONGEST_BASELINE_S)
        day = ambient + float(grounding.normal(0.0, 4.0))
        ground = _scene(vehicle, base_name, vehicle.site, day, frozenset(), seconds, grounding)
        base_lost = float(grounding.uniform(0.0, 0.05)) if grounding.random() < 1.0 / 3.0 else 0.0
        before = record(ground, vehicle.site, (), base_lost, other_noise).track
    return VehicleCase(
        track=flown.track,
        baseline=before,
        effects=tuple((effect.id, dict(effect.parameters)) for effect in effects),
        clean_nominal_mgauss=flown.nominal_mgauss,
        clean_mgauss=flown.changed_mgauss,
        words=f"{kind} {motion_name}",
        vehicle=vehicle,
    )


def _choose(tier: Tier, rng: np.random.Generator) -> list[Kind]:
    count = {"none": 0, "single": 1, "pair": 2, "outside": 1}[tier]
    if tier == "outside":
        return [OUTSIDE[rng.integers(len(OUTSIDE))]]
    chosen: list[Kind] = []
    while len(chosen) < count:
        kind = CATALOGUE[rng.integers(len(CATALOGUE))]
        if _fits(kind, chosen):
            chosen.append(kind)
    return chosen


def _fits(kind: Kind, beside: list[Kind]) -> bool:
    ids = {other.id for other in beside}
    return kind.id not in ids and not any(kind.id in group and ids & group for group in _NOT_TOGETHER)


def _allowed(kind: str, motion: str, needs: frozenset[str]) -> bool:
    """Tell whether a kind of vehicle in a motion shows what effects need."""
    under_way = motion in ON_THE_WAY
    working = motion != "hand" and not (kind == "copter" and motion == "four_positions")
    return (
        ("way" not in needs or under_way)
        and ("loads" not in needs or working)
        and ("near" not in needs or kind != "copter")
        and ("altitude" not in needs or (kind == "copter" and under_way))
        and ("wheels" not in needs or (kind.endswith("rover") and under_way))
    )


def _vehicle_for(needs: frozenset[str], rng: np.random.Generator) -> tuple[str, str]:
    while True:
        kind = KINDS[rng.integers(len(KINDS))]
        name = MOTIONS[kind][rng.integers(len(MOTIONS[kind]))]
        if _allowed(kind, name, needs):
            return kind, name


def _baseline_motion(kind: str, flight: str, rng: np.random.Generator) -> str:
    others = [name for name in MOTIONS[kind] if name != flight]
    return flight if rng.random() < 0.5 else others[rng.integers(len(others))]


def _duration(rng: np.random.Generator) -> float:
    """Draw 60 to 600 s, about 150 s in the mean."""
    return float(_SHORTEST_S * 10.0 ** (rng.random() ** 2.5))


def _scene(
    vehicle: Vehicle,
    name: str,
    site: Site,
    ambient_degc: float,
    needs: frozenset[str],
    seconds: float,
    rng: np.random.Generator,
) -> Scene:
    motion = move(vehicle.kind, name, seconds, rng)
    for _ in range(20):
        if "near" not in needs or _is_near(motion):
            break
        motion = move(vehicle.kind, name, seconds, rng)
    loads = loads_of(vehicle.kind, motion, ambient_degc, rng)
    for _ in range(20):
        if "warming" not in needs or float(np.ptp(loads.temperature_degc)) > _WARMER_BY_DEGC:
            break
        loads = loads_of(vehicle.kind, motion, ambient_degc, rng)
    return scene_of(vehicle, motion, loads, site.field_mgauss, rng)


def _effects(wanted: list[Kind], scene: Scene, rng: np.random.Generator, tier: Tier) -> list[Effect]:
    """Size the wanted effects; one that this flight cannot show gives way to another that it can."""
    offered = OUTSIDE if tier == "outside" else CATALOGUE
    found: list[Effect] = []
    kinds: list[Kind] = []
    for kind in wanted:
        target = FLOOR_MGAUSS * float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
        effect = next((e for _ in range(3) if (e := sized(kind, scene, target, rng)) is not None), None)
        while effect is None:
            kind = offered[rng.integers(len(offered))]
            if _shown(kind, scene) and _fits(kind, kinds + [k for k in wanted if k is not kind]):
                effect = sized(kind, scene, target, rng)
        found.append(effect)
        kinds.append(kind)
    return found


def _is_near(motion: Motion) -> bool:
    return float(np.ptp(motion.position_m, axis=0).max()) < _NEAR_M


def _shown(kind: Kind, scene: Scene) -> bool:
    if "each_row" in kind.needs and scene.compass.averaged:
        return False
    if "warming" in kind.needs and float(np.ptp(scene.loads.temperature_degc)) < _WARMER_BY_DEGC:
        return False
    if "near" in kind.needs and not _is_near(scene.motion):
        return False
    return _allowed(scene.vehicle.kind, scene.motion.name, kind.needs)


def _order(effect: Effect) -> tuple[int, int]:
    ids = [kind.id for kind in (*CATALOGUE, *OUTSIDE)]
    at_the_end = {"quantisation": 1, "clipping": 2, "stale_samples": 3}
    return int(effect.stage), 1000 * at_the_end.get(effect.id, 0) + ids.index(effect.id)
