"""What no sensor can have said is left out."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.logs.common import finite_series


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 1e30, -1e8])
def test_a_sample_that_is_no_measurement_costs_only_itself(odd: float) -> None:
    time_s = np.array([2.0, 1.0, 3.0])
    series = finite_series(time_s, np.array([[5.0, 6.0], [3.0, 4.0], [1.0, odd]]))
    assert series is not None
    np.testing.assert_array_equal(series.time_s, [1.0, 2.0])
    np.testing.assert_array_equal(series.values, [[3.0, 4.0], [5.0, 6.0]])
    assert finite_series(time_s, np.full(3, odd)) is None
