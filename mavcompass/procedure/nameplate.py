"""What tells one vehicle from another, at whatever address and whatever time it is met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import Refused
from mavcompass.procedure.script import Context, Script
from mavcompass.two_clocks import shared_id

# AUTOPILOT_VERSION is asked for by its number, and of older firmware by a command of its own.
_QUESTIONS = (
    (MavCmd.REQUEST_MESSAGE, float(mav.message_id(mav.AutopilotVersion))),
    (MavCmd.REQUEST_AUTOPILOT_CAPABILITIES, 1.0),
)
# Where a third is lost each way half of the tries fail; eight in a row are one case in 250.
_TRIES, _PATIENCE_S = 8, 0.5
# Two autopilots answer one question at the same time, but for what a link delays.
_TOGETHER_S = 0.2
_LATER = (MavResult.ACCEPTED, MavResult.IN_PROGRESS, MavResult.TEMPORARILY_REJECTED)


@dataclass(frozen=True, slots=True)
class Nameplate:
    """Tell which vehicle this is.

    Attributes:
        autopilot: "ardupilot" or "px4". system: its MAVLink system id.
        uid: the board's unique id, hexadecimal; "" where it tells none. board, firmware: as
            AUTOPILOT_VERSION has them, "" likewise. compasses: their device ids, 0 where there is none.
    """

    autopilot: str
    system: int
    uid: str = ""
    board: str = ""
    firmware: str = ""
    compasses: tuple[int, ...] = ()

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Nameplate:
        """Read what `document` made. Raises KeyError, TypeError or ValueError where it is not one."""
        uid, board, firmware = (str(document[key]) for key in ("uid", "board", "firmware"))
        compasses = tuple(int(device) for device in document["compasses"])
        return cls(str(document["autopilot"]), int(document["system"]), uid, board, firmware, compasses)

    def document(self) -> dict[str, Any]:
        """Return the JSON form."""
        return asdict(self)

    @property
    def key(self) -> str:
        """Return a short name that stays, for histories and locks."""
        return f"{self.autopilot}-{self.uid or f'system-{self.system}'}"

    def is_same(self, other: Nameplate) -> bool:
        """Tell whether both are of one vehicle, by everything that both could tell.

        Its firmware may be another one since, where a unique id vouches for the board.
        """
        mine, yours = (asdict(plate) | ({"firmware": ""} if plate.uid else {}) for plate in (self, other))
        return mine == yours

    def __str__(self) -> str:
        """Return it in words."""
        devices = ", ".join(str(device) for device in self.compasses if device) or "none"
        uid = f"unique id {self.uid}" if self.uid else "no unique id"
        version = f"{self.autopilot} {self.firmware or 'of unknown version'}"
        return f"system {self.system}, {version}, board {self.board or 'unknown'}, {uid}, compasses {devices}"


def read_nameplate(context: Context, autopilot: str, compasses: tuple[int, ...]) -> Script[Nameplate]:
    """Ask the vehicle who it is. Raises Refused where two answer."""
    told = yield from _version(context)
    if told is None:
        return Nameplate(autopilot, context.system, compasses=compasses)
    numbers = (told.board_version, told.vendor_id, told.product_id)
    board = "-".join(f"{number:x}" for number in numbers) if any(numbers) else ""
    version = ".".join(str(told.flight_sw_version >> shift & 0xFF) for shift in (24, 16, 8))
    return Nameplate(autopilot, context.system, unique_id(told), board, version, compasses)


def unique_id(told: mav.AutopilotVersion) -> str:
    """Return the board's unique id, hexadecimal; "" where it has none. ArduPilot tells the long one only."""
    long = bytes(told.uid2).rstrip(b"\0").hex()
    return f"{told.uid:016x}" if told.uid else long


def _version(context: Context) -> Script[mav.AutopilotVersion | None]:
    """Ask for AUTOPILOT_VERSION; None where it is not known, or stays silent."""
    refused: set[int] = set()
    for attempt in range(_TRIES):
        number, parameter = _QUESTIONS[attempt % len(_QUESTIONS)]
        if number in refused:
            continue
        context.command(number, parameter)
        end_s, told = context.now + _PATIENCE_S, None
        while context.now < end_s and number not in refused:
            heard = context.heard_from_vehicle((yield end_s))
            match heard and heard.message:
                case mav.AutopilotVersion() as version:
                    if told is not None and unique_id(told) != unique_id(version):
                        raise Refused(*shared_id(context.system))
                    end_s, told = min(end_s, context.now + _TOGETHER_S) if told is None else end_s, version
                case mav.CommandAck(command=command, result=result):
                    if command == number and result not in _LATER:
                        refused.add(command)
        if told is not None:
            return told
    return None
