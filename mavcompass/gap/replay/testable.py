"""Which effects a recording cannot tell at all, and why: not testable is not absent."""

from __future__ import annotations

from collections.abc import Iterable

from mavcompass.gap.replay.nominal import Replay
from mavcompass.simulation.effects import Effect, Stage

_NO_SENSOR = (
    "the sensors that would show it were not recorded, or feel motion that the recording does not tell"
)
_NEED_WORDS = {
    "turning": "the vehicle does not turn far enough",
    "tilt": "the vehicle stays level",
    "current": "no varying battery current was recorded",
    "throttle": "no varying throttle was recorded",
    "motors": "no varying motor outputs were recorded",
    "temperature": "no varying temperature was recorded",
    "position": "no precise position was recorded, or the vehicle did not move",
    "height": "no height was recorded, or the vehicle kept it",
    "reference": "the attitude reference was made from the vehicle's own sensors",
    "throttle|current|motors": "neither throttle nor current nor motor outputs were recorded",
}


def half_testable(replayed: Replay, effects: Iterable[Effect]) -> frozenset[str]:
    """List the effects that only lack tilt: level turns show a part of them, never enough to be sure.

    They compete in the search; a winner among them is called ambiguous.
    """
    if "tilt" in replayed.present:
        return frozenset()
    within = replayed.present | {"tilt"}
    return frozenset(
        e.id
        for e in effects
        if "tilt" in e.needs
        and all(any(option in within for option in need.split("|")) for need in e.needs)
        and all(g in replayed.groups for g in e.groups)
    )


def untestable_effects(
    replayed: Replay, effects: Iterable[Effect], age_known: bool = False
) -> dict[str, str]:
    """Say for each effect that this recording cannot test why not.

    `age_known` tells that a baseline has taught how late the autopilot's readings are by nature.
    """
    out: dict[str, str] = {}
    for effect in effects:
        for need in sorted(effect.needs):
            if not any(option in replayed.present for option in need.split("|")):
                out[effect.id] = _NEED_WORDS[need]
        seen = all(g in replayed.groups for g in effect.groups) or any(
            g in replayed.groups for g in effect.enough
        )
        if not seen and effect.id not in out:
            away = "reference" not in replayed.present
            out[effect.id] = _NEED_WORDS["reference"] if away else _NO_SENSOR
        if len(effect.groups) == 1 and effect.groups[0] in replayed.doubtful:
            # What is not known of the motion looks like any fault of the sensor that feels it.
            out[effect.id] = _NO_SENSOR
        # A baseline that was read in the same way teaches how late, and how smooth, readings are by nature.
        repeats, jitter = effect.detector == "repeats", effect.detector == "jitter"
        taught = (age_known and not jitter) or (replayed.trace.froze and repeats)
        if replayed.telemetry and (effect.stage is Stage.TIMING or repeats) and not taught:
            out[effect.id] = "the compass is read more slowly than it is logged, and repeated: late by nature"
        if replayed.averaged > 1 and jitter:
            out[effect.id] = (
                f"{replayed.averaged} neighbours each were averaged, so long is the recording: cut a part out"
            )
        if not replayed.field_known and effect.stage is Stage.WORLD and not effect.needs:
            out[effect.id] = "the recording does not say where it was made"
        if replayed.reference.yaw_unknown and effect.about_vertical:
            out[effect.id] = "the initial yaw is solved with the field: a constant turn is part of it"
        if effect.detector == "drift":
            out[effect.id] = "a wandering offset can imitate any slow cause, so it is reported as unknown"
    return out
