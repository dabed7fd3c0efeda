"""ArduPilot's own compass calibration: start it, tell the person how far it is, take its report, end it.

DO_START_MAG_CAL with autosave 0 fits in the autopilot and writes nothing; MAG_CAL_PROGRESS tells which of the
80 parts of the sphere its readings cover, MAG_CAL_REPORT what it found. DO_CANCEL_MAG_CAL forgets it all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mavcompass.calibration.result import OwnFinding
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MagCalStatus, MavCmd, MavResult
from mavcompass.errors import LinkError, LinkLost, PoorCalibration, Refused
from mavcompass.messages import Incoming, MagCalProgress, MagCalReport, Statustext
from mavcompass.procedure.commands import command
from mavcompass.procedure.script import Context, Script, pause

# Progress is streamed a few times a second; none at all for so long is not streamed, or no longer.
_SILENCE_S = 10.0
# So long without a new direction the person has stopped turning it, or knows not how.
_PATIENCE_S = 120.0
_POLL_S = 0.5
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
class _Told:
    """Hold what the autopilot has told of its calibration since it began."""

    progress: dict[int, MagCalProgress] = field(default_factory=dict)
    reports: dict[int, MagCalReport] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)
    heard_s: float = -math.inf

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


def calibrate_itself(context: Context, instances: tuple[int, ...]) -> Script[Mapping[int, OwnFinding]]:
    """Have it calibrate these compasses while a person turns the vehicle, and forget it afterwards.

    Raises Refused where it does not begin, PoorCalibration where it is not turned, LinkLost in silence.
    """
    mask, told = float(sum(1 << instance - 1 for instance in instances)), _Told()
    context.listeners.append(told.hear)
    try:
        # No retry: what failed is said. No autosave, no delay, no reboot.
        answer = yield from command(context, MavCmd.DO_START_MAG_CAL, mask)
        if answer != MavResult.ACCEPTED:
            said = f" It says: {told.texts[-1]}." if told.texts else ""
            raise Refused(
                f"The autopilot does not begin its own calibration ({answer.name.lower()}).{said}",
                "Disarm it; a compass that is not used (COMPASS_USE) or not healthy is not calibrated by it.",
            )
        yield from _until_reported(context, instances, told)
    finally:
        try:
            yield from command(context, MavCmd.DO_CANCEL_MAG_CAL, mask)
        except LinkError as trouble:
            context.show("end", f"Its own calibration could not be cancelled: {trouble.what}")
        context.listeners.remove(told.hear)
    return {instance: _finding(told.reports[instance]) for instance in instances}


def _until_reported(context: Context, instances: tuple[int, ...], told: _Told) -> Script[None]:
    began_s = grew_s = context.now
    most = 0.0
    while not set(instances) <= set(told.reports):
        if context.now - max(told.heard_s, began_s) > _SILENCE_S:
            raise LinkLost(
                f"The autopilot told nothing of its calibration for {_SILENCE_S:.0f} s.",
                "Check that it streams MAG_CAL_PROGRESS on this link (SRn_EXTRA3), then run again.",
            )
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
        yield from pause(context, _POLL_S)


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
