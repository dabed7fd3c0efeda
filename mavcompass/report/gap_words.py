"""A diagnosis in words for a person: first what to do, then why."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from mavcompass.gap.result import Cause, Closing, Diagnosis, Place
from mavcompass.printable import counted
from mavcompass.simulation.effects import get
from mavcompass.simulation.effects.effect import NEVER_S, ON_IRON

VERDICTS = {
    "no_gap": "no gap",
    "named": "explained",
    "ambiguous": "explained, but not by one cause alone",
    "named_with_remainder": "explained in part; something else is left",
    "unknown": "unknown: none of the effects in the catalogue explains it",
    "not_testable": "not testable",
}
SHADES = {"no_gap": "good", "named": "good", "unknown": "bad"}  # of a verdict on a page; else "warn"
_CALIBRATE = "Calibrate: the vehicle's iron is not what its parameters say"
_MOVE_AWAY = "Move the compass away from the power leads, or set the motor compensation (COMPASS_MOT)"
_OF_THE_PLACE = "Record elsewhere: it is of the place, not of the vehicle"
_IMU = "Calibrate accelerometer and gyro in the ground station: it is not the compass"
_BUS = "Look at the compass's driver and the logging rate: readings come late or twice"
_SOURCE = "Find what switches or hums near the compass, and move one of the two"
_MOUNTING = "Put the mounting right: turn the compass back, or set its orientation parameter"
_REMEDIES = {
    "hard_iron": _CALIBRATE,
    "soft_iron": _CALIBRATE,
    "axis_scale": _CALIBRATE,
    "non_orthogonality": _CALIBRATE,
    "hard_iron_step": "Find what came loose or was put on during the recording, then calibrate",
    "motor_current": _MOVE_AWAY,
    "per_motor": _MOVE_AWAY,
    "relay_field": _SOURCE,
    "ac_interference": _SOURCE,
    "noise_excess": _SOURCE,
    "misalignment": _MOUNTING,
    "orientation": _MOUNTING,
    "spatial_dipole": _OF_THE_PLACE,
    "field_gradient": _OF_THE_PLACE,
    "height_anomaly": _OF_THE_PLACE,
    "field_intensity": _OF_THE_PLACE,
    "inclination": _OF_THE_PLACE,
    "declination": "Let the autopilot take the declination from its model (COMPASS_AUTODEC 1)",
    "temperature_bias": "Let the vehicle reach its temperature before it is calibrated and flown",
    "temperature_sensitivity": "Let the vehicle reach its temperature before it is calibrated and flown",
    "clipping": "Take the magnet away: the sensor is at its limit",
    "hysteresis": "Move the compass away from the iron that remembers",
    "eddy_current": "Move the compass away from the metal around it",
    "transport_lag": _BUS,
    "low_pass": _BUS,
    "timestamp_jitter": _BUS,
    "stale_samples": _BUS,
    "gyro_bias": _IMU,
    "gyro_scale": _IMU,
    "accel_bias": _IMU,
    "accel_scale": _IMU,
    "vibration_rectification": "Damp the autopilot's vibrations: it is not the compass",
}
_SENSORS = {"mag": "compass", "acc": "accelerometer", "gyro": "gyro"}
REFERENCES = {
    "columns": "the recording's own reference",
    "fused": "gyro, accelerometer, receiver and autopilot, smoothed together",
    "gps-yaw": "the second antenna's yaw, with the gyro",
    "gyro": "the gyro and the accelerometer",
    "attitude": "the autopilot's own attitude",
}
# What the figures of field and heading are; those of a rehearsal are over the circle instead.
RMS_OF = "figures are rms over the samples of the parts held out, not over the circle of headings"
_COARSE_DEG = 3.0
_ALIKE = 0.05  # shares of the gap that are no more apart are not told apart
_UNITS = {"1": (1.0, ""), "rad": (math.degrees(1.0), "deg"), "degC": (1.0, "°C")}
_NAMES = {"on_s": "from", "off_s": "until", "lag_s": "late by"}
_SHARP_PERCENT = 1.0
_SHOWN_VALUES = 9
_SHOWN_SETS = 4


def advice(diagnosis: Diagnosis) -> str:
    """Say in one sentence what to do."""
    match diagnosis.verdict:
        case "no_gap" if diagnosis.late_s is not None:
            return (
                f"Look at the compass's driver and the logging rate: readings are {diagnosis.late_s:.2f} s"
                f" old. Beside that the heading is right to {max(diagnosis.heading.nominal, 0.1):.1f} deg"
                " rms. A recording of the vehicle in a good state (--baseline) tells if it was so before."
            )
        case "no_gap" if diagnosis.heading.floor > _COARSE_DEG:
            return f"No problem found; errors under {diagnosis.heading.floor:.0f} deg would be invisible."
        case "no_gap":
            right_deg = max(diagnosis.heading.nominal, 0.1)
            return (
                f"No problem found: the heading is right to {right_deg:.1f} deg, the noise of this recording."
            )
        case "named":
            return f"{_remedy(diagnosis)}."
        case "named_with_remainder":
            return f"{_remedy(diagnosis)}. Then record and diagnose again: something else is left."
        case "ambiguous" if (remedy := _one_remedy(diagnosis)) is not None:
            return f"{remedy}; which of these causes it is does not matter for that."
        case "ambiguous" if diagnosis.next_flight:
            return f"Change nothing yet; record this to decide: {diagnosis.next_flight[0].protocol}."
        case "ambiguous":
            return (
                "Change nothing yet: other causes would do the same here. A recording with other turns, tilts"
                " and loads would decide, beside one of the vehicle in a good state (--baseline)."
            )
        case "unknown":
            return (
                "Look at what goes with it (below); a recording of the vehicle in a good state"
                " (--baseline) tells more."
            )
    return "Record again, with turns through all headings, and with tilt if the vehicle can."


def _remedy(diagnosis: Diagnosis) -> str:
    return _remedy_of(max(diagnosis.causes, key=lambda cause: cause.removes_mgauss).effect)


def _remedy_of(effect: str) -> str:
    return _REMEDIES.get(effect, f"Put this right, or simulate it: {get(effect).title}")


def _one_remedy(diagnosis: Diagnosis) -> str | None:
    """Return the remedy of all causes that could be meant, where it is the same."""
    sets = _sets(diagnosis)
    remedies = {_remedy_of(effect) for ids in sets for effect in ids}
    return remedies.pop() if len(sets) > 1 and len(remedies) == 1 else None


def _sets(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """List the sets of effects that could be meant, the named one first."""
    named = tuple(sorted(cause.effect for cause in diagnosis.causes))
    return [named, *(ids for ids, _ in diagnosis.ambiguity_set if ids != named)]


def summary(diagnosis: Diagnosis, everything: bool = False) -> list[str]:
    """Put a diagnosis in a few lines for a terminal: what to do, then why.

    Args:
        everything: also what is only for those who want to know how it came about.
    """
    lines = [advice(diagnosis)]
    lines.append(f"  verdict: {VERDICTS[diagnosis.verdict]} (compass {diagnosis.compass})")
    for cause in diagnosis.causes:
        lines += _cause(cause, rivals=diagnosis.verdict != "ambiguous")
    if diagnosis.verdict == "ambiguous" and (others := _sets(diagnosis)[1:]):
        lines.append(
            f"  instead it may be: {', or '.join(' with '.join(ids) for ids in others[:_SHOWN_SETS])}"
        )
    for cause in diagnosis.look_alikes:
        lines.append(f"  looks most like {cause.effect}, which does not explain it")
    lines.append(_closing("heading", diagnosis.heading, "deg"))
    lines.append(_closing("field", diagnosis.field, "mG"))
    if diagnosis.verdict not in ("no_gap", "not_testable") and diagnosis.where:
        lines.append(f"  {_places(diagnosis.where)}")
    if diagnosis.unknown and diagnosis.unknown_coordinate:
        lines.append(f"  what is left depends on: {diagnosis.unknown_coordinate}")
    if diagnosis.verdict != "no_gap":
        for flight in diagnosis.next_flight[:2]:
            lines.append(
                f"  to tell more, record: {flight.protocol} ({flight.predicted_separation:.0f} sigma)"
            )
    if everything:
        lines += _background(diagnosis)
    elif diagnosis.not_testable:
        lines += unseen_iron(diagnosis)
        count = counted(len(diagnosis.not_testable), "possible cause")
        lines.append(f"  {count} cannot be tested with this recording (-v: which)")
    return lines


def unseen_iron(diagnosis: Diagnosis) -> list[str]:
    """Say why the commonest of all faults could not show, where it could not."""
    why = dict(diagnosis.not_testable).get("hard_iron")
    if why is None or "hard_iron" in diagnosis.effects:
        return []
    return [f"  iron on the vehicle (hard_iron) cannot be tested: {why}"]


def cause_values(cause: Cause) -> str:
    """Spell a cause's parameters with their units; of many the first ones."""
    rows = figures_of(cause)
    values = ", ".join(
        f"{name} {value}{f' {unit}' if unit else ''}" for name, value, _, unit in rows[:_SHOWN_VALUES]
    )
    return values + ", ..." if len(rows) > _SHOWN_VALUES else values


