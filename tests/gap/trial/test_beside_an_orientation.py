"""The attitude of a vehicle whose autopilot steers by a compass that is mounted in another orientation."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.vehicles import make_case


@pytest.mark.parametrize("seed", [1208850555, 1042849402])
def test_gyro_stays_what_it_is_where_a_turned_compass_leans_the_autopilot(seed: int) -> None:
    case = make_case(seed, "single")
    assert [effect for effect, _ in case.effects] == ["orientation"] and case.baseline is not None
    flight, before = (replay(track).reference.errors["gyro offset"] for track in (case.track, case.baseline))
    np.testing.assert_allclose(flight.mean, before.mean, atol=0.006)
