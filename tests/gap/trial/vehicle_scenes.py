"""One vehicle in one motion, for the tests of the second generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.gap.trial.vehicles.draw import Vehicle, draw_vehicle
from mavcompass.gap.trial.vehicles.motion import move
from mavcompass.gap.trial.vehicles.record import Recording, record
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, loads_of, scene_of


def vehicle_of(
    seed: int, kind: str = "rover", steering: str = "this_compass", averaged: bool = False
) -> Vehicle:
    vehicle = draw_vehicle(np.random.default_rng(seed), kind, averaged, True)
    return replace(vehicle, steering=steering, rate_hz=25.0)


def scene(vehicle: Vehicle, name: str = "figure_eight", seconds: float = 70.0, seed: int = 5) -> Scene:
    rng = np.random.default_rng(seed)
    motion = move(vehicle.kind, name, seconds, rng)
    loads = loads_of(vehicle.kind, motion, 12.0, rng)
    return scene_of(vehicle, motion, loads, vehicle.site.field_mgauss, rng)


def recorded(at: Scene, *effects: Effect, lost: float = 0.0) -> Recording:
    return record(at, at.vehicle.site, effects, lost, np.random.default_rng(9))
