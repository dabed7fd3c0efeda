"""Parameters and commands."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message


@dataclass(frozen=True, slots=True)
class ParamRequestRead(Message):
    target_system: int = 0
    target_component: int = 0
    param_id: str = ""
    param_index: int = -1


@dataclass(frozen=True, slots=True)
class ParamRequestList(Message):
    target_system: int = 0
    target_component: int = 0


@dataclass(frozen=True, slots=True)
class ParamSet(Message):
    target_system: int = 0
    target_component: int = 0
    param_id: str = ""
    param_value: float = 0.0
    param_type: int = 9


@dataclass(frozen=True, slots=True)
class ParamValue(Message):
    param_id: str = ""
    param_value: float = 0.0
    param_type: int = 9
    param_count: int = 0
    param_index: int = 65535


@dataclass(frozen=True, slots=True)
class CommandLong(Message):
    target_system: int = 0
    target_component: int = 0
    command: int = 0
    confirmation: int = 0
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    param5: float = 0.0
    param6: float = 0.0
    param7: float = 0.0


@dataclass(frozen=True, slots=True)
class CommandInt(Message):
    target_system: int = 0
    target_component: int = 0
    frame: int = 0
    command: int = 0
    current: int = 0
    autocontinue: int = 0
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class CommandAck(Message):
    command: int = 0
    result: int = 0
    progress: int = 0
    result_param2: int = 0
    target_system: int = 0
    target_component: int = 0


@dataclass(frozen=True, slots=True)
class MessageInterval(Message):
    message_id: int = 0
    interval_us: int = 0


@dataclass(frozen=True, slots=True)
class RequestDataStream(Message):
    target_system: int = 0
    target_component: int = 0
    req_stream_id: int = 0
    req_message_rate: int = 0
    start_stop: int = 0


@dataclass(frozen=True, slots=True)
class SetMode(Message):
    target_system: int = 0
    base_mode: int = 0
    custom_mode: int = 0