def figures_of(cause: Cause) -> list[tuple[str, str, str, str]]:
    """List a cause's parameters as people read them: name, value, 95 % interval, unit.

    What belongs to the model alone is left out: a time that stands for never, and whether it comes before the
    iron or after it. Angles are told in degrees; a name does not repeat its unit.
    """
    rows = []
    for parameter in get(cause.effect).parameters:
        value = cause.parameters.get(parameter.name)
        if value is None or abs(value) >= NEVER_S or parameter.name == ON_IRON:
            continue
        factor, unit = _UNITS.get(parameter.unit, (1.0, parameter.unit))
        name = _NAMES.get(parameter.name) or re.sub(r"_(mgauss\w*|s|rad|degc|m|hz)$", "", parameter.name)
        low, high = (factor * end for end in cause.ci95.get(parameter.name, (value, value)))
        interval = f"{low:.3g} to {high:.3g}" if low < high else "-"
        rows.append((name.replace("_", " "), f"{factor * value:.3g}", interval, unit))
    return rows


def _cause(cause: Cause, rivals: bool) -> list[str]:
    percent, title = f"{100.0 * cause.probability:.0f} %", get(cause.effect).title
    lines = [f"  {cause.effect} ({percent}), {title}: {cause_values(cause)}"]
    if rivals and cause.ambiguous_with:
        lines.append(f"    may also be {', '.join(cause.ambiguous_with)}")
    return lines


