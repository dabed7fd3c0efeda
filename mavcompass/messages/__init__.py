"""The MAVLink messages that mavcompass speaks and understands, as plain values.

Names and units are the wire's (`vehicle.wire.codec` holds them to the dialect, field by field); the
meaning of the numbers as quantities is in `telemetry`. Class names are the message's name in camel
case: RawImu is RAW_IMU. Every field has a default, so a test names only what it is about.
"""

from __future__ import annotations

from mavcompass.messages.commands import (
    CommandAck,
    CommandInt,
    CommandLong,
    MessageInterval,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    RequestDataStream,
    SetMode,
)
from mavcompass.messages.component import MagCalProgress, MagCalReport, NamedValueFloat
from mavcompass.messages.message import Incoming, Message
from mavcompass.messages.motion import (
    ManualControl,
    Quaternion,
    RcChannelsOverride,
    SetAttitudeTarget,
    SetPositionTargetLocalNed,
)
from mavcompass.messages.position import (
    Attitude,
    EkfStatusReport,
    EstimatorStatus,
    FenceStatus,
    GlobalPositionInt,
    GpsRawInt,
    LocalPositionNed,
    RcChannels,
    ServoOutputRaw,
    Simstate,
    VfrHud,
)
from mavcompass.messages.sensors import HighresImu, RawImu, ScaledImu, ScaledImu2, ScaledImu3, ScaledPressure
from mavcompass.messages.vehicle import (
    AutopilotVersion,
    ExtendedSysState,
    Heartbeat,
    Statustext,
    SysStatus,
    SystemTime,
)

__all__ = [
    "Attitude",
    "AutopilotVersion",
    "CommandAck",
    "CommandInt",
    "CommandLong",
    "EkfStatusReport",
    "EstimatorStatus",
    "ExtendedSysState",
    "FenceStatus",
    "GlobalPositionInt",
    "GpsRawInt",
    "Heartbeat",
    "HighresImu",
    "Incoming",
    "LocalPositionNed",
    "MagCalProgress",
    "MagCalReport",
    "ManualControl",
    "Message",
    "MessageInterval",
    "NamedValueFloat",
    "ParamRequestList",
    "ParamRequestRead",
    "ParamSet",
    "ParamValue",
    "Quaternion",
    "RawImu",
    "RcChannels",
    "RcChannelsOverride",
    "RequestDataStream",
    "ScaledImu",
    "ScaledImu2",
    "ScaledImu3",
    "ScaledPressure",
    "ServoOutputRaw",
    "SetAttitudeTarget",
    "SetMode",
    "SetPositionTargetLocalNed",
    "Simstate",
    "Statustext",
    "SysStatus",
    "SystemTime",
    "VfrHud",
]
