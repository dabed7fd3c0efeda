"""Which source of yaw may be switched off."""

from __future__ import annotations

import pytest

from mavcompass.vehicle.dialects.taking_over import idle_set

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