def _closing(name: str, closing: Closing, unit: str) -> str:
    noise = f"{closing.floor:.1f} is the recording's noise"
    if closing.after == closing.nominal:
        return f"  {name}: {closing.nominal:.1f} {unit} now; {noise}"
    return (
        f"  {name}: {closing.nominal:.1f} {unit} now; {closing.after:.1f} once corrected"
        f" ({shrink_words(closing)} of the gap; {noise})"
    )


def shrink_words(closing: Closing) -> str:
    """Say what share of a gap closes, with its 95 % interval where that says more."""
    if closing.after == closing.nominal:
        return "none"
    low, high = (100.0 * end for end in closing.shrink_ci95)
    shrink = f"{100.0 * min(max(closing.shrink, 0.0), 1.0):.0f} %"
    if not (math.isfinite(low) and math.isfinite(high)):
        return f"{shrink} (too short for an interval)"
    if high - low < _SHARP_PERCENT:
        return shrink
    ends = f"{max(low, 0.0):.0f} to {min(high, 100.0):.0f}"
    sure = 0.0 <= closing.shrink <= 1.0 and low > 0.0
    return f"{shrink} ({ends}{'' if sure else ', uncertain'})"


def channel_words(channel: str) -> str:
    """Spell a channel as people do: mag_x is the compass's x."""
    sensor, _, axis = channel.partition("_")
    return f"{_SENSORS[sensor]}'s {axis}" if axis else channel


def could_not_show(diagnosis: Diagnosis) -> dict[str, list[str]]:
    """Group by the reason what this recording cannot test, by the effects' ids."""
    by_reason: dict[str, list[str]] = {}
    for effect, why in diagnosis.not_testable:
        by_reason.setdefault(why, []).append(effect)
    return by_reason


def _places(places: Sequence[Place]) -> str:
    """Name the channel that holds most of the gap, and what it goes with."""
    channels = [p for p in places if p.coordinate == "axis"]
    goes_with: dict[str, float] = {}
    for place in places:
        if place.coordinate != "axis":
            goes_with[place.coordinate] = max(place.share, goes_with.get(place.coordinate, 0.0))
    on = f", most on the {channel_words(channels[0].channel)}" if channels else ""
    if not goes_with:
        return f"on no one thing{on}".replace("on no one thing, most on", "mostly on")
    most = max(goes_with.values())
    # What goes along with something else all the time explains as much and is not told apart from it here.
    alike = [name for name, share in goes_with.items() if share > most - _ALIKE]
    return f"mostly depends on {' or '.join(alike)} ({100.0 * most:.0f} %){on}"


def _background(diagnosis: Diagnosis) -> list[str]:
    lines = [f"  attitude from: {REFERENCES[diagnosis.reference]}", f"  {RMS_OF}"]
    if diagnosis.in_force is not None and (cured := diagnosis.in_force.words()) is not None:
        lines.append(f"  the calibration in force cures: {cured}")
    if diagnosis.corrected_rms_mgauss is not None:
        lines.append(f"  corrected readings less the field: {diagnosis.corrected_rms_mgauss:.2f} mG rms")
    lines += [f"  {note}" for note in diagnosis.notes]
    hidden = could_not_show(diagnosis)
    return lines + [f"  could not show ({why}): {', '.join(effects)}" for why, effects in hidden.items()]
