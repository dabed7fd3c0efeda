"""The autopilot's own heading: how its error is judged, and when a helping hand helps."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass import messages as mav
from mavcompass.procedure.autopilot_heading import OwnHeading
from mavcompass.procedure.report import AutopilotHeading
from mavcompass.procedure.script import Context, Machine, Show, Tick, nothing


def own(
    samples: list[tuple[float, float]] | None = None,
    kind: str = "rover",
    armed: bool = False,
    variance: float | None = 0.1,
    how: str = "a switch",
    loads_disarmed: bool = False,
    noisy_s: float = 0.0,
) -> OwnHeading:
    """Watch an autopilot whose error was seen at these times, degrees; `how` it takes a heading over."""
    took: list[bool] = []

    def take(context: Any, parameters: Any, flying: bool) -> Any:
        took.append(flying)
        return nothing(how)

    desk: Any = SimpleNamespace(
        context=Context(now=100.0),
        identity=SimpleNamespace(kind=kind, autopilot="ardupilot"),
        state=SimpleNamespace(
            armed=armed,
            speed_mps=0.0,
            ekf=None if variance is None else mav.EkfStatusReport(compass_variance=variance),
        ),
        rest=SimpleNamespace(
            time_s=50.0, for_s=lambda: 9.0, detector=SimpleNamespace(averaging_s=lambda tilt, field: noisy_s)
        ),
        dialect=SimpleNamespace(
            loads_disarmed=loads_disarmed,
            take_compass_yaw=take,
            load_written=lambda context, values: nothing(how),
            prompt_estimator=lambda parameters, flying: {"EK3_GBIAS_P_NSE": 0.03} if flying else {},
        ),
        parameters={},
        took=took,
    )
    held: list[Any] = []
    overrides: Any = SimpleNamespace(
        hold=lambda context, values: nothing(held.append(values) is None),
        release=lambda context, why: nothing(held.append("back")),
        held=held,
    )
    watched = OwnHeading(desk, 2026.5, overrides)
    watched.samples = list(samples or [])
    watched._latest_deg = watched.samples[-1][1] if watched.samples else math.nan
    return watched


def falling(from_deg: float, dps: float, seconds: float = 8.0) -> list[tuple[float, float]]:
    return [(20.0 + t, from_deg + dps * t) for t in np.arange(0.0, seconds + 0.01, 0.4)]


def test_a_slope_is_that_of_the_last_eight_seconds() -> None:
    assert math.isnan(own().slope_dps) and math.isnan(own().worst_deg) and math.isnan(own().error_deg)
    assert own(falling(5.0, -0.25)).slope_dps == pytest.approx(-0.25)
    before = [(float(t), 90.0) for t in range(12)]
    assert own(before + falling(5.0, -0.25)).slope_dps == pytest.approx(-0.25)
    # 3.2 seconds tell it; of noisy sensors, whose samples are longer, more.
    assert math.isnan(own(falling(5.0, -0.25, 2.9)).slope_dps)
    assert own(falling(5.0, -0.25, 3.6)).slope_dps == pytest.approx(-0.25)
    assert math.isnan(own(falling(5.0, -0.25, 6.0), noisy_s=2.4).slope_dps)
    assert own(falling(5.0, -0.25, 6.8), noisy_s=2.4).slope_dps == pytest.approx(-0.25)
    assert own(noisy_s=99.0)._sample_s == 5.0 and own(noisy_s=0.1)._sample_s == 1.2


def test_the_worst_is_what_it_will_come_to() -> None:
    grows = own(falling(1.0, 0.1))
    assert grows.error_deg == pytest.approx(1.8) and grows.worst_deg == pytest.approx(1.8 + 17.0 * 0.1)
    back = own(falling(-3.0, 0.3))
    assert back.worst_deg == pytest.approx(abs(-0.6 + 17.0 * 0.3))  # past zero, to the other side
    assert own(falling(5.0, -0.05)).worst_deg == pytest.approx(4.6)
    # Without a compass nothing stops it for a minute.
    aside = own(falling(1.0, 0.1), variance=0.0)
    assert aside.set_aside and aside.worst_deg == pytest.approx(1.8 + 60.0 * 0.1)
    assert not own(variance=None).set_aside and not own(variance=1e-9).set_aside


@pytest.mark.parametrize(
    ("samples", "given", "helps"),
    [
        (falling(5.0, -0.2), {}, True),  # it falls by more than a hundredth of itself a second
        (falling(5.0, -0.055), {}, True),
        (falling(5.0, -0.04), {}, False),  # the bias is yet to go
        (falling(-5.0, 0.2), {}, True),
        (falling(5.0, 0.2), {}, False),
        (falling(1.6, -0.1), {}, False),  # 0.8 degrees are not worth it
        (falling(5.0, -0.2), {"kind": "copter", "armed": True}, False),
        (falling(5.0, -0.2), {"kind": "copter"}, True),
        (falling(5.0, 0.2), {"loads_disarmed": True}, True),  # what has slid off does not come back
        (falling(5.0, 0.2, 1.0), {"loads_disarmed": True}, False),
    ],
)
def test_taking_the_yaw_over_helps_once_the_bias_is_unlearned(
    samples: list[tuple[float, float]], given: dict[str, Any], helps: bool
) -> None:
    watched = own(samples, **given)
    assert bool(watched._may_help()) is helps
    watched._has_a_way = False
    assert not watched._may_help()


def run(script: Any, watched: OwnHeading) -> Any:
    machine = Machine(lambda context: script)
    machine.context = watched.desk.context
    for tick in range(20):  # two seconds are no waiting
        machine.step(Tick(100.0 + 0.1 * tick))
    assert machine.done, "it waits"
    if machine.error:
        raise machine.error
    return machine.result


def shown(watched: OwnHeading) -> list[str]:
    return [a.text for a in watched.desk.context.outbox if isinstance(a, Show)]


def test_what_took_it_over_is_noted_and_the_samples_begin_anew() -> None:
    watched = own(falling(5.0, -0.2))
    assert run(watched._put_right(-7.25), watched) is True
    assert watched.by == ["a switch"] and not watched.samples and watched.desk.took == [False]  # type: ignore[attr-defined]
    assert watched._not_before_s == pytest.approx(50.0 + 0.8 + 1.2)
    none = own(falling(5.0, -0.2), how="")
    assert run(none._put_right(5.0), none) is False and none.by == [] and none.samples and not none._has_a_way
    assert shown(none) == []


@pytest.mark.parametrize(("before", "has_a_way"), [(2, True), (4, False)])
def test_what_so_many_loads_have_not_brought_right_another_will_not(before: int, has_a_way: bool) -> None:
    watched = own(loads_disarmed=True, how="a load")
    watched._values, watched.by = {"CAL_MAG0_XOFF": 0.1}, ["a load"] * before
    assert run(watched._take_over(), watched) == "a load" and watched._has_a_way is has_a_way
    flying = own(loads_disarmed=True, armed=True)
    flying._values = {"CAL_MAG0_XOFF": 0.1}
    assert run(flying._take_over(), flying) == "" and not flying._has_a_way


def test_before_a_turn_it_takes_the_yaw_over_if_it_knows_a_way() -> None:
    watched = own()
    run(watched.keep_up(), watched)
    assert watched.desk.took == [False] and watched.by == []  # type: ignore[attr-defined]
    watched._has_a_way = False
    run(watched.keep_up(), watched)
    assert watched.desk.took == [False]  # type: ignore[attr-defined]
    gliding = own()
    gliding.desk.state.speed_mps = 0.11  # type: ignore[misc]
    run(gliding.keep_up(), gliding)
    assert gliding.desk.took == []  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("rest_s", "not_before_s", "flying", "looks"),
    [(1.3, -math.inf, False, True), (1.1, -math.inf, False, False), (1.1, -math.inf, True, True),
     (9.0, 50.0, False, True), (9.0, 50.1, False, False)],
)  # fmt: skip
def test_it_is_looked_at_where_the_vehicle_has_rested(
    rest_s: float, not_before_s: float, flying: bool, looks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = own(kind="copter" if flying else "rover", armed=flying)
    watched.desk.rest.for_s = lambda: rest_s  # type: ignore[method-assign]
    watched._not_before_s = not_before_s
    seen: list[tuple[float, float]] = []
    monkeypatch.setattr(OwnHeading, "_sample", lambda self, a, b: seen.append((a, b)))
    watched._look()
    assert seen == ([(pytest.approx(48.8), 50.0)] if looks else [])


@pytest.mark.parametrize(
    ("way", "kind", "armed", "patience_s"),
    [(True, "rover", True, 120.0), (False, "rover", True, 45.0), (True, "copter", True, 45.0),
     (True, "copter", False, 120.0)],
)  # fmt: skip
def test_it_is_waited_for_longer_where_it_can_be_helped(
    way: bool, kind: str, armed: bool, patience_s: float
) -> None:
    watched = own(kind=kind, armed=armed)
    watched._has_a_way = way
    assert watched._patience_s() == patience_s


def test_the_outcome_names_each_way_once() -> None:
    watched = own(falling(5.0, -0.2))
    watched.before_deg, watched._written_s, watched.by = 9.0, 60.0, ["a switch", "a load", "a switch"]
    told = watched.outcome()
    assert (told.error_before_deg, told.seconds, told.by) == (9.0, 40.0, "a switch, a load")
    assert told.error_after_deg == pytest.approx(3.4)
    watched.by = []
    assert watched.outcome().by == "its own filter"
    watched.restarted()
    assert watched.by == ["a restart"] and not watched.samples and math.isnan(watched.error_deg)


def test_what_goes_to_and_fro_is_watched_for_longer_and_told() -> None:
    def wandering(size_deg: float, seconds: float = 25.0) -> list[tuple[float, float]]:
        return [(20.0 + t, size_deg * math.sin(t / 2.0)) for t in np.arange(0.0, seconds, 1.0)]

    watched = own(wandering(2.0), loads_disarmed=True)
    assert watched.wander_deg == pytest.approx(math.sqrt(2.0), rel=0.05)
    assert watched.worst_deg == pytest.approx(abs(watched.error_deg) + 2.0 * watched.wander_deg)
    assert "may wander by 1.4 deg" in watched.outcome().summary() and watched.outcome().is_off
    calm = own(wandering(0.3), loads_disarmed=True)
    assert calm.worst_deg < 1.0 and not calm.outcome().is_off
    # It is not known in less than 14 s, and nothing is promised before that.
    short = own(wandering(0.3, 14.0), loads_disarmed=True)
    assert math.isnan(short.wander_deg) and math.isnan(short.worst_deg)
    assert own(wandering(2.0)).wander_deg == 0.0


def heading(before: float = -8.0, after: float = 1.0, worst: float = 1.5, **more: float) -> AutopilotHeading:
    return AutopilotHeading(before, after, "a switch", 30.0, worst, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("told", "off", "says"),
    [
        (heading(), False, "own heading: 8.0 deg off before, 1.0 deg now (a switch)."),
        (heading(worst=2.0), False, "1.0 deg now"),
        (heading(after=2.0, worst=5.0, wander_deg=1.5), True, "2.0 deg off now, but may wander by 1.5 deg"),
        (heading(after=-2.0, worst=5.0), True, "is still 2.0 deg off. Reboot it before driving."),
        (
            heading(after=-2.0, worst=5.0, flying=True, flies=True),
            True,
            "2.0 deg off. Land, disarm and reboot before flying again.",
        ),
        (heading(after=-2.0, worst=5.0, flies=True), True, "2.0 deg off. Reboot it before flying."),
        (
            heading(after=24.0, written=False),
            True,
            "24.0 deg off. Compare it with a landmark before driving.",
        ),
        (heading(after=0.4, written=False), False, "The autopilot's own heading is 0.4 deg off."),
        (heading(after=-1.9, worst=2.1), True, "is still 1.9 deg off. Reboot"),
        (heading(after=-1.9, worst=math.nan), False, "1.9 deg now"),
        (heading(after=-2.1, worst=math.nan), True, "is still 2.1 deg off."),
        (
            heading(after=3.0, worst=9.0, set_aside=True),
            True,
            "3.0 deg off and has set its compasses aside. Reboot",
        ),
        (heading(worst=4.0, wander_deg=1.5), True, "1.0 deg off now, but may wander by 1.5 deg while"),
        (heading(worst=math.nan, wander_deg=math.nan), True, "1.0 deg off now, but does not stay there"),
        (heading(after=math.nan, worst=math.nan, wander_deg=math.nan), False, "could not be measured"),
        (heading(after=2.5, worst=5.5, wander_deg=1.5), True, "is still 2.5 deg off"),
        (heading(after=math.nan, worst=math.nan), False, "could not be measured"),
        (heading(after=17.0, not_loaded=True), True, "by the old calibration, 17.0 deg off"),
    ],
)
def test_what_a_person_is_told_of_it(told: AutopilotHeading, off: bool, says: str) -> None:
    assert told.is_off is off and says in told.summary()
    assert told.known is math.isfinite(told.error_after_deg)


def test_the_wait_is_counted_from_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    """It began at 100 s of the link's clock: two minutes are over at 220."""
    watched = own(falling(5.0, 0.02))
    watched.before_deg, watched._has_a_way = 5.0, True
    monkeypatch.setattr(OwnHeading, "_look", lambda self: None)
    machine = Machine(lambda context: watched.settle())
    machine.context = watched.desk.context
    texts: list[tuple[float, float]] = []
    for second in range(200):
        for action in machine.step(Tick(100.0 + second)):
            if isinstance(action, Show):
                texts.append((machine.context.now, dict(action.data)["live"]))
        if machine.done:
            break
    assert machine.context.now == 220.0 and machine.error is None
    # It is told once it can be told, and from then on the same line is written anew.
    assert texts[0] == (105.0, 0.0) and {live for _, live in texts[1:]} == {1.0} and len(texts) == 115


