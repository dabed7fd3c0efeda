"""What goes wrong, at any step or to one message."""

from __future__ import annotations

import errno
import random
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta, tzinfo
from unittest.mock import patch

from fault_cells.scene import Carried, Fault, Scene, Step
from mavcompass.enums import MavResult
from mavcompass.messages import CommandAck, CommandLong, Message, ParamSet, ParamValue, message_id
from mavcompass.messages.dialect import describe

_ELSEWHERE, _ANOTHER = 42, 99
_GROUND_STATION = (255, 190)
_ODD = (0.0, -1.0, 1.0, 7.5, 1e30, float("inf"), float("nan"))
_LATE_S = (0.3, 1.0, 3.0)


# --- to one message ---------------------------------------------------------------------------------


def lost(scene: Scene, carried: Carried) -> list[Carried]:
    """Lose it."""
    return []


def late(scene: Scene, carried: Carried) -> list[Carried]:
    """Hold it back, for longer than a request is waited for or not."""
    return [replace(carried, delay_s=scene.chance.choice(_LATE_S))]


def twice(scene: Scene, carried: Carried) -> list[Carried]:
    """Bring it twice, the second time at once or much later."""
    return [carried, replace(carried, delay_s=scene.chance.choice((0.0, *_LATE_S)))]


def reordered(scene: Scene, carried: Carried) -> list[Carried]:
    """Let the next one of the same way overtake it."""
    scene.held[carried.way] = carried
    return []


def wrong_value(scene: Scene, carried: Carried) -> list[Carried]:
    """Change one field of it."""
    return [replace(carried, message=_changed(carried.message, scene.chance))]


def wrong_system(scene: Scene, carried: Carried) -> list[Carried]:
    """Have it come from another system."""
    return [replace(carried, system=_ELSEWHERE)]


def wrong_component(scene: Scene, carried: Carried) -> list[Carried]:
    """Have it come from another component."""
    return [replace(carried, component=_ANOTHER)]


def echo(scene: Scene, carried: Carried) -> list[Carried]:
    """Have somebody answer in the vehicle's name: what was asked is swallowed, or contradicted."""
    message = carried.message
    answer: Message | None = None
    match message:
        case ParamSet():
            answer = ParamValue(message.param_id, message.param_value, message.param_type, 1, 65535)
        case CommandLong():
            answer = CommandAck(message.command, MavResult.ACCEPTED)
        case ParamValue():
            return [
                replace(carried, message=replace(message, param_value=message.param_value + 3.0)),
                carried,
            ]
        case CommandAck():
            return [replace(carried, message=replace(message, result=MavResult.FAILED)), carried]
    if answer is None:
        return [carried, carried]
    return [Carried("hear", answer, 1, 1)]


def _changed(message: Message, chance: random.Random) -> Message:
    numbers = [f for f in fields(message) if f.name not in ("target_system", "target_component")]
    chosen = chance.choice(numbers)
    value = getattr(message, chosen.name)
    if isinstance(value, str):
        return replace(message, **{chosen.name: value[:-1] + "Q"})
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return message
    if isinstance(value, float):
        return replace(message, **{chosen.name: chance.choice(_ODD)})
    least, most = _extremes(message, chosen.name)
    return replace(message, **{chosen.name: chance.choice((0, 1, 3, 127, value ^ 1, least, most))})


