"""A flight controller's parameters: values that survive a reboot, and the manners that trip clients up.

Writing the _X element of a vector makes ArduPilot send the whole vector, Y and Z with what they hold at
that moment. PX4 puts the four bytes of an integer into the float's place and wants the right type.
Unknown names and numbers that are none get no answer at all.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from functools import cache

from mavcompass.enums import MavParamType
from mavcompass.installation.parts import params_path
from mavcompass.messages import ParamRequestRead, ParamSet, ParamValue
from mavcompass.simulation.autopilot.board import Board

_INTEGER_RANGES = {
    MavParamType.INT8: (-128, 127),
    MavParamType.INT16: (-32768, 32767),
    MavParamType.INT32: (-(2**31), 2**31 - 1),
}
_NO_INDEX = 65535
# What a link of usual speed takes of a parameter list in a tick.
_LISTED_PER_TICK = 4


@dataclass(frozen=True, slots=True)
class Parameter:
    """Hold a parameter's default and type."""

    default: float
    type: MavParamType


@cache
def parameter_table(*files: str) -> Mapping[str, Parameter]:
    """Read files of `params/simulated`; later files override and add. Sorted by name."""
    table: dict[str, Parameter] = {}
    for file in files:
        for line in params_path(f"simulated/{file}").read_text(encoding="ascii").splitlines():
            if line.strip() and not line.startswith("#"):
                name, value, kind = line.split()
                table[name] = Parameter(float(value), MavParamType(int(kind)))
    return dict(sorted(table.items()))


def as_float32(value: float) -> float:
    """Round to what a 32 bit float holds; infinite where it is too large for one."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


class ParameterStore:
    """Hold the values; what is written goes into `storage`, which outlives a reboot or the object.

    `delivered` are those that the vehicle was made with: its compasses are mounted as they say.
    """

    def __init__(
        self,
        table: Mapping[str, Parameter],
        defaults: Mapping[str, float],
        storage: MutableMapping[str, float] | None = None,
    ) -> None:
        self._table = dict(table)
        self.storage: MutableMapping[str, float] = {} if storage is None else storage
        self._values = {n: as_float32(defaults.get(n, p.default)) for n, p in self._table.items()}
        self.delivered: Mapping[str, float] = dict(self._values)
        for name, value in self.storage.items():
            if name in self._values:
                self._values[name] = as_float32(value)
        self.names = tuple(self._table)
        self._index = {name: i for i, name in enumerate(self.names)}

    def __contains__(self, name: str) -> bool:
        """Tell whether there is such a parameter."""
        return name in self._values

    def __getitem__(self, name: str) -> float:
        """Return a value; KeyError for an unknown name."""
        return self._values[name]

    def __len__(self) -> int:
        """Count the parameters."""
        return len(self.names)

    @property
    def values(self) -> Mapping[str, float]:
        """Return all values by name (a live view: do not change it)."""
        return self._values

    def get(self, name: str, default: float = 0.0) -> float:
        """Return a value, or the default where this vehicle lacks the parameter."""
        return self._values.get(name, default)

    def factory_value(self, name: str) -> float:
        """Return what a parameter holds on a new vehicle of this kind."""
        return self._table[name].default

    def index(self, name: str) -> int:
        """Return the parameter's place in the list."""
        return self._index[name]

    def type(self, name: str) -> MavParamType:
        """Return the parameter's type."""
        return self._table[name].type

    def set(self, name: str, value: float, keep: bool = True) -> bool:
        """Set a value; False (and nothing set) for an unknown name or a number that is none.

        Without `keep` it holds until the next power-up only.
        """
        if name not in self._values or not math.isfinite(value):
            return False
        limits = _INTEGER_RANGES.get(self.type(name))
        if limits:
            value = float(max(limits[0], min(limits[1], math.floor(value + 0.5))))
        value = as_float32(value)
        if not math.isfinite(value):
            return False
        self._values[name] = value
        if keep:
            self.storage[name] = value
        return True

    def vector_of(self, name: str) -> tuple[str, ...]:
        """List the three names of the vector that an _X element opens; nothing for any other name."""
        stem = name.removesuffix("_X")
        axes = (name, f"{stem}_Y", f"{stem}_Z")
        if stem == name or any(a not in self._table for a in axes):
            return ()
        return axes if all(self.type(a) == MavParamType.REAL32 for a in axes) else ()


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
