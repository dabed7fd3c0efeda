"""The heading scatter that a correction leaves, second by second, and sections as a table of rows."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.attitude import levels
from mavcompass.calibration.model import HEADINGS, HORIZONTAL, LAG, VERTICAL
from mavcompass.calibration.motion import changes, observed
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.scatter import scatter_left_rad
from mavcompass.calibration.motion.sections import Sections, unsettled
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, level_to_body
from mavcompass.track import InForce, MagSeries, Series, Track

DEG = math.radians(1.0)
TIME = np.arange(400.0) * 0.1
K = 8


def sections_of(**changed: Any) -> Sections:
    """Make eight sections of five seconds, 45 degrees apart, by a compass without noise."""
    rows: dict[str, Any] = {
        "start_s": 5.0 * np.arange(K),
        "end_s": 5.0 * np.arange(K) + 5.0,
        "mean_mgauss": np.zeros((K, 3)),
        "samples": np.full(K, 50.0),
        "noise_mgauss": 1e-6,
        "hidden_mgauss": np.zeros((K, 3)),
        "mapping": np.tile(np.eye(3), (K, 1, 1)),
        "by_lag": np.zeros((K, 3, 3)),
        "tilt_sigma_rad": np.zeros(K),
        "tilt_bias_rad": 0.0,
        "turned_rad": 45.0 * DEG * np.arange(K),
        "step_sigma_rad": np.full(K - 1, 0.001),
        "bias_sigma_radps": 0.0,
        "scale_sigma": 0.0,
        "load": np.zeros(K),
        "load_mean": 0.0,
        "repeats": np.ones(K),
        "gyro_rate_hz": 50.0,
        **changed,
    }
    return Sections(**rows)


ANGLE = 45.0 * DEG * np.floor(TIME / 5.0)


def left_deg(
    off_deg: FloatArray, sections: Sections | None = None, sound: FloatArray | None = None,
    rate_deg_s: float = 0.0, tilt_deg_s: float = 0.0, lag_s: float = 0.0, lean_deg: float = 0.0,
    vertical: float = 0.0,
) -> float:  # fmt: skip
    """Give headings that are off by so much, (400,); return the scatter that is found."""
    psi = ANGLE + 0.3 + off_deg * DEG
    field = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(400, vertical)], axis=1)
    compass = MagSeries(1, Series.of(TIME, field))
    zero = np.zeros(400)
    record = TurnRecord(
        TIME - lag_s, ANGLE, zero + rate_deg_s * DEG, zero + tilt_deg_s * DEG, 0.0, 0.0, 0.0, 0.0, 0.1
    )
    state = np.zeros(HEADINGS + K)
    state[HORIZONTAL], state[VERTICAL], state[LAG] = 200.0, vertical, lag_s
    state[HEADINGS:] = 0.3 + 45.0 * DEG * np.arange(K)
    fit: Any = SimpleNamespace(
        state=state, sound=np.ones(K) if sound is None else sound, headings_rad=state[HEADINGS:]
    )
    down = np.tile([math.sin(lean_deg * DEG), 0.0, math.cos(lean_deg * DEG)], (400, 1))
    found = scatter_left_rad(
        Track(compasses={1: compass}), 1, field, down, record, sections or sections_of(), fit
    )
    return math.degrees(found)


SWING = np.where(np.floor(TIME) % 2 == 0, 2.0, -2.0)  # second by second
FLAT = np.zeros(400)


def test_what_follows_the_gyro_scatters_by_nothing() -> None:
    assert left_deg(FLAT) == pytest.approx(0.0, abs=1e-3)
    assert left_deg(FLAT + 7.0) == pytest.approx(0.0, abs=1e-3)  # one offset of all is no scatter


def test_the_scatter_is_the_rms_of_seconds() -> None:
    assert left_deg(SWING) == pytest.approx(2.0, rel=0.02)
    assert left_deg(0.5 * SWING) == pytest.approx(1.0, rel=0.02)
    within = np.where(np.arange(400) % 2 == 0, 2.0, -2.0)  # reading by reading it averages out
    assert left_deg(within) < 0.05


@pytest.mark.parametrize(
    ("given", "counts"),
    [
        ({"rate_deg_s": 4.9}, True), ({"rate_deg_s": -5.1}, False), ({"tilt_deg_s": 4.9}, True),
        ({"tilt_deg_s": 5.1}, False), ({"rate_deg_s": 4.0, "tilt_deg_s": 4.0}, False), ({"lag_s": 0.3}, True),
    ],
)  # fmt: skip
def test_what_turns_or_tilts_fast_does_not_count(given: dict[str, float], counts: bool) -> None:
    assert (left_deg(SWING, **given) > 1.5) is counts  # type: ignore[arg-type]


@pytest.mark.parametrize(("lean_deg", "counts"), [(44.0, True), (46.0, False)])
def test_leaning_by_half_a_right_angle_a_nose_has_hardly_a_heading(lean_deg: float, counts: bool) -> None:
    assert (left_deg(SWING, lean_deg=lean_deg) > 0.5) is counts


def test_disturbed_sections_do_not_count() -> None:
    only = np.where((TIME >= 10.0) & (TIME < 15.0), SWING, 0.0)
    sound = np.ones(K)
    assert left_deg(only) > 0.5
    sound[2] = 0.0
    assert left_deg(only, sound=sound) == pytest.approx(0.0, abs=0.01)


def test_noise_and_tilt_explain_what_they_can() -> None:
    # 200 mG, ten fresh readings a second: 7 mG make 0.63 degrees; four sigmas of chance beside it.
    assert left_deg(0.2 * SWING, sections_of(noise_mgauss=7.0)) == 0.0
    assert left_deg(SWING, sections_of(noise_mgauss=7.0)) == pytest.approx(
        math.sqrt(4.0 - 0.63**2 * 1.9), rel=0.1
    )
    leaning = sections_of(tilt_sigma_rad=np.full(K, 1.0 * DEG))
    assert left_deg(0.2 * SWING, leaning, vertical=100.0) == 0.0  # a degree at a dip of a half
    assert left_deg(SWING, leaning, vertical=100.0) > 1.8


def test_seconds_whose_tilt_is_not_known_do_not_excuse_the_others() -> None:
    for unknown_deg, left in ((1.6, 2.0), (1.4, 0.0)):
        tilt = np.where(np.arange(K) < 6, unknown_deg, 0.0) * DEG
        assert left_deg(SWING, sections_of(tilt_sigma_rad=tilt), vertical=-600.0) == pytest.approx(
            left, abs=0.1
        )
    assert left_deg(SWING, sections_of(tilt_sigma_rad=np.full(K, 1.6 * DEG)), vertical=-600.0) == 0.0


def test_sections_that_were_left_out_do_not_count() -> None:
    only = np.where((TIME >= 10.05) & (TIME < 14.95), SWING, 0.0)
    assert left_deg(only) > 0.5
    rest = sections_of(end_s=np.where(np.arange(K) == 2, 10.0, 5.0 * np.arange(K) + 5.0))
    assert left_deg(only, rest) < 0.1


def test_five_seconds_are_the_fewest() -> None:
    for last_s, counts in ((34.95, True), (33.95, False)):
        whole = sections_of()
        ends = np.where(np.arange(K) == K - 1, last_s, whole.end_s)
        late = replace(whole, start_s=np.maximum(whole.start_s, 30.0), end_s=ends)
        assert (left_deg(SWING, late) > 0.5) is counts


def test_readings_around_a_change_of_the_parameters_are_unsettled() -> None:
    steps = tuple(InForce(t, FieldCorrection()) for t in (-math.inf, 10.0, 20.0))
    track = Track(compasses={1: MagSeries(1, Series.of(TIME, np.zeros((400, 3))), steps)})
    found = TIME[unsettled(track, 1)]
    assert found.min() == pytest.approx(8.1) and found.max() == pytest.approx(21.9) and found.size == 2 * 39
    plain = Track(compasses={1: MagSeries(1, Series.of(TIME, np.zeros((400, 3))))})
    assert not unsettled(plain, 1).any()


def test_sections_are_cut_by_rows_and_by_time() -> None:
    sections = sections_of(step_sigma_rad=np.arange(7.0))
    part = sections.rows(2, 5)
    assert (
        len(part) == 3
        and part.start_s.tolist() == [10.0, 15.0, 20.0]
        and part.step_sigma_rad.tolist() == [2.0, 3.0]
    )
    assert len(sections.rows(3, 3)) == 0 and sections.rows(3, 4).step_sigma_rad.size == 0
    assert sections.between(12.4, 22.6).start_s.tolist() == [10.0, 15.0, 20.0]
    assert sections.between(12.6, 22.4).start_s.tolist() == [15.0]
    assert sections.middle_s.tolist() == [2.5 + 5.0 * k for k in range(8)]


def test_the_field_turns_against_the_vehicle() -> None:
    mapping = level_to_body(0.0, 0.0, np.array([0.0, 0.3, -0.5]))
    north = np.array([1.0, 0.0, 2.0])
    for k, turned in enumerate((0.0, 0.3, -0.5)):
        assert mapping[k] @ north == pytest.approx([math.cos(turned), -math.sin(turned), 2.0])
        assert mapping[k] @ [0.0, 1.0, 0.0] == pytest.approx([math.sin(turned), math.cos(turned), 0.0])


class Fitted(SimpleNamespace):
    """Hold what is set of a fit; the horizontal field follows from it as in any."""

    horizontal_mgauss = MotionFit.horizontal_mgauss


@pytest.mark.parametrize(("model_deg", "looks"), [(0.49, False), (0.51, True)])
def test_an_error_of_half_a_degree_is_looked_into(
    model_deg: float, looks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(changes, "_candidates", lambda motion: asked.append(motion) or [])  # type: ignore[func-returns-value]
    state = np.zeros(HEADINGS + K)
    state[HORIZONTAL] = 200.0
    fit = Fitted(state=state, gain=np.eye(3) * 1.1, model_mgauss=model_deg * DEG * 220.0, sound=np.ones(K))
    motion: Any = SimpleNamespace(fit=fit, sections=sections_of())
    assert changes.last_stretch(motion) == (motion, None) and bool(asked) is looks


@pytest.mark.parametrize(("kept_out", "cuts"), [(0, False), (1, False), (K - 2, True)])
def test_a_beginning_that_was_all_kept_out_is_a_change(
    kept_out: int, cuts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one section only something may have passed by; what lasts longer than ten seconds was iron."""
    state = np.zeros(HEADINGS + K)
    state[HORIZONTAL] = 200.0
    sections = sections_of()
    lasted_s = float(sections.end_s[max(kept_out, 1) - 1] - sections.start_s[0])
    assert (lasted_s >= 10.0) is cuts
    later = SimpleNamespace(fit=SimpleNamespace(headings_rad=np.linspace(0.0, 300.0, 40) * DEG))
    fit = Fitted(state=state, gain=np.eye(3), model_mgauss=0.0, sound=np.arange(K) >= kept_out)
    motion: Any = SimpleNamespace(fit=fit, sections=sections, since=lambda start_s: later, recorded="whole")
    monkeypatch.setattr(changes, "residual_of", lambda rows, fit: np.tile([0.0, 30.0, 40.0], (len(rows), 1)))
    monkeypatch.setattr(changes, "since", lambda recorded, start_s: (recorded, start_s))
    monkeypatch.setattr(changes, "replace", lambda later, recorded: (later, recorded))
    monkeypatch.setattr(changes, "_dated", lambda motion, later, moved: lasted_s)
    found, change = changes.last_stretch(motion)
    if cuts:
        settled = float(sections.end_s[kept_out - 1]) + 1.0
        assert found == (later, ("whole", settled)) and change is not None and change.is_iron
    else:
        assert found is motion and change is None


