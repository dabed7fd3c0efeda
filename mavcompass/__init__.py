"""Calibrate a vehicle's compass in four turns, trust its heading, explain the gap to the simulation.

    import mavcompass

    track = mavcompass.read_track("flight.tlog")
    result = mavcompass.calibrate(track, method="four-positions")
    heading = mavcompass.heading(track, result.correction)

Public functions (a path is taken wherever a track is):

    read_track(path) -> Track               .tlog, .bin, .ulg, .csv, .mcap, .db3
    calibrate(track, ...) -> result         one compass of a recording, with its covariance and verdict
    heading(track, correction) -> headings  tilt-compensated, magnetic and true, with sigma
    diagnose_gap(track, baseline) -> why    the gap between the simulator and the recording
    connect(source) -> vehicle              a live vehicle: udpin:0.0.0.0:14550, /dev/ttyACM0, sim:rover
    Track.to_pandas(), Track.from_pandas()  columns as in a Track CSV

The names are looked up when they are first used, so that `import mavcompass` itself costs next to nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavcompass.correction import FieldCorrection as FieldCorrection
    from mavcompass.errors import MavCompassError as MavCompassError
    from mavcompass.track import Track as Track

__version__ = "0.2.0"

_PUBLIC = {  # name: (module, attribute)
    "read_track": ("mavcompass.api", "read_track"),
    "calibrate": ("mavcompass.api", "calibrate"),
    "heading": ("mavcompass.api", "heading"),
    "diagnose_gap": ("mavcompass.api", "diagnose_gap"),
    "connect": ("mavcompass.api", "connect"),
    "Track": ("mavcompass.api", "Track"),
    "FieldCorrection": ("mavcompass.correction", "FieldCorrection"),
    "MavCompassError": ("mavcompass.errors", "MavCompassError"),
    "init": ("mavcompass.service.mavproxy", "init"),  # MAVProxy's `module load mavcompass`
}

__all__ = [name for name in _PUBLIC if name != "init"]

# `mavcompass.heading` is a function of the public interface and also a room, and the import system binds
# the room's module to that name as soon as anything imports it. The room wins, so that every form of import
# works, and is made callable when it is bound: called, it is the function. The room knows nothing of this.
_CALLABLE_ROOMS = frozenset({"heading"})


def _look_up(name: str) -> Any:
    module, attribute = _PUBLIC[name]
    return getattr(import_module(module), attribute)


class _CallableRoom(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return _look_up(self.__name__.rpartition(".")[2])(*args, **kwargs)


class _Package(ModuleType):
    def __setattr__(self, name: str, value: object) -> None:
        if name in _CALLABLE_ROOMS and isinstance(value, ModuleType):
            value.__class__ = _CallableRoom
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name in _CALLABLE_ROOMS:
        return import_module(f"{__name__}.{name}")
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = _look_up(name)
    return value


def __dir__() -> list[str]:
    # Who lists a module looks at all that it lists; MAVProxy asks for its own name, and is seldom there.
    return sorted({"__version__", *__all__})
