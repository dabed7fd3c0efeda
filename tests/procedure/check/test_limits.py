"""The questions of the pre-flight check, each at its limits, with the words that a person is told."""

from __future__ import annotations

import math

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
from mavcompass.steering import SteeringSource

WORLD = EarthField((200.0, 0.0, 400.0))
TOTAL, DIP = math.hypot(200.0, 400.0), math.degrees(math.atan2(400.0, 200.0))


def with_remedy(item: CheckItem) -> bool:
    """Whatever does not pass says what to do, and nothing else does."""
    return bool(item.remedy) is (item.verdict != "pass")


def reading(strength: float = 1.0, dip_deg: float = 0.0) -> Reading:
    dip = math.radians(DIP + dip_deg)
    return Reading(1, strength * TOTAL * math.cos(dip), strength * TOTAL * math.sin(dip), 0.0)


@pytest.mark.parametrize(
    ("offsets", "verdict", "said"),
    [
        ((0.0, 0.0, 0.0), "fail", "Compass 2 has never been calibrated."),
        ((1.0, 0.0, 0.0), "pass", "Compass 2: offsets 1 mG."),
        ((-400.0, 300.0, 0.0), "pass", "Compass 2: offsets 500 mG."),
        ((-401.0, 0.0, 0.0), "warn", "Compass 2: offsets 401 mG."),
        ((0.0, 0.0, 1800.0), "warn", "Compass 2: offsets 1800 mG."),
        ((0.0, 1500.0, 1000.0), "fail", "Compass 2: offsets 1803 mG."),
    ],
)
def test_offsets(offsets: tuple[float, float, float], verdict: Verdict, said: str) -> None:
    item = items.judge_offsets(2, FieldCorrection(offsets), calibrated=any(offsets))
    assert (item.name, item.verdict, item.text, item.instance) == ("offsets", verdict, said, 2)
    assert with_remedy(item) and item.value == max(map(abs, offsets))
    assert item.limit == 400.0 or verdict == "fail"


@pytest.mark.parametrize(
    ("stretch", "verdict"), [(1.0, "pass"), (1.34, "pass"), (1.36, "warn"), (2.49, "warn"), (2.51, "fail")]
)
def test_matrix(stretch: float, verdict: Verdict) -> None:
    for matrix in ((stretch, 1.0, 1.0), (1.0, 1.0 / stretch, 1.0)):
        item = items.judge_matrix(1, FieldCorrection(diagonals=matrix))
        assert item.verdict == verdict and with_remedy(item) and item.limit == 1.35
        assert item.value == pytest.approx(stretch) and f"axis {stretch:.2f} times the other" in item.text
    thin = items.judge_matrix(1, FieldCorrection(diagonals=(1.0, 0.05, 1.0)))
    assert thin.verdict == "fail" and thin.value == pytest.approx(20.0)
    flat = items.judge_matrix(1, FieldCorrection(diagonals=(1.0, 0.0, 1.0)))
    assert flat.verdict == "fail" and flat.to_json()["value"] is None


@pytest.mark.parametrize(
    ("autopilot", "steers", "verdict"),
    [("ardupilot", True, "fail"), ("ardupilot", False, "warn"), ("px4", True, "fail"),
     ("px4", False, "pass")],
)  # fmt: skip
def test_a_compass_that_never_spoke(autopilot: str, steers: bool, verdict: Verdict) -> None:
    item = items.judge_silence(2, "SCALED_IMU2", autopilot, steers)
    assert item.verdict == verdict and with_remedy(item)
    assert item.text.startswith("No readings of compass 2 came") and "COMPASS_" not in item.text + item.remedy
    assert ("CAL_MAG1_ID" in item.text) is (verdict == "pass")


def test_a_slow_stream_is_no_fault_of_a_cable() -> None:
    item = items.judge_too_few(1, "RAW_IMU", 1, 0.98)
    assert item.verdict == "warn" and "(1) came while the vehicle stood still, at 1.0 Hz" in item.text
    assert "RAW_IMU at 10 Hz" in item.remedy and "cable" not in item.remedy