def _extremes(message: Message, name: str) -> tuple[int, int]:
    """Return the least and the most that a field can say."""
    description = describe(message_id(type(message)))
    assert description is not None
    (code,) = (f.code for f in description.fields if f.name == name)
    bits = 8 * struct.calcsize(f"<{code}")
    return (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


# --- at any step ------------------------------------------------------------------------------------


def closed(scene: Scene) -> None:
    """Close the link for good; it is there again when it is opened again."""
    scene.closed = True


def silent_short(scene: Scene) -> None:
    """Carry nothing for two seconds."""
    scene.silent_until_s = scene.vehicle.time_s + 2.0


def silent_long(scene: Scene) -> None:
    """Carry nothing for fifteen seconds."""
    scene.silent_until_s = scene.vehicle.time_s + 15.0


def rebooted(scene: Scene) -> None:
    """Restart the autopilot, which keeps its parameters."""
    scene.vehicle.reboot()


def rebooted_old(scene: Scene) -> None:
    """Restart the autopilot, which had not stored what was written yet."""
    store = scene.vehicle.firmware.store
    for name, value in scene.before.items():
        if store[name] != value:
            store.set(name, value)
            scene.foreign[name], scene.foreign_s = value, scene.vehicle.time_s
    scene.vehicle.reboot()


def killed(scene: Scene) -> None:
    """Kill the program."""
    scene.dead = True


def disk_full(scene: Scene) -> None:
    """Fill the disk."""
    scene.disk_error = errno.ENOSPC


def read_only(scene: Scene) -> None:
    """Make the folder one that cannot be written to."""
    scene.disk_error = errno.EROFS


def suspended(scene: Scene) -> None:
    """Let the computer sleep for half a minute."""
    scene.leap_s = 30.0


def clock_back(scene: Scene) -> None:
    """Set the computer's clock back by a day: undo files must keep their order."""
    scene.clock_off_s = -86400.0


def clock_forward(scene: Scene) -> None:
    """Set the computer's clock forward by thirty years."""
    scene.clock_off_s = 30 * 365.25 * 86400.0


def second_client(scene: Scene) -> None:
    """Have a ground station write the same parameters, once or again and again."""
    store = scene.vehicle.firmware.store
    names = scene.chance.sample(sorted(scene.touched), min(2, len(scene.touched)))

    def write() -> None:
        for name in names:
            value = store[name] + (2.0 if name.startswith("COMPASS_OFS") else 0.01)
            scene.foreign[name], scene.foreign_s = value, scene.vehicle.time_s
            message = ParamSet(1, 1, name, value, store.type(name))
            scene.vehicle.receive(message, *_GROUND_STATION, 0)

    write()
    for k in range(scene.chance.choice((0, 0, 5))):
        scene.at(scene.vehicle.time_s + 0.4 * (k + 1), write)


def low_battery(scene: Scene) -> None:
    """Let the battery run low."""
    scene.vehicle.battery_failsafe()


FAULTS = (
    Fault("lost", carry=lost),
    Fault("late", carry=late),
    Fault("twice", carry=twice),
    Fault("reordered", carry=reordered),
    Fault("wrong value", carry=wrong_value),
    Fault("wrong system", carry=wrong_system),
    Fault("wrong component", carry=wrong_component),
    Fault("false echo", carry=echo),
    Fault("link closed", closed, ends_it=True),
    Fault("silent 2 s", silent_short),
    Fault("silent 15 s", silent_long, ends_it=True),
    Fault("rebooted", rebooted, ends_it=True),
    Fault("rebooted, old", rebooted_old, ends_it=True),
    Fault("killed", killed, ends_it=True),
    Fault("disk full", disk_full),
    Fault("read-only", read_only),
    Fault("suspended 30 s", suspended),
    Fault("clock back", clock_back),
    Fault("clock forward", clock_forward),
    Fault("second client", second_client),
    Fault("low battery", low_battery, ends_it=True),
)


def applies(fault: Fault, step: Step) -> bool:
    """Tell whether a fault can happen at a step."""
    if fault.name == "false echo":
        return step.what in ("ParamSet", "CommandLong", "ParamValue", "CommandAck")
    return fault.carry is None or step.kind in ("send", "hear")


@contextmanager
def clock_of(scene: Scene) -> Iterator[None]:
    """Give undo files the scene's clock."""

    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz or UTC) + timedelta(seconds=scene.clock_off_s)

    with patch("mavcompass.vehicle.parameters.undo.datetime", Clock):
        yield
