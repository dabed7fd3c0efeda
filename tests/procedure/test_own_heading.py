"""What a person is told of the autopilot's own heading."""

from __future__ import annotations

import math

import pytest

from mavcompass.procedure.report import AutopilotHeading


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
