"""The autopilots' own calibrations on the wire, as the pages of their manuals have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from dialogue import Expect, Reply, vehicle_script

from mavcompass.calibration.result import OwnFinding
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MagCalStatus, MavCmd, MavResult
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.messages import CommandAck, CommandLong, MagCalProgress, MagCalReport, Statustext
from mavcompass.procedure.script import Context, Machine, Script, Show
from mavcompass.procedure.vehicle_state import find_vehicle
from mavcompass.vehicle.dialects import own_calibration
from mavcompass.vehicle.driver import run

START, CANCEL, PREFLIGHT = MavCmd.DO_START_MAG_CAL, MavCmd.DO_CANCEL_MAG_CAL, MavCmd.PREFLIGHT_CALIBRATION
ONE, TWO = MagCalStatus.RUNNING_STEP_ONE, MagCalStatus.RUNNING_STEP_TWO
SEEN = (0xFF,) * 5 + (0,) * 5


def accepted(command: MavCmd) -> Reply:
    return Reply(CommandAck(command, MavResult.ACCEPTED))


def report(compass: int = 0, status: int = MagCalStatus.SUCCESS, **more: Any) -> MagCalReport:
    return MagCalReport(
        compass, 1, status, 0, 4.2, -10.0, 20.0, 30.0, 1.1, 0.9, 1.0, 0.01, 0.02, 0.03, **more
    )


def of_ardupilot(context: Context) -> Script[Mapping[int, OwnFinding]]:
    yield from find_vehicle(context)
    return (yield from own_calibration.calibrate_ardupilot(context, (1,)))


def of_px4(context: Context) -> Script[str]:
    yield from find_vehicle(context)
    return (yield from own_calibration.calibrate_px4(context))


def test_ardupilot_is_started_without_saving_watched_and_ended() -> None:
    shown: list[Show] = []
    with vehicle_script(
        # Compass 1 alone; no retry, no autosave, no delay, no reboot.
        Expect(CommandLong(command=START, param1=1.0)),
        Reply(report(status=MagCalStatus.FAILED)),  # of an earlier run: it is sent until this one has begun
        accepted(START),
        Reply(MagCalProgress(0, 1, ONE, 1, 20, (0,) * 10), after_s=0.5),
        Reply(MagCalProgress(0, 1, TWO, 1, 60, SEEN), after_s=1.0),
        Reply(report(scale_factor=1.05), after_s=1.5),
        Expect(CommandLong(command=CANCEL, param1=1.0)),
        accepted(CANCEL),
    ) as link:
        found = run(Machine(of_ardupilot), link, on_show=shown.append)
    cure = FieldCorrection((-10.0, 20.0, 30.0), (1.1, 0.9, 1.0), (0.01, 0.02, 0.03), scale=1.05)
    assert found == {1: OwnFinding(cure)}
    assert any("60 %, 40 of 80 directions seen [██████████          ]" in show.text for show in shown)
    assert all(dict(show.data)["tumble"] for show in shown)


def found_by(told: MagCalReport, *before: Reply) -> OwnFinding:
    with vehicle_script(
        Expect(CommandLong(command=START, param1=1.0)),
        accepted(START),
        *(before or [Reply(MagCalProgress(0, 1, ONE, 1, 20))]),
        Reply(told),
        Expect(CommandLong(command=CANCEL, param1=1.0)),
        accepted(CANCEL),
    ) as link:
        return run(Machine(of_ardupilot), link)[1]


def test_without_a_fix_ardupilot_tells_no_scale() -> None:
    found = found_by(report()).correction
    assert found is not None and found.scale == 1.0


@pytest.mark.parametrize(
    ("status", "more", "says"),
    [
        (MagCalStatus.FAILED, {}, "fit no ellipsoid: 4 mG rms are left"),
        (MagCalStatus.BAD_RADIUS, {}, "strength is not the Earth's at this place"),
        (MagCalStatus.BAD_ORIENTATION, {}, "otherwise than it is set to be mounted (COMPASS_ORIENT)"),
        (8, {}, "COMPASS_OFFS_MAX"),
        (9, {}, "scales are out of range"),
        (42, {}, "status 42"),
        (MagCalStatus.SUCCESS, {"new_orientation": 4, "old_orientation": 0}, "orientation 4, not 0 as set"),
    ],
)
def test_what_ardupilot_could_not_do_is_said_in_words(status: int, more: dict[str, int], says: str) -> None:
    found = found_by(report(status=status, **more))
    assert found.correction is None and says in found.why_not


def test_ardupilot_that_does_not_begin_says_why() -> None:
    with (
        vehicle_script(
            Expect(CommandLong(command=START, param1=1.0)),
            Reply(Statustext(5, "Disarm to allow compass calibration")),
            Reply(CommandAck(START, MavResult.FAILED)),
            Expect(CommandLong(command=CANCEL, param1=1.0)),
            accepted(CANCEL),
        ) as link,
        pytest.raises(Refused, match="Disarm to allow compass calibration"),
    ):
        run(Machine(of_ardupilot), link)


def test_a_vehicle_that_is_not_turned_is_given_up_after_two_minutes() -> None:
    with (
        vehicle_script(
            Expect(CommandLong(command=START, param1=1.0)),
            accepted(START),
            *(Reply(MagCalProgress(0, 1, ONE, 1, 3, SEEN), after_s=1.0) for _ in range(130)),
            Expect(CommandLong(command=CANCEL, param1=1.0)),
            accepted(CANCEL),
        ) as link,
        pytest.raises(PoorCalibration, match="stands at 3 % since 120 s"),
    ):
        run(Machine(of_ardupilot), link)


def test_a_vehicle_of_which_ever_more_sides_are_seen_is_given_longer() -> None:
    seen = [tuple(((1 << k // 2) - 1).to_bytes(10, "little")) for k in range(130)]
    told = [Reply(MagCalProgress(0, 1, ONE, 1, 3, sides), after_s=1.0) for sides in seen]
    assert found_by(report(), *told).correction is not None


def said(*texts: str) -> list[Reply]:
    return [Reply(Statustext(6, f"[cal] {text}"), after_s=0.3) for text in texts]


def test_px4_is_started_its_texts_passed_on_in_words_and_left_when_done() -> None:
    shown: list[Show] = []
    with vehicle_script(
        Expect(CommandLong(command=PREFLIGHT, param2=1.0)),
        accepted(PREFLIGHT),
        *said("calibration started: 2 mag", "pending: left down", "hold vehicle still on a pending side"),
        *said("left orientation detected", "left orientation detected", "Rotate vehicle"),
        *said("left side calibration: progress <75>", "left side done, rotate to a different side"),
        *said("pending: down", "hold vehicle still on a pending side", "down side already completed"),
        *said("progress <100>", "calibration done: mag"),
    ) as link:
        assert run(Machine(of_px4), link, on_show=shown.append) == ""
    told = {show.text: dict(show.data) for show in shown}
    assert shown[0].text == "Hold it still on its left side (or level, as it stands). 0 %, 4 of 6 sides done."
    for text in ("Now turn it round slowly, this side down. 0 %", "Go on turning it round. 75 %"):
        assert told[f"{text}, 4 of 6 sides done."]["round_deg"] == 360.0
    assert "This side is done: take another. 75 %, 5 of 6 sides done." in told


@pytest.mark.parametrize(
    ("side", "words", "roll_deg", "pitch_deg"),
    [
        ("down", "level, as it stands", 0.0, 0.0), ("up", "upside down", 180.0, 0.0),
        ("left", "on its left side", -90.0, 0.0), ("right", "on its right side", 90.0, 0.0),
        ("front", "nose down", 0.0, -90.0), ("back", "tail down", 0.0, 90.0),
    ],
)  # fmt: skip
def test_each_side_is_shown_as_it_is_held(side: str, words: str, roll_deg: float, pitch_deg: float) -> None:
    shown: list[Show] = []
    with vehicle_script(
        Expect(CommandLong(command=PREFLIGHT, param2=1.0)),
        accepted(PREFLIGHT),
        *said("calibration started: 2 mag", f"pending: {side}", "hold vehicle still on a pending side"),
        *said("calibration done: mag"),
    ) as link:
        run(Machine(of_px4), link, on_show=shown.append)
    assert shown[0].text == f"Hold it still {words}. 0 %, 5 of 6 sides done."
    assert dict(shown[0].data).items() >= {"roll_deg": roll_deg, "pitch_deg": pitch_deg}.items()


def test_what_px4_could_not_do_is_told_with_its_own_reason() -> None:
    with vehicle_script(
        Expect(CommandLong(command=PREFLIGHT, param2=1.0)),
        accepted(PREFLIGHT),
        Reply(Statustext(0, "Retry calibration (mag 0 sphere radius invalid")),
        *said("calibration failed: mag"),
    ) as link:
        why = run(Machine(of_px4), link)
    assert (
        why == "The autopilot's own calibration failed: mag. Retry calibration (mag 0 sphere radius invalid."
    )


def test_px4_that_is_armed_does_not_begin() -> None:
    with (
        vehicle_script(
            Expect(CommandLong(command=PREFLIGHT, param2=1.0)),
            Reply(CommandAck(PREFLIGHT, MavResult.TEMPORARILY_REJECTED)),
            Expect(CommandLong(command=PREFLIGHT)),
            Reply(CommandAck(PREFLIGHT, MavResult.TEMPORARILY_REJECTED)),
        ) as link,
        pytest.raises(Refused, match="does not begin its own calibration"),
    ):
        run(Machine(of_px4), link)


@pytest.mark.parametrize(
    ("last", "why"),
    [
        ("calibration started: 2 mag", "told nothing of its calibration for 90 s"),
        ("hold vehicle still on a pending side", "Since 90 s its own calibration waits: Hold it still level"),
    ],
)
def test_px4_that_falls_silent_is_cancelled(last: str, why: str) -> None:
    with (
        vehicle_script(
            Expect(CommandLong(command=PREFLIGHT, param2=1.0)),
            accepted(PREFLIGHT),
            *said(last),
            Expect(CommandLong(command=PREFLIGHT)),  # all zeros
            accepted(PREFLIGHT),
        ) as link,
        pytest.raises(Exception, match=why),
    ):
        run(Machine(of_px4), link)
