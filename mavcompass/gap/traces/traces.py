"""All that single readings tell, together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from mavcompass.gap.replay import Replay
from mavcompass.gap.traces.rapid import Rapid, find_rapid
from mavcompass.gap.traces.scattered import burst_mgauss, excess_variance
from mavcompass.gap.traces.steps_and_repeats import (
    names_stale,
    names_step,
    stale_doubt,
    stale_share,
    told_step,
)
from mavcompass.simulation.effects import Effect, detected_by

# An effect of less than this share of the floor lifts nothing above it.
_MATERIAL = 0.75
# Less than this share of what was taken out may be what the times of its readings make of it.
_OF_RAPID = 0.5
_MOST_RAPID = 2


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """Hold what single readings tell.

    Attributes:
        stale_share: the share of repeats; step_mgauss: the step of the numbers; zero where not to be named.
        stale_doubt, step_doubt_mgauss: their standard deviations.
        rapid: effects that change with every reading, and were taken out.
        excess_mgauss2: the variance of white scatter beyond the baseline's, of single readings.
        unexplained: the coordinate of what single readings show beyond the baseline's and the floor, and what
            no name is for: "time" of bursts, "frequency" of a line that may not be named, or none.
    """

    stale_share: float = 0.0
    step_mgauss: float = 0.0
    rapid: tuple[Rapid, ...] = ()
    excess_mgauss2: float = 0.0
    stale_doubt: float = 0.0
    step_doubt_mgauss: float = 0.0
    unexplained: str = ""

    @property
    def named(self) -> bool:
        """Tell whether something is to be named."""
        return self.stale_share > 0.0 or self.step_mgauss > 0.0 or bool(self.rapid)


def find_traces(
    replay: Replay,
    baseline: Replay | None,
    noise_mgauss: float,
    floor_mgauss: float,
    names: frozenset[str],
    exact: bool,
) -> tuple[Traces, Replay]:
    """Read the traces off every reading; return the replay without what changes with each of them.

    `names` are the effects that may be named. Where the floor is `exact` and no readings are averaged, the
    search finds by itself what changes from reading to reading.
    """
    stale = stale_share(replay, baseline) if names_stale(replay, baseline) else 0.0
    step, step_doubt = told_step(replay) if names_step(replay, baseline, noise_mgauss) else (0.0, 0.0)
    readings, before = replay.readings, None if baseline is None else baseline.readings
    rapid: tuple[Rapid, ...] = ()
    if step == 0.0 and not (exact and replay.averaged == 1):
        for _ in range(_MOST_RAPID):
            found = find_rapid(readings, before, _MATERIAL * floor_mgauss)
            if found is None:
                break
            rapid, readings = (*rapid, found), readings.without(found.change_mgauss)
    # What may not be named stays in the readings, but it is no noise either.
    excess = 0.0 if before is None else excess_variance(readings, before, stale > 0.0)
    # Where nobody says when a reading was taken, what a line leaves may be the times.
    if replay.telemetry and excess < _OF_RAPID * sum(one.variance_mgauss2 for one in rapid):
        excess = 0.0
    named = tuple(one for one in rapid if one.effect in names)
    unexplained = "frequency" if len(named) < len(rapid) else ""
    rapid = named
    for one in rapid:
        replay = replay.without(one.change_mgauss)
    stale = stale if detected_by("repeats").id in names else 0.0
    step = step if detected_by("steps").id in names else 0.0
    if before is not None and burst_mgauss(readings, before) > _MATERIAL * floor_mgauss:
        unexplained = "time"
    return Traces(stale, step, rapid, excess, stale_doubt(replay, stale), step_doubt, unexplained), replay


def searched(replay: Replay, effects: Iterable[Effect]) -> list[Effect]:
    """Leave out of a search what averaged rows cannot show, and single readings have told."""
    return [e for e in effects if replay.averaged == 1 or e.detector not in ("alternation", "line")]
