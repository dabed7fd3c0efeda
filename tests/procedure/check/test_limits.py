"""The questions of the pre-flight check, each at its limits, with the words that a person is told."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavcompass import messages as mav
from mavcompass.cli.check import _say
from mavcompass.cli.options import Output
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.enums import EkfFlag
from mavcompass.heading.fault_isolation import HeadingSource
from mavcompass.heading.true_north import NorthSeen, TrueNorth
from mavcompass.kinds import Kind
from mavcompass.procedure.check import CheckReport, items
from mavcompass.procedure.check.items import CheckItem, Reading, Verdict
from mavcompass.procedure.vehicle_state import VehicleIdentity

WORLD = EarthField((200.0, 0.0, 400.0))
TOTAL, DIP = math.hypot(200.0, 400.0), math.degrees(math.atan2(400.0, 200.0))
WELL = EkfFlag.ATTITUDE


def field(percent: float = 0.0, dip_deg: float = 0.0) -> list[CheckItem]:
    size, dip = TOTAL * (1.0 + percent / 100.0), math.radians(DIP + dip_deg)
    return items.judge_field(Reading(1, size * math.cos(dip), size * math.sin(dip), 0.0), WORLD)


def agreement(apart_deg: float) -> CheckItem:
    at = {1: 359.0, 2: 359.0 + apart_deg}  # across north
    (item,) = items.judge_agreement({i: HeadingSource.at(f"compass {i}", d, 1.0) for i, d in at.items()})
    return item


def north(off_deg: float, sigma_deg: float) -> CheckItem:
    seen_rad = math.sqrt(math.radians(sigma_deg) ** 2 - WORLD.declination_sigma_rad**2)
    seen = NorthSeen("gps-course", math.radians(off_deg), 0.0, seen_rad, 600.0)
    (item,) = items.judge_north(2, TrueNorth.of(WORLD, [seen]))
    return item


def offsets(*mgauss: float, calibrated: bool = True) -> CheckItem:
    return items.judge_offsets(2, FieldCorrection(mgauss), calibrated)  # type: ignore[arg-type]


def matrix(stretch: float) -> CheckItem:
    return items.judge_matrix(1, FieldCorrection(diagonals=(stretch, 1.0, 1.0)))


def gyro(deg_s: float) -> CheckItem:
    return items.judge_gyro(np.radians([[0.6 * deg_s + s, -0.8 * deg_s, 0.0] for s in (0.3, -0.3)]))


def variance(of: float, flags: int = WELL) -> CheckItem:
    item = items.judge_estimator(mav.EkfStatusReport(flags=flags, compass_variance=of))
    assert item is not None
    return item


def ratio(of: float, flags: int = WELL) -> CheckItem:
    item = items.judge_estimator(mav.EstimatorStatus(flags=flags, mag_ratio=of))
    assert item is not None
    return item


# The largest figure that passes, the largest that is warned of, and the words; a hair beyond is worse.
GRADED: dict[str, tuple[Callable[[float], CheckItem], float, float, str]] = {
    "matrix": (matrix, 1.35, 2.5, "axis {:.2f} times the other"),
    "yaw": (lambda v: items.judge_yaw(1, v, 1), 5.0, 15.0, "{:.1f} deg from compass 1, which steers it"),
    "strength": (lambda v: field(v)[0], 6.0, 15.0, "{:.1f} % stronger than the Earth's is here (447 mG)"),
    "weakness": (lambda v: field(-v)[0], 6.0, 15.0, "{:.1f} % weaker"),
    "dip": (lambda v: field(0.0, v)[1], 3.0, 8.0, "{:.1f} deg"),
    "dip the other way": (lambda v: field(0.0, -v)[1], 3.0, 8.0, "{:.1f} deg"),
    "agreement": (agreement, 5.0, 15.0, "{:.0f} deg apart; a turn tells"),
    "gyro": (gyro, 0.7, 2.0, "{:.2f} deg/s"),
    "estimator": (variance, 0.5, 0.8, "variance of {:.2f}"),
    "PX4's estimator": (ratio, 0.5, 1.0, "variance of {:.2f}"),
    "turn": (lambda v: items.judge_turn(1, 90.0 - v, 90.0, 0.5), 3.0, 8.0, "by the gyro 90.0 deg"),
    "unsure turn": (lambda v: items.judge_turn(1, 450.0 + v, 90.0, 2.0), 6.0, 12.0, "by the gyro 90.0 deg"),
    "north": (lambda v: north(v, 0.8), 3.0, 9.0, ""),
    "unsure north": (lambda v: north(-v, 1.5), 4.5, 13.5, ""),
}


@pytest.mark.parametrize("name", GRADED)
def test_a_figure_passes_is_warned_of_and_fails(name: str) -> None:
    """Whatever does not pass says what to do, and nothing else does."""
    judged, passes, warned, words = GRADED[name]
    figures: list[tuple[float, Verdict]] = [
        (0.98 * passes, "pass"), (1.02 * passes, "warn"), (0.98 * warned, "warn"), (1.02 * warned, "fail"),
    ]  # fmt: skip
    for figure, verdict in figures:
        item = judged(figure)
        assert (item.verdict, bool(item.remedy)) == (verdict, verdict != "pass"), (figure, item)
        assert (name == "agreement" and verdict == "pass") or words.format(figure) in item.text
        assert math.isnan(item.limit) or item.limit == pytest.approx(passes)
        assert math.isnan(item.value) or abs(item.value) == pytest.approx(figure)


JUDGED: list[tuple[CheckItem | None, Verdict | None, str, str]] = [
    (offsets(0.0, 0.0, 0.0, calibrated=False), "fail", "never been calibrated", "Calibrate it"),
    (offsets(-400.0, 300.0, 0.0), "pass", "Compass 2: offsets 500 mG.", ""),
    (offsets(-401.0, 0.0, 0.0), "warn", "offsets 401 mG", "away from iron"),
    (offsets(0.0, 0.0, 1800.0), "warn", "offsets 1800 mG", "away from iron"),
    (offsets(0.0, 1500.0, 1000.0), "fail", "offsets 1803 mG", "away from iron"),
    (matrix(0.0), "fail", "stretches one axis", "iron near"),
    (items.judge_silence(2, "SCALED_IMU2", "ardupilot", True), "fail", "of compass 2 came", "SCALED_IMU2"),
    (items.judge_silence(2, "SCALED_IMU2", "ardupilot", False), "warn", "of compass 2 came", "cable"),
    (items.judge_silence(2, "SCALED_IMU2", "px4", True), "fail", "No readings of compass 2", "cable"),
    (items.judge_silence(2, "SCALED_IMU2", "px4", False), "pass", "CAL_MAG1_ID may hold the id", ""),
    (items.judge_too_few(1, "RAW_IMU", 1, 0.98), "warn", "(1) came while the vehicle stood still, at 1.0 Hz",
     "RAW_IMU at 10 Hz"),
    (items.judge_yaw(1, -36.0, 2), "fail", "36.0 deg from compass 1, while compass 2 steers it", "landmark"),
    (items.judge_yaw(1, 9.0, "gps"), "warn", "receivers steer", "landmark"),
    (items.judge_yaw(1, 9.0, "other"), "warn", "no compass", "landmark"),
    (items.judge_yaw(1, 9.0, None), "warn", "do not tell", "landmark"),
    (items.judge_field(Reading(3, 0.6 * 184.0, -0.8 * 184.0, 0.0), None)[0], "fail", "is 184 mG", "iron"),
    (items.judge_field(Reading(3, 0.6 * 186.0, -0.8 * 186.0, 0.0), None)[0], "pass", "is 186 mG", ""),
    (items.judge_field(Reading(3, 0.6 * 719.0, 0.8 * 719.0, 0.0), None)[0], "pass", "any on Earth", ""),
    (items.judge_field(Reading(3, 0.6 * 721.0, 0.8 * 721.0, 0.0), None)[0], "fail", "is 721 mG", "from iron"),
    (agreement(0.0), "pass", "Compasses 1, 2 agree.", ""),
    (agreement(90.0), "fail", "90 deg apart", "Calibrate both"),
    (items.judge_stillness(True, "rotating"), None, "", ""),
    (items.judge_stillness(False, "rotating"), "warn", "(it still turns)", "come to rest"),
    (items.judge_stillness(False, ""), "warn", "(not for long enough)", "come to rest"),
    (items.judge_estimator(None), None, "", ""),
    (variance(0.1, 0), "fail", "not healthy", "Wait"),
    (variance(0.1, WELL | EkfFlag.UNINITIALIZED), "fail", "not healthy", "Wait"),
    (variance(0.1, WELL | 64), "pass", "0.10", ""),
    (ratio(0.1, 0), "fail", "not healthy", "Wait"),
    (ratio(0.1, WELL | 1024), "pass", "0.10", ""),  # 1024: a glitch of the receiver
    (ratio(math.nan), "fail", "does not use the compass", "from iron"),
]  # fmt: skip


@pytest.mark.parametrize(("item", "verdict", "says", "remedy"), JUDGED)
def test_what_is_no_figure_is_judged_too(
    item: CheckItem | None, verdict: Verdict | None, says: str, remedy: str
) -> None:
    assert (item and item.verdict) == verdict
    if item is not None:
        assert says in item.text and remedy in item.remedy and bool(item.remedy) is (verdict != "pass")


def test_one_compass_alone_agrees_with_all() -> None:
    assert items.judge_agreement({1: HeadingSource.at("compass 1", 10.0, 1.0)}) == []


def test_what_floats_or_flies_turns_and_leans_and_its_gyro_is_right_about_it() -> None:
    gyro = np.tile([0.0, 0.0, np.radians(3.0)], (40, 1))
    seen = [((0.0, 0.0, math.radians(2.6)), 0.005), ((0.0, 0.0, math.radians(3.4)), 0.005)]
    assert items.judge_gyro(gyro).verdict == "fail" and items.judge_gyro(gyro, seen).verdict == "pass"
    drifting = items.judge_gyro(2.0 * gyro, seen)
    assert drifting.verdict == "fail" and "by 3.00 deg/s (give or take 0.20) at" in drifting.text
    assert drifting.limit == pytest.approx(math.hypot(0.7, 2.0 * math.degrees(0.005 / math.sqrt(2.0))))
    # The surer compass counts for more; one that knows nothing of it for nothing.
    yaws = [(0.0, math.inf), (math.radians(2.0), 0.005), (math.radians(3.0), 0.0005)]
    one = items.judge_gyro(gyro, [((0.0, 0.0, yaw), sigma) for yaw, sigma in yaws])
    assert one.value == pytest.approx(0.01, abs=0.01)
    leaning = np.tile(np.radians([3.0, 4.0, 0.2]), (40, 1))
    assert items.judge_gyro(leaning, [((math.radians(2.9), math.radians(4.1), 0.0), 0.005)]).verdict == "pass"


def test_prearm_texts_about_the_compass_are_passed_on_once() -> None:
    ours = [
        "PreArm: Compass not calibrated",
        "Arm: Check mag field: 900",
        "Preflight Fail: Strong magnetic",
    ]
    found = items.judge_prearm([ours[0], *ours, "PreArm: GPS 1: not healthy", "Compass 1 calibrated"])
    assert [i.text for i in found] == [f'The autopilot says "{text}".' for text in ours]
    assert all(i.verdict == "fail" and i.remedy == "Calibrate." for i in found)


def test_the_worst_counts_and_what_is_unknown_is_null() -> None:
    assert items.worst([]) == "pass" and items.worst(["pass", "warn"]) == "warn"
    assert items.worst(["fail", "warn", "pass"]) == "fail"
    told = CheckItem("turn", "warn", "t", "r", 0, math.nan, 3.0).to_json()
    assert told == {
        "name": "turn", "compass": None, "verdict": "warn", "text": "t", "remedy": "r",
        "value": None, "limit": 3.0,
    }  # fmt: skip
    assert CheckItem("turn", "warn", "t", "r", 2, 1.5).to_json()["compass"] == 2


def report(*verdicts: Verdict, turned: bool = True, instance: int = 0, kind: Kind = "rover") -> CheckReport:
    found = tuple(
        CheckItem("dip", v, f"Compass 1 is {v}.", "Calibrate." if v == "fail" else "Wait.", instance)
        for v in verdicts
    )
    return CheckReport(VehicleIdentity(1, 1, "ardupilot", kind), found, turned, 7.0, ("Know.",))


@pytest.mark.parametrize(
    ("told", "says", "advised"),
    [
        (report("pass", "pass"), "Fit to drive: 2 checks passed.", False),
        (report("pass", turned=False), "Fit to drive: 1 check passed, without a turn.", False),
        (report("pass", "warn", kind="boat"), "Fit to sail, with care: Compass 1 is warn.", False),
        (report("warn", turned=False), "Fit to drive, with care: Compass 1 is warn. No turn was made.", 0),
        (report(*["warn"] * 3), "Fit to drive, with care: Compass 1 is warn, and 2 more.", False),
        (report("warn", *["fail"] * 3), "Not fit to drive: Compass 1 is fail. 3 of 4 checks failed.", True),
        (report("fail", instance=2), "Not fit to drive: calibrate compass 2. 1 of 1 check failed.", 1),
    ],
)  # fmt: skip
def test_the_report_says_its_worst(told: CheckReport, says: str, advised: bool) -> None:
    assert told.summary() == says and told.calibration_advised == advised
    document: dict[str, Any] = told.to_json()
    assert (document["summary"], document["verdict"], document["duration_s"]) == (says, told.verdict, 7.0)
    assert len(document["items"]) == len(told.items) and document["turned"] is told.turned


@pytest.mark.parametrize(("kind", "itself"), [("rover", True), ("copter", True), ("plane", False)])
def test_who_cannot_turn_on_the_spot_is_sent_to_a_hand(
    kind: Kind, itself: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    found = report("fail", turned=False, kind=kind)
    assert found.turns_itself is itself and found.to_json()["remarks"] == ["Know."]
    _say(found, "udpin:0.0.0.0:14550", Output(None), False)
    said = capsys.readouterr().out
    assert "calibrate udpin:0.0.0.0:14550" in said and "Note: Know." in said
    assert ("--motion hand" in said) is not itself