@pytest.mark.parametrize(
    ("off_deg", "verdict"),
    [(4.9, "pass"), (-5.1, "warn"), (14.9, "warn"), (-36.0, "fail")],
)
@pytest.mark.parametrize(
    ("source", "words"),
    [(1, "which steers it"), (2, "compass 2 steers it"), ("gps", "receivers steer"), ("other", "no compass"),
     (None, "do not tell")],
)  # fmt: skip
def test_the_autopilots_own_yaw(off_deg: float, verdict: Verdict, source: SteeringSource, words: str) -> None:
    item = items.judge_yaw(1, off_deg, source)
    assert item.verdict == verdict and with_remedy(item) and words in item.text
    assert f"{abs(off_deg):.1f} deg from compass 1" in item.text and "alibrate" not in item.remedy


@pytest.mark.parametrize(
    ("percent", "verdict"),
    [(0.0, "pass"), (5.9, "pass"), (6.1, "warn"), (-6.1, "warn"), (14.9, "warn"), (15.1, "fail"),
     (-15.1, "fail")],
)  # fmt: skip
def test_strength(percent: float, verdict: Verdict) -> None:
    strength, dip = items.judge_field(reading(1.0 + percent / 100.0), WORLD)
    assert strength.verdict == verdict and with_remedy(strength) and dip.verdict == "pass"
    assert strength.value == pytest.approx(percent, abs=1e-9) and strength.limit == 6.0
    assert percent == 0.0 or ("stronger" if percent > 0.0 else "weaker") in strength.text
    assert f"{abs(percent):.1f} %" in strength.text and "(447 mG)" in strength.text


@pytest.mark.parametrize(
    ("degrees", "verdict"),
    [(2.9, "pass"), (3.1, "warn"), (-3.1, "warn"), (7.9, "warn"), (8.1, "fail"), (-8.1, "fail")],
)
def test_dip(degrees: float, verdict: Verdict) -> None:
    strength, dip = items.judge_field(reading(1.0, degrees), WORLD)
    assert dip.verdict == verdict and with_remedy(dip) and strength.verdict == "pass"
    assert dip.value == pytest.approx(degrees) and f"{abs(degrees):.1f} deg" in dip.text and dip.limit == 3.0


@pytest.mark.parametrize(
    ("mgauss", "verdict"), [(184.0, "fail"), (185.0, "pass"), (720.0, "pass"), (721.0, "fail")]
)
def test_strength_where_the_place_is_unknown(mgauss: float, verdict: Verdict) -> None:
    (item,) = items.judge_field(Reading(3, 0.6 * mgauss, -0.8 * mgauss, 0.0), None)
    assert item.verdict == verdict and with_remedy(item) and item.value == pytest.approx(mgauss)
    assert f"Compass 3: the field is {mgauss:.0f} mG" in item.text


@pytest.mark.parametrize(
    ("apart_deg", "verdict"), [(0.0, "pass"), (4.9, "pass"), (5.2, "warn"), (14.8, "warn"), (15.2, "fail")]
)
def test_agreement(apart_deg: float, verdict: Verdict) -> None:
    at = {1: 10.0, 2: 10.0 + apart_deg}
    found = items.judge_agreement({i: HeadingSource.at(f"compass {i}", d, 1.0) for i, d in at.items()})
    assert [i.verdict for i in found] == [verdict] and found[0].name == "agreement"
    assert items.judge_agreement({1: HeadingSource.at("compass 1", 10.0, 1.0)}) == []
    if verdict == "pass" and apart_deg == 0.0:
        assert found[0].text == "Compasses 1, 2 agree." and not found[0].remedy
    if verdict != "pass":
        assert found[0].remedy.startswith("Calibrate both") and found[0].limit == 5.0


@pytest.mark.parametrize(
    ("deg_s", "verdict"), [(0.69, "pass"), (0.71, "warn"), (1.99, "warn"), (2.01, "fail")]
)
def test_gyro(deg_s: float, verdict: Verdict) -> None:
    rates = np.radians([[0.6 * deg_s + 0.3, -0.8 * deg_s, 0.0], [0.6 * deg_s - 0.3, -0.8 * deg_s, 0.0]])
    item = items.judge_gyro(rates)
    assert item.verdict == verdict and with_remedy(item) and item.value == pytest.approx(deg_s)
    assert item.instance == 0 and item.limit == 0.7 and f"{deg_s:.2f} deg/s" in item.text


