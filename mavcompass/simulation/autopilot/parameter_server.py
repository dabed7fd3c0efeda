"""A flight controller's side of the parameter protocol, with the manners that trip clients up.

Writing the _X element of a vector makes ArduPilot send the whole vector, Y and Z with what they hold at
that moment. PX4 puts the four bytes of an integer into the float's place and wants the right type.
Unknown names and numbers that are none get no answer at all.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass

from mavcompass.enums import MavParamType
from mavcompass.messages import ParamRequestRead, ParamSet, ParamValue
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.parameter_store import ParameterStore

_NO_INDEX = 65535
# What a link of usual speed takes of a parameter list in a tick.
_LISTED_PER_TICK = 4


@dataclass(frozen=True, slots=True)
class Manners:
    """Say how a firmware differs.

    Attributes:
        whole_vectors: the write of an _X element is echoed with Y and Z.
        bytewise: integers travel as their four bytes, and a write of the wrong type is refused.
        echo_index: echoes carry the parameter's index instead of 65535.
    """

    whole_vectors: bool = False
    bytewise: bool = False
    echo_index: bool = False


ARDUPILOT_MANNERS = Manners(whole_vectors=True)
PX4_MANNERS = Manners(bytewise=True, echo_index=True)


class ParameterServer:
    """Answer parameter requests."""

    def __init__(self, board: Board, store: ParameterStore, manners: Manners) -> None:
        self._board = board
        self._manners = manners
        self.store = store
        self._lists: dict[int, deque[str]] = {}

    def reset(self) -> None:
        """Forget lists that are being sent, as a reboot does."""
        self._lists.clear()

    def read(self, request: ParamRequestRead, port: int) -> None:
        """Answer PARAM_REQUEST_READ, by name or by index."""
        index = request.param_index
        if index < 0:
            if request.param_id in self.store:
                self._send(request.param_id, self._index(request.param_id), port)
        elif index < len(self.store):
            self._send(self.store.names[index], index, port)

    def set(self, request: ParamSet) -> bool:
        """Act on PARAM_SET; True where something was stored."""
        name, value = request.param_id, request.param_value
        if self._manners.bytewise and name in self.store:
            if request.param_type != self.store.type(name):
                self._board.say(f"param types mismatch param: {name}")
                return False
            if request.param_type != MavParamType.REAL32:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
        if not self.store.set(name, value):
            return False
        whole = self.store.vector_of(name) if self._manners.whole_vectors else ()
        for element in whole or (name,):
            self.announce(element)
        return True

    def announce(self, name: str) -> None:
        """Send a parameter to every station, as after any change."""
        self._send(name, self._index(name), None)

    def start_list(self, port: int) -> None:
        """Begin to send the whole list to a port."""
        self._lists[port] = deque(self.store.names)

    def attend(self) -> None:
        """Send the next few parameters of the lists asked for."""
        for port in list(self._lists):
            names = self._lists[port]
            for _ in range(min(_LISTED_PER_TICK, len(names))):
                name = names.popleft()
                self._send(name, self.store.index(name), port)
            if not names:
                del self._lists[port]

    def _index(self, name: str) -> int:
        return self.store.index(name) if self._manners.echo_index else _NO_INDEX

    def _send(self, name: str, index: int, port: int | None) -> None:
        store, value = self.store, self.store[name]
        if self._manners.bytewise and store.type(name) != MavParamType.REAL32:
            (value,) = struct.unpack("<f", struct.pack("<i", round(value)))
        self._board.send(ParamValue(name, value, store.type(name), len(store), index), port)
