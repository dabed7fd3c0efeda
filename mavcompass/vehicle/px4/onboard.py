"""PX4's own compass calibration: start it, pass its instructions on in people's words, end it.

PREFLIGHT_CALIBRATION with p2 = 1; all that it tells are texts that begin with "[cal]". It stores its result
itself; all zeros cancel it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import LinkError, LinkLost, Refused
from mavcompass.messages import Incoming, Statustext
from mavcompass.procedure.commands import command
from mavcompass.procedure.script import Context, Script, pause

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
_SILENCE_S = 90.0
_POLL_S, _AGAIN_S = 0.1, 1.0
_PROGRESS = re.compile(r"progress <(\d+)>")


@dataclass(slots=True)
class _Told:
    """Hold what it said that has not been looked at, and when it last said something."""

    texts: list[str] = field(default_factory=list)
    heard_s: float = -math.inf
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


def calibrate_itself(context: Context) -> Script[str]:
    """Have it calibrate all compasses while a person turns the vehicle; return why it failed, "" where not.

    Raises Refused where it does not begin, LinkLost where it falls silent.
    """
    told, ended = _Told(), False
    context.listeners.append(told.hear)
    try:
        answer = yield from command(context, MavCmd.PREFLIGHT_CALIBRATION, 0.0, 1.0)
        if answer != MavResult.ACCEPTED:
            raise Refused(
                f"The autopilot does not begin its own calibration ({answer.name.lower()}). {told.other}",
                "Disarm it, and let any other calibration end.",
            )
        why = yield from _until_done(context, told)
        ended = True
        return why
    finally:
        context.listeners.remove(told.hear)
        if not ended:
            try:
                yield from command(context, MavCmd.PREFLIGHT_CALIBRATION)
            except LinkError as trouble:
                context.show("end", f"Its own calibration could not be cancelled: {trouble.what}")


def _until_done(context: Context, told: _Told) -> Script[str]:
    began_s, percent, pending = context.now, 0, list(_SIDES)
    words, said_s = "", -math.inf
    data: dict[str, float] = {}
    while True:
        while told.texts:
            text = told.texts.pop(0)
            if text.startswith("calibration done"):
                return ""
            if text.startswith(("calibration failed", "calibration cancelled")):
                also = f" {told.other.rstrip('.')}." if told.other else ""
                return f"The autopilot's own calibration failed: {text.partition(': ')[2] or text}.{also}"
            if found := _PROGRESS.search(text):
                percent = int(found[1])
            if text.startswith("pending:"):
                pending = [side for side in text.partition(":")[2].split() if side in _SIDES]
            if said := _in_words(text, pending):
                (words, data), said_s = said, -math.inf
        if words and context.now - said_s >= _AGAIN_S:
            done = f" {percent} %, {len(_SIDES) - len(pending)} of {len(_SIDES)} sides done."
            context.show("turn", words + done, 0.8 * percent / 100.0, live=1.0, **data)
            said_s = context.now
        if context.now - max(told.heard_s, began_s) > _SILENCE_S:
            raise LinkLost(
                f"The autopilot told nothing of its calibration for {_SILENCE_S:.0f} s.",
                "Check that its texts come over this link, then run again.",
            )
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
    if "progress <" in text and "side calibration" in text:
        return "Go on turning it round.", {"round_deg": 360.0}
    return None