def test_what_floats_turns_and_its_gyro_is_right_about_it() -> None:
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


def test_what_flies_leans_and_its_gyro_is_right_about_it() -> None:
    gyro = np.tile(np.radians([3.0, 4.0, 0.2]), (40, 1))
    leaning = [((math.radians(2.9), math.radians(4.1), 0.0), 0.005)]
    assert items.judge_gyro(gyro).verdict == "fail" and items.judge_gyro(gyro, leaning).verdict == "pass"


def test_stillness() -> None:
    assert items.judge_stillness(True, "rotating") is None
    told = items.judge_stillness(False, "rotating")
    assert told is not None and told.verdict == "warn" and "(it still turns)" in told.text and told.remedy
    for why_not, said in (("nothing was heard", "(nothing was heard)"), ("", "(not for long enough)")):
        assert said in getattr(items.judge_stillness(False, why_not), "text", "")


@pytest.mark.parametrize(
    ("flags", "variance", "verdict"),
    [
        (EkfFlag.ATTITUDE, 0.49, "pass"), (EkfFlag.ATTITUDE, 0.51, "warn"), (EkfFlag.ATTITUDE, 0.79, "warn"),
        (EkfFlag.ATTITUDE, 0.81, "fail"), (0, 0.1, "fail"),
        (EkfFlag.ATTITUDE | EkfFlag.UNINITIALIZED, 0.1, "fail"),
        (EkfFlag.ATTITUDE | 64, 0.1, "pass"),
    ],
)  # fmt: skip
def test_estimator(flags: int, variance: float, verdict: Verdict) -> None:
    assert items.judge_estimator(None) is None
    item = items.judge_estimator(mav.EkfStatusReport(flags=flags, compass_variance=variance))
    assert item is not None and item.verdict == verdict and with_remedy(item)


@pytest.mark.parametrize(
    ("flags", "ratio", "verdict"),
    [(EkfFlag.ATTITUDE, 0.49, "pass"), (EkfFlag.ATTITUDE, 0.9, "warn"), (EkfFlag.ATTITUDE, 1.1, "fail"),
     (0, 0.1, "fail"), (EkfFlag.ATTITUDE | 1024, 0.1, "pass"),  # 1024: a glitch of the receiver
     (EkfFlag.ATTITUDE, math.nan, "fail")],
)  # fmt: skip
def test_estimator_of_px4(flags: int, ratio: float, verdict: Verdict) -> None:
    item = items.judge_estimator(mav.EstimatorStatus(flags=flags, mag_ratio=ratio))
    assert item is not None and item.verdict == verdict and with_remedy(item)
    assert ("does not use the compass" in item.text) == math.isnan(ratio)


def test_prearm_texts_about_the_compass_are_passed_on_once() -> None:
    texts = [
        "PreArm: Compass not calibrated", "PreArm: Compass not calibrated", "Arm: Check mag field: 900",
        "Preflight Fail: Strong magnetic interference", "PreArm: GPS 1: not healthy", "Compass 1 calibrated",
    ]  # fmt: skip
    found = items.judge_prearm(texts)
    assert [i.text for i in found] == [
        'The autopilot says "PreArm: Compass not calibrated".',
        'The autopilot says "Arm: Check mag field: 900".',
        'The autopilot says "Preflight Fail: Strong magnetic interference".',
    ]
    assert all(i.verdict == "fail" and i.remedy == "Calibrate." for i in found)


@pytest.mark.parametrize(
    ("off_deg", "sigma_deg", "verdict"),
    [
        (2.9, 0.5, "pass"), (3.1, 0.5, "warn"), (-3.1, 0.5, "warn"), (7.9, 0.5, "warn"), (8.1, 0.5, "fail"),
        (5.9, 2.0, "pass"), (6.1, 2.0, "warn"), (11.9, 2.0, "warn"), (12.1, 2.0, "fail"),
        (362.9, 0.5, "pass"),
    ],
)  # fmt: skip
def test_turn(off_deg: float, sigma_deg: float, verdict: Verdict) -> None:
    item = items.judge_turn(1, 90.0 + off_deg, 90.0, sigma_deg)
    assert item.verdict == verdict and with_remedy(item) and item.limit == max(3.0, 3.0 * sigma_deg)
    assert "by the gyro 90.0 deg" in item.text and f"by compass 1 {90.0 + off_deg:.1f} deg" in item.text


