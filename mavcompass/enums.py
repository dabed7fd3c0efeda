"""The numbers of the MAVLink enumerations that this program uses, under their standard names."""

from __future__ import annotations

from enum import IntEnum, IntFlag


class MavType(IntEnum):
    """Name a vehicle's or component's type (HEARTBEAT.type)."""

    GENERIC = 0
    FIXED_WING = 1
    QUADROTOR = 2
    COAXIAL = 3
    HELICOPTER = 4
    ANTENNA_TRACKER = 5
    GCS = 6
    GROUND_ROVER = 10
    SURFACE_BOAT = 11
    SUBMARINE = 12
    HEXAROTOR = 13
    OCTOROTOR = 14
    TRICOPTER = 15
    ONBOARD_CONTROLLER = 18
    VTOL_TAILSITTER_DUOROTOR = 19
    VTOL_TAILSITTER_QUADROTOR = 20
    VTOL_TILTROTOR = 21
    VTOL_FIXEDROTOR = 22
    VTOL_TAILSITTER = 23
    VTOL_TILTWING = 24
    GIMBAL = 26
    ADSB = 27
    DODECAROTOR = 29
    CAMERA = 30
    DECAROTOR = 35


class MavAutopilot(IntEnum):
    """Name the autopilot's make (HEARTBEAT.autopilot)."""

    GENERIC = 0
    ARDUPILOTMEGA = 3
    INVALID = 8
    PX4 = 12


class MavModeFlag(IntFlag):
    """Name the bits of HEARTBEAT.base_mode."""

    CUSTOM_MODE_ENABLED = 1
    AUTO_ENABLED = 4
    GUIDED_ENABLED = 8
    STABILIZE_ENABLED = 16
    MANUAL_INPUT_ENABLED = 64
    SAFETY_ARMED = 128


class MavState(IntEnum):
    """Name the system's state (HEARTBEAT.system_status)."""

    UNINIT = 0
    BOOT = 1
    CALIBRATING = 2
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    EMERGENCY = 6
    POWEROFF = 7


class MavCmd(IntEnum):
    """Name the commands of COMMAND_LONG."""

    NAV_LAND = 21
    NAV_TAKEOFF = 22
    CONDITION_YAW = 115
    DO_SET_MODE = 176
    PREFLIGHT_CALIBRATION = 241
    PREFLIGHT_SET_SENSOR_OFFSETS = 242
    PREFLIGHT_REBOOT_SHUTDOWN = 246
    COMPONENT_ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_AUTOPILOT_CAPABILITIES = 520
    FIXED_MAG_CAL_YAW = 42006
    SET_EKF_SOURCE_SET = 42007
    DO_START_MAG_CAL = 42424
    DO_ACCEPT_MAG_CAL = 42425
    DO_CANCEL_MAG_CAL = 42426


class MavResult(IntEnum):
    """Name the answers of COMMAND_ACK."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6


class MavFrame(IntEnum):
    """Name the frames of SET_POSITION_TARGET_LOCAL_NED."""

    LOCAL_NED = 1
    LOCAL_OFFSET_NED = 7
    BODY_NED = 8
    BODY_OFFSET_NED = 9


class MavParamType(IntEnum):
    """Name the types of PARAM_VALUE and PARAM_SET."""

    UINT8 = 1
    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    REAL32 = 9


class MavSeverity(IntEnum):
    """Name the severities of STATUSTEXT."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


class EkfFlag(IntFlag):
    """Name the bits of EKF_STATUS_REPORT.flags; those below the last are ESTIMATOR_STATUS's, too."""

    ATTITUDE = 1
    VELOCITY_HORIZ = 2
    VELOCITY_VERT = 4
    POS_HORIZ_REL = 8
    POS_HORIZ_ABS = 16
    POS_VERT_ABS = 32
    POS_VERT_AGL = 64
    CONST_POS_MODE = 128
    UNINITIALIZED = 1024


class MagCalStatus(IntEnum):
    """Name the states of MAG_CAL_PROGRESS and MAG_CAL_REPORT."""

    NOT_STARTED = 0
    WAITING_TO_START = 1
    RUNNING_STEP_ONE = 2
    RUNNING_STEP_TWO = 3
    SUCCESS = 4
    FAILED = 5
    BAD_ORIENTATION = 6
    BAD_RADIUS = 7


class MavVtolState(IntEnum):
    """Name how a VTOL flies (EXTENDED_SYS_STATE.vtol_state)."""

    UNDEFINED = 0
    TRANSITION_TO_FW = 1
    TRANSITION_TO_MC = 2
    MC = 3
    FW = 4


class RoverMode(IntEnum):
    """Name ArduPilot Rover's modes (HEARTBEAT.custom_mode)."""

    MANUAL = 0
    ACRO = 1
    STEERING = 3
    HOLD = 4
    LOITER = 5
    AUTO = 10
    RTL = 11
    GUIDED = 15


class CopterMode(IntEnum):
    """Name ArduPilot Copter's modes."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


class SubMode(IntEnum):
    """Name ArduPilot Sub's modes."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    SURFACE = 9
    POSHOLD = 16
    MANUAL = 19


class PlaneMode(IntEnum):
    """Name ArduPilot Plane's modes, those of a quadplane included."""

    MANUAL = 0
    FBWA = 5
    AUTO = 10
    RTL = 11
    LOITER = 12
    GUIDED = 15
    QSTABILIZE = 17
    QHOVER = 18
    QLOITER = 19
    QLAND = 20
    QRTL = 21


# Component ids of MAVLink.
COMPONENT_AUTOPILOT = 1
COMPONENT_GROUND_STATION = 190
COMPONENT_ONBOARD_COMPUTER = 191
