"""Wait until a hovering copter holds its place: before that it must not be turned.

A compass that is suddenly far off takes the estimator's heading along, the position controller then pushes
the wrong way, and the copter swings in growing circles until the satellite receiver's velocity has put the
heading right. That takes ten seconds or so, and nobody needs to do anything.
"""

from __future__ import annotations

import math

from mavcompass.errors import Refused
from mavcompass.procedure.positions import Rest
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.vehicle_state import VehicleState

_POLL_S = 0.1
# So long it must have held its place.
_CALM_S = 1.5
_FASTEST_MPS = 0.5
# ArduPilot's own limits of what its estimator makes of its measurements: beyond, it will not stay as it is.
_COMPASS_VARIANCE, _VELOCITY_VARIANCE = 0.8, 0.3
# A copter that swings is given this long; one that hovers well though its estimator doubts the compass, this.
_PATIENCE_S, _DOUBT_PATIENCE_S = 40.0, 10.0


def wait_until_calm(context: Context, state: VehicleState, rest: Rest) -> Script[None]:
    """Wait until the copter hovers at its place. Raises Refused where it does not come to that."""
    began_s = calm_since_s = held_since_s = context.now
    said = False
    while True:
        if _swings(state, rest):
            calm_since_s = held_since_s = context.now
        elif _doubts(state):
            calm_since_s = context.now
        if context.now - calm_since_s >= _CALM_S or context.now - held_since_s >= _DOUBT_PATIENCE_S:
            return
        if context.now - began_s > _PATIENCE_S:
            raise Refused(
                f"The copter does not hold its place within {_PATIENCE_S:.0f} s.",
                "Land it and calibrate it on the ground, turned by hand: --motion hand.",
            )
        if not said and context.now - began_s > _CALM_S + 1.0:
            context.show("ready", "Waiting until the copter holds its place.")
            said = True
        yield from pause(context, _POLL_S)


def _swings(state: VehicleState, rest: Rest) -> bool:
    place = state.place
    if place is not None and math.hypot(place.vx, place.vy) * 0.01 > _FASTEST_MPS:
        return True
    return rest.why_not == "tilting"


def _doubts(state: VehicleState) -> bool:
    ekf = state.ekf
    return ekf is not None and (
        ekf.compass_variance >= _COMPASS_VARIANCE or ekf.velocity_variance >= _VELOCITY_VARIANCE
    )
