"""Restart an autopilot, where a person allowed it, and see that it came back as it was."""

from __future__ import annotations

from collections.abc import Mapping

from mavcompass import messages as mav
from mavcompass.enums import EkfFlag, MavCmd, MavResult
from mavcompass.errors import LinkLost, Refused, WriteFailed
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import WriteOutcome
from mavcompass.procedure.script import Script, expect, pause

# Until then what is heard may still be from before.
_GOING_DOWN_S = 2.5
_BACK_WITHIN_S = 60.0
_PLACE_WITHIN_S = 120.0
_RESTART = 1.0


def restart(
    desk: Desk, rates: MessageRates, wanted: Mapping[type[mav.Message], float], written: WriteOutcome
) -> Script[None]:
    """Restart the autopilot; wait for its heartbeat and its place, and read back what was written.

    Raises Refused where it will not, LinkLost where it does not come back, WriteFailed where it came back
    with other values.
    """
    context, starts = desk.context, desk.builder.restarts
    if desk.state.armed:
        raise Refused("The vehicle is armed: it was not restarted.", "Disarm it, then restart it.")
    knew_place = _knows_place(desk)
    context.show("restart", "Restarting the autopilot.")
    context.silent_until_s = context.now + _BACK_WITHIN_S
    context.send(
        mav.CommandLong(context.system, context.component, MavCmd.PREFLIGHT_REBOOT_SHUTDOWN, 0, _RESTART)
    )
    number = int(MavCmd.PREFLIGHT_REBOOT_SHUTDOWN)
    ack = yield from expect(context, mav.CommandAck, lambda a: a.command == number, _GOING_DOWN_S)
    if ack is not None and ack.result != MavResult.ACCEPTED:
        context.silent_until_s = context.now
        raise Refused("The autopilot refused to restart.", "Restart it by its power.")
    yield from pause(context, _GOING_DOWN_S)
    if (yield from expect(context, mav.Heartbeat, timeout_s=_BACK_WITHIN_S)) is None:
        raise LinkLost("The autopilot did not come back after its restart.", "Look at its power and link.")
    context.silent_until_s = context.now
    yield from rates.ask(context, wanted)
    yield from _wait_for_place(desk, knew_place)
    if desk.builder.restarts == starts:
        raise Refused("The autopilot did not restart.", "Restart it by its power.")
    held = yield from desk.dialect.read_parameters(context, tuple(written.values))
    lost = [name for name, value in written.values.items() if abs(held.get(name, value + 1.0) - value) > 1e-3]
    if lost:
        raise WriteFailed(
            f"After the restart {lost[0]} is not what was written.",
            f"Put the old values back with: {written.restore_command}",
            written.undo_file,
            written.restore_command,
        )


def _knows_place(desk: Desk) -> bool:
    ekf = desk.state.ekf
    return ekf is not None and bool(ekf.flags & EkfFlag.POS_HORIZ_ABS)


def _wait_for_place(desk: Desk, knew_place: bool) -> Script[None]:
    """Wait until the estimator has its place again: its declination and its yaw come with it."""
    context, desk.state.ekf = desk.context, None
    end_s, told_s = context.now + _PLACE_WITHIN_S, context.now
    while knew_place and not _knows_place(desk) and context.now < end_s:
        if context.now - told_s >= 5.0:
            context.show("restart", "The autopilot is back; waiting until it knows its place.")
            told_s = context.now
        yield from pause(context, 0.5)
