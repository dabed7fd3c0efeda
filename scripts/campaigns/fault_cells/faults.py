"""What goes wrong, at any step or to one message."""

from __future__ import annotations

import errno
import random
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta, tzinfo
from typing import Any
from unittest.mock import patch

from fault_cells.scene import Carried, Fault, Scene, Step
from mavcompass.enums import MavResult
from mavcompass.messages import CommandAck, CommandLong, Message, ParamSet, ParamValue, message_id
from mavcompass.messages.dialect import describe

_ELSEWHERE, _ANOTHER = 42, 99
_GROUND_STATION = (255, 190)
_ODD = (0.0, -1.0, 1.0, 7.5, 1e30, float("inf"), float("nan"))
_LATE_S = (0.3, 1.0, 3.0)
_DAY_S = 86400.0
Carry = Callable[[Scene, Carried], list[Carried]]


# --- to one message ---------------------------------------------------------------------------------


def otherwise(**changes: Any) -> Carry:
    """Have a message come with other words on its envelope."""
    return lambda scene, carried: [replace(carried, **changes)]


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


def sets(**values: Any) -> Callable[[Scene], None]:
    """Have the scene be another from then on."""

    def happen(scene: Scene) -> None:
        for name, value in values.items():
            setattr(scene, name, value)

    return happen


def silent(seconds: float) -> Callable[[Scene], None]:
    """Carry nothing for so long."""
    return lambda scene: sets(silent_until_s=scene.vehicle.time_s + seconds)(scene)


def rebooted_old(scene: Scene) -> None:
    """Restart the autopilot, which had not stored what was written yet."""
    store = scene.vehicle.firmware.store
    for name, value in scene.before.items():
        if store[name] != value:
            store.set(name, value)
            scene.foreign[name], scene.foreign_s = value, scene.vehicle.time_s
    scene.vehicle.reboot()


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


def moves_stick(scene: Scene) -> None:
    """Have the pilot move the stick that turns this vehicle."""
    scene.vehicle.pilot_moves_stick(4 if scene.vehicle.profile.hovers else 1)


# A mode to which a pilot switches.
_OTHER_MODE = {"rover": "HOLD", "copter": "LOITER", "sub": "POSHOLD", "px4": "POSCTL"}


def switches_mode(scene: Scene) -> None:
    """Have the pilot switch the mode."""
    scene.vehicle.pilot_switches_mode(_OTHER_MODE[scene.vehicle.profile.firmware])


def disarms(scene: Scene) -> None:
    """Have the pilot disarm it; PX4 stores by itself then what it has learnt of its compass."""
    before = scene.compass_values()
    scene.vehicle.disarm()
    learnt = {name: value for name, value in scene.compass_values().items() if before[name] != value}
    scene.foreign |= learnt
    scene.foreign_s = scene.vehicle.time_s


def stops(scene: Scene) -> None:
    """Have the system ask the program to end."""
    scene.stop.reason = "Stopped by the system (SIGTERM)."


FAULTS = (
    Fault("lost", carry=lambda scene, carried: []),
    Fault("late", carry=late),
    Fault("twice", carry=twice),
    Fault("reordered", carry=reordered),
    Fault("wrong value", carry=wrong_value),
    Fault("wrong system", carry=otherwise(system=_ELSEWHERE)),
    Fault("wrong component", carry=otherwise(component=_ANOTHER)),
    Fault("false echo", carry=echo),
    Fault("link closed", sets(closed=True), ends_it=True),  # for good; opened again it is there
    Fault("silent 2 s", silent(2.0)),
    Fault("silent 15 s", silent(15.0), ends_it=True),
    Fault("rebooted", lambda scene: scene.vehicle.reboot(), ends_it=True),  # it keeps its parameters
    Fault("rebooted, old", rebooted_old, ends_it=True),
    Fault("killed", sets(dead=True), ends_it=True),
    Fault("disk full", sets(disk_error=errno.ENOSPC)),
    Fault("read-only", sets(disk_error=errno.EROFS)),
    Fault("suspended 30 s", sets(leap_s=30.0)),  # the computer sleeps
    Fault("clock back", sets(clock_off_s=-_DAY_S)),  # undo files must keep their order
    Fault("clock forward", sets(clock_off_s=30 * 365.25 * _DAY_S)),
    Fault("second client", second_client),
    Fault("low battery", lambda scene: scene.vehicle.battery_failsafe(), ends_it=True, steps_in=True),
    Fault("stick", moves_stick, ends_it=True, steps_in=True),
    Fault("mode", switches_mode, ends_it=True, steps_in=True),
    Fault("disarmed", disarms, ends_it=True, steps_in=True),
    Fault("stopped", stops, ends_it=True, steps_in=True),
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
