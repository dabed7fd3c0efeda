"""The MAVLink messages that mavcompass speaks and understands, as plain values.

Class names are the message's name in camel case: RawImu is RAW_IMU. Names, order and units of the fields are
the protocol's, as `dialect` has them; what the numbers mean as quantities of a Track is in `telemetry`. A
class is made when it is first asked for; `__init__.pyi` tells type checkers and editors what it will be.
`scripts/mavlink_messages.py` writes that; a test holds both to pymavlink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, make_dataclass
from fnmatch import fnmatchcase
from functools import cache
from typing import Any

from mavcompass.messages.dialect import Field, describe, message_ids
from mavcompass.messages.message import Incoming as Incoming
from mavcompass.messages.message import Message as Message

# Each message with what of it is not as usual: every field has a default, 0 if no other stands here; a field
# of version 2 (an extension) is left out if it does not stand here.
_SPOKEN = """
ATTITUDE
AUTOPILOT_VERSION uid2
COMMAND_ACK progress result_param2 target_system target_component
COMMAND_INT
COMMAND_LONG
EKF_STATUS_REPORT
ESTIMATOR_STATUS
EXTENDED_SYS_STATE
FENCE_STATUS
GLOBAL_POSITION_INT hdg=65535
GPS_RAW_INT eph=65535 epv=65535 vel=65535 cog=65535 satellites_visible=255 yaw
HEARTBEAT mavlink_version=3
HIGHRES_IMU id
LOCAL_POSITION_NED
MAG_CAL_PROGRESS
MAG_CAL_REPORT orientation_confidence old_orientation new_orientation scale_factor
MANUAL_CONTROL
MESSAGE_INTERVAL
NAMED_VALUE_FLOAT
PARAM_REQUEST_LIST
PARAM_REQUEST_READ param_index=-1
PARAM_SET param_type=9
PARAM_VALUE param_type=9 param_index=65535
RAW_IMU id temperature
RC_CHANNELS chan*_raw=65535 rssi=255
RC_CHANNELS_OVERRIDE chan*_raw=65535
REQUEST_DATA_STREAM
SCALED_IMU temperature
SCALED_IMU2 is SCALED_IMU
SCALED_IMU3 is SCALED_IMU
SCALED_PRESSURE
SERVO_OUTPUT_RAW
SET_ATTITUDE_TARGET q=1,0,0,0
SET_MODE
SET_POSITION_TARGET_LOCAL_NED coordinate_frame=1
SIMSTATE
STATUSTEXT severity=6 id chunk_seq
SYSTEM_TIME
SYS_STATUS current_battery=-1 battery_remaining=-1
VFR_HUD
"""
_WORDS = {words[0]: words[1:] for words in map(str.split, _SPOKEN.strip().splitlines())}
_WIRE_NAMES = {name.title().replace("_", ""): name for name in _WORDS}

__all__ = ["Incoming", "Message", "kind_named", "message_id", *_WIRE_NAMES]


def __getattr__(name: str) -> type[Message]:
    if (kind := kind_named(_WIRE_NAMES.get(name, ""))) is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = kind
    return kind


def __dir__() -> list[str]:
    return __all__


@cache
def kind_named(name: str) -> type[Message] | None:
    """Return a message's dataclass by the dialect's name, such as RAW_IMU; None for one not spoken here."""
    if name not in _WORDS:
        return None
    match _WORDS[name]:
        case ["is", other]:
            base, fields = kind_named(other), []
        case words:
            described, base = describe(message_ids()[name]), Message
            assert described is not None
            given = dict(word.partition("=")[::2] for word in words)
            fields = [_field(f, given) for f in described.declared if not f.is_extension or f.name in given]
    assert base is not None
    camel_case = name.title().replace("_", "")
    kind = make_dataclass(camel_case, fields, bases=(base,), frozen=True, slots=True)
    kind.__module__, kind.__doc__ = __name__, f"Be {name}."
    return kind


def _field(described: Field, given: Mapping[str, str]) -> tuple[str, type, Any]:
    """Return a field with its type and default."""
    if described.is_text:
        return described.name, str, field(default="")
    number = float if described.code in "fd" else int
    words = next((text for name, text in given.items() if fnmatchcase(described.name, name)), "") or "0"
    values = tuple(map(number, words.split(",")))
    if described.count:
        return described.name, tuple, field(default=values * (described.count // len(values)))
    return described.name, number, field(default=values[0])


@cache
def message_id(kind: type[Message]) -> int:
    """Return the number of a message's type."""
    return message_ids()[kind.wire_name()]
