"""Whatever comes over the wire, the vehicles that we play answer or keep quiet; they never break."""

from __future__ import annotations

import math
import random
from dataclasses import fields, replace
from pathlib import Path

import pytest
from far_ends import write_tlog

from mavcompass.enums import MavCmd
from mavcompass.messages import Heartbeat, Message, ParamValue, RawImu, kind_named, message_id
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.autopilot import Autopilot
from mavcompass.vehicle.replay import replayed_autopilot
from mavcompass.vehicle.wire import encode, wire_format

REQUESTS = [
    "COMMAND_LONG",
    "COMMAND_INT",
    "PARAM_SET",
    "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST",
    "SET_MODE",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_ATTITUDE_TARGET",
    "RC_CHANNELS_OVERRIDE",
    "MANUAL_CONTROL",
    "REQUEST_DATA_STREAM",
    "HEARTBEAT",
    "PARAM_VALUE",
]
ODD_NUMBERS = [0.0, 1.0, -1.0, 27.0, 90.0, math.nan, math.inf, -math.inf, 3e38, -6e22, 1e-40, 2.0**31]
COMMANDS = [int(command) for command in MavCmd]
NAMES = ["COMPASS_OFS_X", "COMPASS_DIA_X", "COMPASS_ORIENT", "CAL_MAG0_ROT", "SR0_EXTRA1", "", "é", "x" * 16]


def odd_message(chance: random.Random) -> Message:
    """Fill a request with random bytes, then aim it at the vehicle and at its soft spots."""
    kind = kind_named(chance.choice(REQUESTS))
    assert kind is not None
    form = wire_format(message_id(kind))
    assert form is not None
    message = form.decode(chance.randbytes(form.full_length))
    aimed: dict[str, object] = {
        field.name: chance.choice(ODD_NUMBERS)
        for field in fields(message)
        if isinstance(getattr(message, field.name), float) and chance.random() < 0.8
    }
    soft_spots = {"target_system": [0, 1], "target_component": [0, 1], "command": COMMANDS, "param_id": NAMES}
    soft_spots["type_mask"] = [0x9FF, 0x5FF, 0x07, 0x83, 0x9C7, 0]
    for name, values in soft_spots.items():
        if hasattr(message, name) and chance.random() < 0.9:
            aimed[name] = chance.choice(values)
    return replace(message, **aimed)


def torment(vehicle: Autopilot, seed: int, times: int) -> None:
    chance = random.Random(seed)
    for _ in range(times):
        vehicle.receive(odd_message(chance), chance.choice([1, 7, 255]), chance.choice([1, 190, 191]), 0)
        for said in vehicle.advance(vehicle.time_s + chance.choice([0.0, 0.02, 0.2])):
            if said.message is not None:
                encode(said.message)


@pytest.mark.parametrize("kind", ["rover", "copter", "px4-copter"])
def test_a_simulated_vehicle_survives_odd_requests(kind: str) -> None:
    for seed in range(2):
        torment(SimulatedAutopilot(kind, seed=seed), seed, 200)


def test_a_replayed_vehicle_survives_odd_requests(tmp_path: Path) -> None:
    said = [(0.0, 1, 1, Heartbeat(10, 3)), (0.1, 1, 1, ParamValue("COMPASS_OFS_X", 1.0))]
    path = write_tlog(tmp_path / "a.tlog", [*said, (100.0, 1, 1, RawImu())])
    for seed in range(5):
        torment(replayed_autopilot(path), seed, 300)
