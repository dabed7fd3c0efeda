"""What every simulated flight controller has, whatever firmware runs on it."""

from mavcompass.simulation.autopilot.attitude_filter import wrap_angle
from mavcompass.simulation.autopilot.board import Board, Outgoing
from mavcompass.simulation.autopilot.commands import FORCE, whole
from mavcompass.simulation.autopilot.compasses import Compasses
from mavcompass.simulation.autopilot.firmware import Firmware, Sender
from mavcompass.simulation.autopilot.guidance import GroundGuidance, HoverGuidance, Ignore, Target, stick
from mavcompass.simulation.autopilot.parameters import (
    ARDUPILOT_MANNERS,
    PX4_MANNERS,
    ParameterServer,
    ParameterStore,
    parameter_table,
)
from mavcompass.simulation.autopilot.radio import Radio
from mavcompass.simulation.autopilot.reports import Battery, Reports, between, int16
from mavcompass.simulation.autopilot.status import Status
from mavcompass.simulation.autopilot.streams import MESSAGE_IDS, MESSAGES
from mavcompass.simulation.autopilot.telemetry import Telemetry

__all__ = [
    "ARDUPILOT_MANNERS",
    "FORCE",
    "MESSAGES",
    "MESSAGE_IDS",
    "PX4_MANNERS",
    "Battery",
    "Board",
    "Compasses",
    "Firmware",
    "GroundGuidance",
    "HoverGuidance",
    "Ignore",
    "Outgoing",
    "ParameterServer",
    "ParameterStore",
    "Radio",
    "Reports",
    "Sender",
    "Status",
    "Target",
    "Telemetry",
    "between",
    "int16",
    "parameter_table",
    "stick",
    "whole",
    "wrap_angle",
]
