"""ArduPilot's side of the parameter protocol, with the echo that trips clients up.

Writing the _X element of a vector makes the firmware send the whole vector, Y and Z with what they hold
at that moment. Unknown names and numbers that are none get no answer at all.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mavcompass.messages import ParamRequestList, ParamRequestRead, ParamSet, ParamValue
from mavcompass.simulation.firmware import Sender
from mavcompass.simulation.parameter_store import ParameterStore

if TYPE_CHECKING:
    from mavcompass.simulation.autopilot import SimulatedAutopilot

_NO_INDEX = 65535
# What a link of usual speed takes of a parameter list in a tick.
_LISTED_PER_TICK = 4


class ParameterServer:
    """Answer parameter requests."""

    def __init__(self, vehicle: SimulatedAutopilot, store: ParameterStore) -> None:
        self._vehicle = vehicle
        self.store = store
        self._lists: dict[int, deque[str]] = {}

    def reset(self) -> None:
        """Forget lists that are being sent, as a reboot does."""
        self._lists.clear()

    def read(self, request: ParamRequestRead, sender: Sender) -> None:
        """Answer PARAM_REQUEST_READ, by name or by index."""
        index = request.param_index
        if index < 0:
            if request.param_id in self.store:
                self._send(request.param_id, _NO_INDEX, sender.port)
        elif index < len(self.store):
            self._send(self.store.names[index], index, sender.port)

    def set(self, request: ParamSet) -> bool:
        """Act on PARAM_SET; True where something was stored."""
        name = request.param_id
        if not self.store.set(name, request.param_value):
            return False
        for element in self.store.vector_of(name) or (name,):
            self.announce(element)
        return True

    def announce(self, name: str) -> None:
        """Send a parameter to every station, as after any change."""
        self._send(name, _NO_INDEX, None)

    def start_list(self, request: ParamRequestList, sender: Sender) -> None:
        """Begin to send the whole list to a port."""
        self._lists[sender.port] = deque(self.store.names)

    def attend(self) -> None:
        """Send the next few parameters of the lists asked for."""
        for port in list(self._lists):
            names = self._lists[port]
            for _ in range(min(_LISTED_PER_TICK, len(names))):
                name = names.popleft()
                self._send(name, self.store.index(name), port)
            if not names:
                del self._lists[port]

    def _send(self, name: str, index: int, port: int | None) -> None:
        store = self.store
        value = ParamValue(name, store[name], store.type(name), len(store), index)
        self._vehicle.send(value, port)