@pytest.mark.parametrize(
    ("worst_deg", "aside", "waits"), [(1.8, False, False), (1.81, False, True), (9.0, True, False)]
)
def test_what_stays_right_or_is_set_aside_is_not_waited_for(
    worst_deg: float, aside: bool, waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = own(falling(1.0, 0.0), variance=0.0 if aside else 0.1)
    watched.before_deg = 5.0
    monkeypatch.setattr(OwnHeading, "worst_deg", worst_deg)
    monkeypatch.setattr(OwnHeading, "_look", lambda self: None)
    machine = Machine(lambda context: watched.settle())
    machine.context = watched.desk.context
    machine.step(Tick(100.0))
    assert machine.done is not waits


def watching(
    monkeypatch: pytest.MonkeyPatch, errors_deg: list[float], **more: Any
) -> tuple[OwnHeading, list[tuple[float, float]]]:
    """Watch an autopilot that is off by these, stretch by stretch; return the stretches, too."""
    stretches: list[tuple[float, float]] = []

    def sample(self: OwnHeading, start_s: float, end_s: float) -> None:
        stretches.append((start_s, end_s))
        self._latest_deg = errors_deg[min(len(stretches), len(errors_deg)) - 1]
        self.samples.append((end_s, self._latest_deg))

    monkeypatch.setattr(OwnHeading, "_sample", sample)
    watched = own(**more)
    watched.found(
        [SimpleNamespace(heading_sigma_deg=0.1, instance=1, accepted=False)], [(3.0, 4.5), (30.0, 31.5)]
    )  # type: ignore[list-item]
    return watched, stretches


@pytest.mark.parametrize(("error_deg", "helped"), [(0.75, False), (0.76, True), (-0.76, True)])
def test_what_a_perfect_compass_leaves_is_left_to_the_filter(
    error_deg: float, helped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched, stretches = watching(monkeypatch, [63.0, error_deg])
    # What is told as before is that of the start, not what the turning has left of it.
    assert stretches == [(3.0, 4.5), (30.0, 31.5)] and watched.before_deg == 63.0
    run(watched.written({"A": 1.0}), watched)
    assert (watched.samples, watched._written_s) == ([], 100.0)
    assert bool(watched.by) is helped and not watched.not_loaded


@pytest.mark.parametrize(
    ("kind", "armed", "error_deg", "holds"),
    [("copter", True, 5.0, True), ("copter", True, 0.7, False), ("copter", False, 5.0, False),
     ("rover", True, 5.0, False)],
)  # fmt: skip
def test_a_flying_estimator_believes_its_compass_from_the_write_until_it_follows(
    kind: str, armed: bool, error_deg: float, holds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched, _ = watching(monkeypatch, [40.0, error_deg, 0.1], kind=kind, armed=armed)
    run(watched.expect(), watched)
    assert watched.overrides.held == ([{"EK3_GBIAS_P_NSE": 0.03}] if holds else [])  # type: ignore[attr-defined]
    if not holds:
        return
    machine = Machine(lambda context: watched.written({"A": 1.0}))
    machine.context, watched.desk.rest.time_s = watched.desk.context, 60.0
    for tick in range(40):
        machine.step(Tick(100.0 + 0.5 * tick))
        watched.desk.rest.time_s = 60.0 + 0.5 * tick
        if machine.done:
            break
    assert machine.done and 106.5 <= machine.context.now <= 109.5
    assert watched.overrides.held[-1] == "back" and watched.by == ["believing its compass for some seconds"]  # type: ignore[attr-defined]