@pytest.mark.parametrize(
    ("off_deg", "sigma_deg", "verdict"),
    [(2.9, 0.8, "pass"), (-3.1, 0.8, "warn"), (8.9, 0.8, "warn"), (9.1, 0.8, "fail"),
     (-4.4, 1.5, "pass"), (4.6, 1.5, "warn"), (13.4, 1.5, "warn"), (-13.6, 1.5, "fail")],
)  # fmt: skip
def test_true_north(off_deg: float, sigma_deg: float, verdict: Verdict) -> None:
    seen_rad = math.sqrt(math.radians(sigma_deg) ** 2 - WORLD.declination_sigma_rad**2)
    seen = NorthSeen("gps-course", math.radians(off_deg), 0.0, seen_rad, 600.0)
    (item,) = items.judge_north(2, TrueNorth.of(WORLD, [seen]))
    assert item.verdict == verdict and with_remedy(item) and item.instance == 2
    assert item.value == pytest.approx(off_deg) and item.limit == pytest.approx(max(3.0, 3.0 * sigma_deg))


def test_the_worst_counts_and_what_is_unknown_is_null() -> None:
    assert items.worst([]) == "pass" and items.worst(["pass", "warn"]) == "warn"
    assert items.worst(["fail", "warn", "pass"]) == "fail"
    told = CheckItem("turn", "warn", "t", "r", 0, math.nan, 3.0).to_json()
    assert told == {
        "name": "turn", "compass": None, "verdict": "warn", "text": "t", "remedy": "r",
        "value": None, "limit": 3.0,
    }  # fmt: skip
    assert CheckItem("turn", "warn", "t", "r", 2, 1.5).to_json()["compass"] == 2


def report(*verdicts: Verdict, turned: bool = True, instance: int = 0) -> CheckReport:
    found = tuple(
        CheckItem("dip", v, f"Compass 1 is {v}.", "Calibrate." if v == "fail" else "Wait.", instance)
        for v in verdicts
    )
    return CheckReport(VehicleIdentity(1, 1, "ardupilot", "rover"), found, turned, 7.0)


@pytest.mark.parametrize(
    ("told", "says", "advised"),
    [
        (report("pass", "pass"), "Fit to drive: 2 checks passed.", False),
        (report("pass", turned=False), "Fit to drive: 1 check passed, without a turn.", False),
        (report("pass", "warn"), "Fit to drive, with care: Compass 1 is warn.", False),
        (report(*["warn"] * 3), "Fit to drive, with care: Compass 1 is warn, and 2 more.", False),
        (
            report("warn", "fail", "fail", "fail"),
            "Not fit to drive: Compass 1 is fail. 3 of 4 checks failed.",
            True,
        ),
        (
            report("pass", "fail", instance=2),
            "Not fit to drive: calibrate compass 2. 1 of 2 checks failed.",
            True,
        ),
    ],
)
def test_the_report_says_its_worst(told: CheckReport, says: str, advised: bool) -> None:
    assert told.summary() == says and told.calibration_advised is advised
    document = told.to_json()
    assert (
        document["summary"] == says and document["verdict"] == told.verdict and document["duration_s"] == 7.0
    )
    assert len(document["items"]) == len(told.items) and document["turned"] is told.turned


@pytest.mark.parametrize(("kind", "itself"), [("rover", True), ("copter", True), ("plane", False)])
def test_who_cannot_turn_on_the_spot_is_sent_to_a_hand(
    kind: Kind, itself: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    found = CheckReport(
        VehicleIdentity(1, 1, "ardupilot", kind), report("fail").items, False, 1.0, ("Know.",)
    )
    assert found.turns_itself is itself and found.to_json()["remarks"] == ["Know."]
    _say(found, "udpin:0.0.0.0:14550", Output(None), False)
    said = capsys.readouterr().out
    assert "calibrate udpin:0.0.0.0:14550" in said and "Note: Know." in said
    assert ("--motion hand" in said) is not itself