@pytest.mark.parametrize(
    ("share", "seen_deg", "taken"), [(0.39, 160.0, True), (0.41, 160.0, False), (0.39, 149.0, False)]
)
def test_a_stretch_is_taken_where_it_fits_much_better_and_turns_enough(
    share: float, seen_deg: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = np.zeros(HEADINGS + K)
    state[HORIZONTAL] = 200.0
    later = SimpleNamespace(
        fit=SimpleNamespace(model_mgauss=10.0 * share, headings_rad=np.linspace(0.0, seen_deg, 40) * DEG)
    )
    motion: Any = SimpleNamespace(
        fit=Fitted(state=state, gain=np.eye(3), model_mgauss=10.0, sound=np.ones(K)),
        sections=sections_of(),
        since=lambda start_s: later,
        recorded="whole",
    )
    monkeypatch.setattr(changes, "_candidates", lambda motion: [12.0])
    monkeypatch.setattr(
        changes, "residual_of", lambda sections, fit: np.tile([0.0, 3.0, 4.0], (len(sections), 1))
    )
    monkeypatch.setattr(changes, "_dated", lambda motion, later, moved: 11.0)
    monkeypatch.setattr(changes, "since", lambda recorded, start_s: (recorded, start_s))
    monkeypatch.setattr(changes, "replace", lambda later, recorded: (later, recorded))
    found, change = changes.last_stretch(motion)
    if taken:
        assert found == (later, ("whole", 12.0)) and change == changes.Change(11.0, 5.0)
    else:
        assert found is motion and change is None


@pytest.mark.parametrize("seldom", [False, True])
@pytest.mark.parametrize("reference", [False, True])
def test_what_is_heard_too_seldom_tells_no_scatter(
    reference: bool, seldom: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observed, "scatter_left_rad", lambda *given: 0.03)
    track = Track(compasses={1: MagSeries(1, Series.of(TIME, np.zeros((400, 3))))})
    sections = sections_of(step_sigma_rad=np.full(K - 1, 6.0 * DEG if seldom else 0.01))
    turn: Any = SimpleNamespace(levels=levels)
    recorded: Any = SimpleNamespace(track=track, instance=1)
    fit: Any = None
    motion = observed.Motion(recorded, fit, turn if reference else None, sections, fit, "none")
    assert motion.scatter_left_rad(FieldCorrection()) == (0.0 if seldom else 0.03)


def test_motors_that_a_correction_takes_out_leave_no_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    left: list[FloatArray] = []
    monkeypatch.setattr(
        observed, "motors_left_rad", lambda sections, fit, mgauss: left.append(mgauss) or 0.04
    )
    state = np.zeros(HEADINGS + K)
    state[13:16] = (1.0, 2.0, 3.0)
    nothing: Any = None
    fit: Any = SimpleNamespace(state=state)
    motion = observed.Motion(nothing, nothing, None, sections_of(), fit, "current")
    cure = FieldCorrection(diagonals=(2.0, 1.0, 1.0), motor_mgauss=(-2.0, -2.0, -3.0), motor_source="current")
    assert motion._motors_left_rad(cure) == 0.04 and left[-1] == pytest.approx([0.0, 0.0, 0.0])
    motion._motors_left_rad(replace(cure, motor_source="throttle"))
    assert left[-1].tolist() == [1.0, 2.0, 3.0]  # another load's term takes nothing out
    assert replace(motion, load_source="none")._motors_left_rad(cure) == 0.0
