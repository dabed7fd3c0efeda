"""The autopilots' own compass calibrations: started, watched by a person who turns the vehicle, and ended.

ArduPilot's: DO_START_MAG_CAL with autosave 0 fits in the autopilot and writes nothing; MAG_CAL_PROGRESS tells
which of the 80 parts of the sphere its readings cover, MAG_CAL_REPORT what it found. DO_CANCEL_MAG_CAL
forgets it all.

PX4's: PREFLIGHT_CALIBRATION with p2 = 1; all that it tells are texts that begin with "[cal]". It stores its
result itself; all zeros cancel it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from mavcompass.calibration.result import OwnFinding
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MagCalStatus, MavCmd, MavResult
from mavcompass.errors import LinkError, LinkLost, PoorCalibration, Refused
from mavcompass.messages import Incoming, MagCalProgress, MagCalReport, Statustext
from mavcompass.procedure.commands import command
from mavcompass.procedure.script import Context, Script, pause


def _begin(
    context: Context, number: MavCmd, *params: float, remedy: str, said: Callable[[], str]
) -> Script[None]:
    """Begin a calibration. Raises Refused, with what the autopilot said, where it will not."""
    answer = yield from command(context, number, *params)
    if answer != MavResult.ACCEPTED:
        raise Refused(
            f"The autopilot does not begin its own calibration ({answer.name.lower()}).{said()}", remedy
        )


def _need_words(context: Context, heard_s: float, silence_s: float, remedy: str) -> None:
    """Raise LinkLost where the autopilot has told nothing of its calibration for too long."""
    if context.now - heard_s > silence_s:
        raise LinkLost(f"The autopilot told nothing of its calibration for {silence_s:.0f} s.", remedy)


def _cancel(context: Context, number: MavCmd, *params: float) -> Script[None]:
    """End a calibration, as far as the link carries that."""
    try:
        yield from command(context, number, *params)
    except LinkError as trouble:
        context.show("end", f"Its own calibration could not be cancelled: {trouble.what}")


# --- ArduPilot's ----------------------------------------------------------------------------------

# Progress is streamed a few times a second; none at all for so long is not streamed, or no longer.
_ARDUPILOT_SILENCE_S = 10.0
# So long without a new direction the person has stopped turning it, or knows not how.
_PATIENCE_S = 120.0
_PROGRESS_EVERY_S = 0.5
_SECTIONS, _BLOCKS = 80, " ░▒▓█"
_TURN = "Turn it slowly every way: each side down once, and round on each."
_NO_ELLIPSOID = "its readings fit no ellipsoid: {fitness:.0f} mG rms are left. Turn it again, away from steel"
_WHY_NOT = {
    MagCalStatus.FAILED: _NO_ELLIPSOID,
    MagCalStatus.BAD_ORIENTATION: "the compass turns otherwise than it is set to be mounted (COMPASS_ORIENT)",
    MagCalStatus.BAD_RADIUS: "the field's strength is not the Earth's at this place: steel or a magnet near"
    " it, or a sensor of another scale",
    8: "its offsets are larger than it takes (COMPASS_OFFS_MAX): move the compass away from iron",
    9: "its scales are out of range: the sensor is damaged, or was not turned every way",
    10: _NO_ELLIPSOID,
}


@dataclass(slots=True)
class _Progress:
    """Hold what the autopilot has told of its calibration since it began."""

    progress: dict[int, MagCalProgress] = field(default_factory=dict)
    reports: dict[int, MagCalReport] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)
    heard_s: float = field(init=False)  # from when it has begun

    def hear(self, heard: Incoming) -> None:
        """Take a message; a report counts after progress: that of an earlier run is sent until then."""
        match heard.message:
            case MagCalProgress() as progress:
                self.progress[progress.compass_id + 1], self.heard_s = progress, heard.time_s
            case MagCalReport() as report if report.compass_id + 1 in self.progress:
                self.reports[report.compass_id + 1], self.heard_s = report, heard.time_s
            case Statustext() as said:
                self.texts.append(said.text)

    def seen(self) -> tuple[int, str]:
        """Return the parts of the sphere that all compasses have seen, and as blocks, twenty of four each."""
        masks = [int.from_bytes(bytes(p.completion_mask), "little") for p in self.progress.values()]
        both = (1 << _SECTIONS) - 1 if masks else 0
        for mask in masks:
            both &= mask
        blocks = "".join(_BLOCKS[(both >> 4 * k & 15).bit_count()] for k in range(_SECTIONS // 4))
        return both.bit_count(), blocks


def calibrate_ardupilot(context: Context, instances: tuple[int, ...]) -> Script[Mapping[int, OwnFinding]]:
    """Have it calibrate these compasses while a person turns the vehicle, and forget it afterwards.

    Raises Refused where it does not begin, PoorCalibration where it is not turned, LinkLost in silence.
    """
    mask, told = float(sum(1 << instance - 1 for instance in instances)), _Progress()
    context.listeners.append(told.hear)
    try:
        # No retry: what failed is said. No autosave, no delay, no reboot.
        yield from _begin(
            context,
            MavCmd.DO_START_MAG_CAL,
            mask,
            remedy="Disarm it; a compass that is not used (COMPASS_USE) or not healthy is not calibrated by"
            " it.",
            said=lambda: f" It says: {told.texts[-1]}." if told.texts else "",
        )
        yield from _until_reported(context, instances, told)
    finally:
        yield from _cancel(context, MavCmd.DO_CANCEL_MAG_CAL, mask)
        context.listeners.remove(told.hear)
    return {instance: _finding(told.reports[instance]) for instance in instances}


def _until_reported(context: Context, instances: tuple[int, ...], told: _Progress) -> Script[None]:
    grew_s = told.heard_s = context.now
    most = 0.0
    while not set(instances) <= set(told.reports):
        remedy = "Check that it streams MAG_CAL_PROGRESS on this link (SRn_EXTRA3), then run again."
        _need_words(context, told.heard_s, _ARDUPILOT_SILENCE_S, remedy)
        running = [p for i, p in told.progress.items() if i not in told.reports]
        percent = min((p.completion_pct for p in running), default=0)
        parts, blocks = told.seen()
        if percent + parts > most:
            most, grew_s = percent + parts, context.now
        if context.now - grew_s > _PATIENCE_S:
            raise PoorCalibration(
                f"Its own calibration stands at {percent} % since {_PATIENCE_S:.0f} s: {parts} of {_SECTIONS}"
                " parts of the sphere were seen.",
                "Turn it every way when you start again; what cannot be lifted takes another method.",
            )
        text = f"{_TURN} {percent} %, {parts} of {_SECTIONS} directions seen [{blocks}]"
        context.show("turn", text, 0.8 * percent / 100.0, live=1.0, tumble=1.0, directions=float(parts))
        yield from pause(context, _PROGRESS_EVERY_S)


def _finding(report: MagCalReport) -> OwnFinding:
    if report.cal_status != MagCalStatus.SUCCESS:
        why = _WHY_NOT.get(report.cal_status, f"status {report.cal_status}").format(fitness=report.fitness)
        return OwnFinding(why_not=f"The autopilot's own calibration failed: {why}.")
    if report.new_orientation != report.old_orientation:
        return OwnFinding(
            why_not=f"The autopilot finds it mounted in orientation {report.new_orientation}, not"
            f" {report.old_orientation} as set: set that (COMPASS_ORIENT) and calibrate again."
        )
    offsets = (report.ofs_x, report.ofs_y, report.ofs_z)
    diagonals = (report.diag_x, report.diag_y, report.diag_z)
    across = (report.offdiag_x, report.offdiag_y, report.offdiag_z)
    # Without a fix it tells no scale: 0 means that none is applied.
    return OwnFinding(FieldCorrection(offsets, diagonals, across, scale=report.scale_factor or 1.0))


# --- PX4's ----------------------------------------------------------------------------------------

# Its six sides by its own names: what to do, and the roll and pitch of it, degrees.
_SIDES = {
    "down": ("level, as it stands", 0.0, 0.0),
    "up": ("upside down", 180.0, 0.0),
    "left": ("on its left side", -90.0, 0.0),
    "right": ("on its right side", 90.0, 0.0),
    "front": ("nose down", 0.0, -90.0),
    "back": ("tail down", 0.0, 90.0),
}
# It gives a side up after 42 s, and asks again before that.
_PX4_SILENCE_S = 90.0
_POLL_S, _AGAIN_S = 0.1, 1.0
_STEADIER = "Hold each side for five seconds, and steadier; what cannot be lifted takes another method."
_PERCENT = re.compile(r"progress <(\d+)>")


@dataclass(slots=True)
class _Texts:
    """Hold what it said that has not been looked at, and when it last said something."""

    texts: list[str] = field(default_factory=list)
    heard_s: float = field(init=False)
    other: str = ""

    def hear(self, heard: Incoming) -> None:
        """Take a text."""
        if isinstance(heard.message, Statustext):
            mark, _, text = heard.message.text.partition("[cal] ")
            if mark or not text:
                self.other = heard.message.text
            else:
                self.texts.append(text)
                self.heard_s = heard.time_s


def calibrate_px4(context: Context) -> Script[str]:
    """Have it calibrate all compasses while a person turns the vehicle; return why it failed, "" where not.

    Raises Refused where it does not begin, PoorCalibration where it is not turned, LinkLost in silence.
    """
    told, ended = _Texts(), False
    context.listeners.append(told.hear)
    with context.station():
        try:
            yield from _begin(
                context,
                MavCmd.PREFLIGHT_CALIBRATION,
                *(0.0, 1.0),
                remedy="Disarm it, and let any other calibration end.",
                said=lambda: f" {told.other}",
            )
            why = yield from _until_done(context, told)
            ended = True
            return why
        finally:
            context.listeners.remove(told.hear)
            if not ended:
                yield from _cancel(context, MavCmd.PREFLIGHT_CALIBRATION)


def _until_done(context: Context, told: _Texts) -> Script[str]:
    said_s = told.heard_s = context.now
    words, percent, pending = "", 0, list(_SIDES)
    data: dict[str, float] = {}
    while True:
        while told.texts:
            text = told.texts.pop(0)
            if text.startswith("calibration done"):
                return ""
            if text.startswith(("calibration failed", "calibration cancelled")):
                also = f" {told.other.rstrip('.')}." if told.other else ""
                return f"The autopilot's own calibration failed: {text.partition(': ')[2] or text}.{also}"
            if found := _PERCENT.search(text):
                percent = int(found[1])
            if text.startswith("pending:"):
                pending = [side for side in text.partition(":")[2].split() if side in _SIDES]
            if said := _in_words(text, pending):
                (words, data), said_s = said, -math.inf
        if words and context.now - said_s >= _AGAIN_S:
            done = f" {percent} %, {len(_SIDES) - len(pending)} of {len(_SIDES)} sides done."
            context.show("turn", words + done, 0.8 * percent / 100.0, live=1.0, **data)
            said_s = context.now
        if words and context.now - told.heard_s > _PX4_SILENCE_S:
            raise PoorCalibration(
                f"Since {_PX4_SILENCE_S:.0f} s its own calibration waits: {words}", _STEADIER
            )
        remedy = "Check that its texts come over this link, then run again."
        _need_words(context, told.heard_s, _PX4_SILENCE_S, remedy)
        yield from pause(context, _POLL_S)


def _in_words(text: str, pending: list[str]) -> tuple[str, dict[str, float]] | None:
    """Say what to do now, with figures for hands that follow; None for what asks nothing of a person."""
    if text.startswith("hold vehicle still") and pending:
        side, roll_deg, pitch_deg = _SIDES[pending[0]]
        others = ", or ".join(_SIDES[name][0] for name in pending[1:])
        either = f" (or {others})" if others else ""
        words = f"Hold it still {side}{either}."
        return words, {"roll_deg": roll_deg, "pitch_deg": pitch_deg}
    if text.startswith("Rotate vehicle"):
        return "Now turn it round slowly, this side down.", {"round_deg": 360.0}
    if text.endswith("side already completed"):
        return "This side is done: take another.", {}
    if "side calibration: progress <" in text:
        return "Go on turning it round.", {"round_deg": 360.0}
    return None
