"""Does `fleet diagnose` name the vehicles that are not like the others, and only these?

    python scripts/campaigns/fleet.py [--vehicles 200] [--odd 6] [--seed 1] [--rows FILE.jsonl]

A fleet of one make: rovers with the same iron, gains and field of the battery current but for what differs
from one to the next, calibrated well (within 2 %), at places of their own, driven for a minute or more. Six
are odd, each in another way. Made by the blind trial's second generator, which shares no code with simulation
or diagnosis. With --rows what was diagnosed is kept, and not done again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from campaign import ended, options

from mavcompass.correction import FieldCorrection
from mavcompass.fleet.examine import Job, Row, rows_of
from mavcompass.fleet.population import Distribution, learn
from mavcompass.gap.trial.vehicles.draw import Vehicle, draw_vehicle, unit
from mavcompass.gap.trial.vehicles.effects.known import FIELDS, changed_rms, sized
from mavcompass.gap.trial.vehicles.motion import MOTIONS, move
from mavcompass.gap.trial.vehicles.record import record
from mavcompass.gap.trial.vehicles.scene import Effect, loads_of, scene_of
from mavcompass.track import Track

ODD = ("iron", "gain", "motor", "noise", "loose magnet", "old calibration")
KIND = "rover"


def fleet(vehicles: int, odd: int, seed: int) -> Iterator[tuple[str, str, Track]]:
    """Yield each vehicle's name, what is odd about it ("" for most), and a recording of it."""
    root = np.random.default_rng([seed, 150])
    make = {
        "iron": root.uniform(60.0, 200.0) * unit(root),
        "gains": 1.0 + root.uniform(-0.08, 0.08, 3),
        "motor": root.uniform(0.3, 0.8) * unit(root),
        "noise": root.uniform(1.5, 3.0),
    }
    ways = dict(zip(root.choice(vehicles, odd, replace=False).tolist(), ODD * odd, strict=False))
    for number in range(vehicles):
        rng = np.random.default_rng([seed, 151, number])
        way = ways.get(number, "")
        yield f"vehicle-{number:03d}", way, _recording(_vehicle(make, way, rng), way, rng)


def _vehicle(make: dict[str, np.ndarray], way: str, rng: np.random.Generator) -> Vehicle:
    vehicle = draw_vehicle(rng, KIND, averaged=None, precise=False)
    iron = make["iron"] + rng.normal(0.0, 15.0, 3) + (way == "iron") * 130.0 * unit(rng)
    cross = rng.normal(0.0, 0.01, (3, 3))
    gains = make["gains"] * (1.0 + rng.normal(0.0, 0.02, 3)) * (1.0 - (way == "gain") * np.array([0.2, 0, 0]))
    matrix = np.diag(gains) + 0.5 * (cross + cross.T)
    motor = make["motor"] * rng.normal(1.0, 0.15) * (4.0 if way == "motor" else 1.0)
    noise = make["noise"] * np.exp(rng.normal(0.0, 0.12)) * (4.0 if way == "noise" else 1.0)
    believed = iron * (1.0 + rng.uniform(-0.02, 0.02, 3))
    if way == "old calibration":
        believed = believed + 70.0 * np.append(unit(rng)[:2], 0.3)
    correcting = np.linalg.inv(matrix)
    compass = replace(
        vehicle.compass,
        iron_mgauss=iron,
        matrix=matrix,
        current_field=motor,
        noise_mgauss=noise * np.ones(3),
        correction=FieldCorrection.from_matrix(
            -believed,
            0.5 * (correcting + correcting.T),
            motor_mgauss=-correcting @ motor,
            motor_source="current",
        ),
    )
    return replace(vehicle, compass=compass)


def _recording(vehicle: Vehicle, way: str, rng: np.random.Generator) -> Track:
    names = [name for name in MOTIONS[KIND] if name != "hand"]
    motion = move(KIND, str(rng.choice(names)), float(rng.uniform(60.0, 120.0)), rng)
    loads = loads_of(KIND, motion, float(rng.uniform(5.0, 30.0)), rng)
    scene = scene_of(vehicle, motion, loads, vehicle.site.field_mgauss, rng)
    effects: tuple[Effect, ...] = ()
    if way == "loose magnet":
        step = next(kind for kind in FIELDS if kind.id == "hard_iron_step")
        drawn = (sized(step, scene, 25.0, rng) for _ in range(100))
        effects = (next(one for one in drawn if one is not None and changed_rms(scene, (one,)) > 15.0),)
    return record(scene, vehicle.site, effects, 0.0, rng).track


def diagnosed(vehicles: int, odd: int, seed: int) -> Iterator[tuple[str, Row]]:
    """Yield what is odd about each vehicle, and the row of its diagnosis."""
    job = Job("diagnose", vehicle_pattern="(vehicle-[0-9]+)")
    for name, way, track in fleet(vehicles, odd, seed):
        for row in rows_of(job, f"{name}.tlog", track):
            yield way, row
            print(f"{name} {way or '-'}: {row.get('verdict')} {row.get('effects') or ''}", flush=True)


def report(pairs: list[tuple[str, Row]]) -> Distribution:
    """Learn, print what was learnt, and count."""
    distribution = learn([row for _, row in pairs])
    truth = {row["vehicle"]: way for way, row in pairs if way}
    for spread in (*distribution.whole, *distribution.effects):
        middle, low, high = spread.prevalence
        values = ", ".join(
            f"{name} {value:.3g} +- {np.sqrt(spread.spread[i, i]):.2g}"
            for i, (name, value) in enumerate(zip(spread.names, spread.location.tolist(), strict=True))
        )
        print(f"{spread.effect}: {100 * middle:.1f} % ({100 * low:.1f} to {100 * high:.1f}): {values}")
    for one in distribution.odd:
        print(
            f"odd: {one.vehicle} ({truth.get(one.vehicle, 'nothing')}): {one.words} ({one.sigmas:.1f} sigmas)"
        )
    named = {one.vehicle for one in distribution.odd}
    false = sorted(named - truth.keys())
    missed = [f"{vehicle} ({truth[vehicle]})" for vehicle in sorted(truth.keys() - named)]
    print(
        f"{distribution.vehicles} vehicles, {len(truth)} odd: {len(truth) - len(missed)} named, "
        f"{len(false)} false {false}, missed {missed}"
    )
    return distribution


def main() -> int:
    """Make, diagnose, learn, count."""
    wanted = options(__doc__, vehicles=200, odd=6, seed=1, rows=Path)
    if wanted.rows is not None and wanted.rows.exists():
        pairs = [tuple(json.loads(line)) for line in wanted.rows.read_text(encoding="utf-8").splitlines()]
    else:
        pairs = list(diagnosed(wanted.vehicles, wanted.odd, wanted.seed))
        if wanted.rows is not None:
            wanted.rows.write_text("".join(json.dumps(pair) + "\n" for pair in pairs), encoding="utf-8")
    return ended(wanted.json, report(pairs), wrong=False)


if __name__ == "__main__":
    sys.exit(main())
