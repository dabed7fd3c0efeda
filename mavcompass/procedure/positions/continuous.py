"""Pass through the positions in one turn instead of standing still at each.

The field's mean over any arc is exact once the gyro tells how far it turned inside (S1), so no stop is needed
for the iron. How late the compass is read is only a constant heading while the rate stays; what shows as
the rate changes is part of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from mavcompass.errors import LinkLost
from mavcompass.procedure.positions.visiting import DwellSettings, Mover, Rest, Sureness, Window, dwell
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.turning.steered import SLOW_RADPS

# After a turn a compass still averages it for a quarter second; then five readings of 10 Hz tell the heading.
_AVERAGES_S, _STANDS_S, _POLL_S, _PATIENCE_S = 0.25, 0.5, 0.05, 5.0


def turn_through(
    context: Context,
    rest: Rest,
    gyro: GyroAngle,
    mover: Mover,
    count: int,
    step_rad: float,
    settings: DwellSettings,
    seen: Sequence[Window] = (),
    at_first: Callable[[], Script[None]] | None = None,
    sureness: Sureness | None = None,
) -> Script[list[Window]]:
    """Stand at the first position, then turn through all of them without a stop, back to the first.

    With positions `seen` already it only turns on by one step. `at_first` is done while it stands;
    `sureness` ends its dwell, see `dwell`.
    """
    windows, angle_rad = list(seen), step_rad * (1 if seen else count)
    if not windows:
        context.show("dwell", "Measuring where it stands.", 0.0)
        windows.append((yield from dwell(context, rest, gyro, mover, settings, sureness, at_first)))
    text = f"Turning by {abs(math.degrees(angle_rad)):.0f} deg without a stop."
    context.show("turn", text, 1.0 / (count + 1.0), turned_deg=math.degrees(gyro.angle_rad))
    began_s = rest.time_s
    yield from mover.next(context, angle_rad, 1)
    return [*windows, Window(began_s, rest.time_s, gyro.angle_rad, rested=False)]


def stood_since(
    context: Context, rest: Rest, gyro: GyroAngle, turn: Window, settings: DwellSettings
) -> Script[Window]:
    """Return the stand after a turn, as soon as it shows the heading: most of it has passed in solving.

    What swings on is taken as it is after a while, its turning explained by the gyro. Raises LinkLost where
    no IMU messages come.
    """
    since_s, began_s = turn.end_s, math.inf
    while rest.time_s - since_s < _AVERAGES_S + _STANDS_S:
        yield from pause(context, _POLL_S)
        began_s = min(began_s, context.now)  # what came while all was solved is heard only now
        if context.now > began_s + settings.patience_s + _PATIENCE_S:
            raise LinkLost("The IMU messages stopped coming.", "Bring the link back and run again.")
        if abs(gyro.rate_radps) > SLOW_RADPS and context.now < began_s + settings.patience_s:
            since_s = rest.time_s
    return Window(since_s + _AVERAGES_S, rest.time_s, gyro.angle_rad)
