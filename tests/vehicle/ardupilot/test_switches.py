"""What of a vehicle's own switches speaks against a write, and which source of yaw may be switched off."""

from __future__ import annotations

import pytest

from mavcompass.vehicle.ardupilot.plan import _motor_clash
from mavcompass.vehicle.ardupilot.yaw import idle_set


def test_motor_terms_of_another_compass_keep_their_meaning() -> None:
    terms = {"COMPASS_MOT2_Y": 3.0}
    throttle, current = {"COMPASS_MOTCT": 1.0, **terms}, {"COMPASS_MOTCT": 2.0, **terms}
    assert _motor_clash(throttle, current, (1,))[0].startswith(
        "COMPASS_MOTCT is shared: changing it gives compass 2's"
    )
    assert _motor_clash(throttle, current, (1, 2)) == _motor_clash(throttle, throttle, (1,)) == []
    assert _motor_clash({"COMPASS_MOTCT": 1.0}, {"COMPASS_MOTCT": 2.0}, (1,)) == []
    assert len(_motor_clash(throttle, current | {"COMPASS_MOT3_X": 1.0}, (1,))) == 2


COMPASS, NONE, OTHER = 1.0, 0.0, 8.0


@pytest.mark.parametrize(
    ("parameters", "idle"),
    [
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "EK3_SRC3_YAW": NONE}, 2),
        ({"EK3_SRC1_YAW": 3.0, "EK3_SRC2_YAW": NONE}, 2),  # the compass where GPS has none
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": COMPASS, "EK3_SRC3_YAW": NONE}, 3),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": OTHER}, None),
        ({"EK3_SRC1_YAW": COMPASS}, None),
        ({"EK3_SRC1_YAW": OTHER, "EK3_SRC2_YAW": NONE}, None),
        ({"EK3_SRC2_YAW": NONE}, None),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "AHRS_EKF_TYPE": 3.0}, 2),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "AHRS_EKF_TYPE": 2.0}, None),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "EK3_SRC2_POSXY": 0.0}, 2),
        # A second set in earnest may be the one in use.
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "EK3_SRC2_POSXY": 6.0}, None),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "EK3_SRC3_YAW": OTHER, "EK3_SRC3_POSXY": 3.0}, None),
        ({"EK3_SRC1_YAW": COMPASS, "EK3_SRC2_YAW": NONE, "EK3_SRC3_POSXY": 3.0}, 2),
    ],
)
def test_a_set_of_sources_without_a_yaw(parameters: dict[str, float], idle: int | None) -> None:
    assert idle_set(parameters) == idle
