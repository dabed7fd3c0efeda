"""From parameters seen to corrections in force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.logs.common.parameter_steps import Seen, ardupilot_steps, changes
from mavcompass.logs.common.samples import motor_outputs


def test_values_that_are_no_numbers_are_passed_over() -> None:
    assert changes([Seen(1.0, "A", math.nan), Seen(2.0, "A", math.inf)], [0.0]) == ()


def test_changes_that_do_not_touch_this_compass_make_no_step() -> None:
    seen = [Seen(0.0, f"COMPASS_OFS_{axis}", 5.0) for axis in "XYZ"]
    seen += [Seen(1.0, "COMPASS_OFS2_X", 9.0, True), Seen(2.0, "SERVO1_TRIM", 1.0, True)]
    seen += [Seen(3.0, "COMPASS_OFS2_X", 8.0, True)]
    steps, known = ardupilot_steps(changes(seen, [0.0]), 1)
    assert known and len(steps) == 1
    steps, known = ardupilot_steps(changes(seen, [0.0]), 2)
    assert not known and [step.from_s for step in steps] == [-math.inf, 3.0]


def test_the_newer_naming_is_understood() -> None:
    seen = [
        Seen(0.0, f"COMPASS1_OFS_{axis}", value) for axis, value in zip("XYZ", (1.0, 2.0, 3.0), strict=True)
    ]
    (step,), known = ardupilot_steps(changes(seen, [0.0]), 1)
    assert known and step.correction.offsets_mgauss == (1.0, 2.0, 3.0)


def test_outputs_become_fractions_of_their_own_range() -> None:
    parameters = {"SERVO1_FUNCTION": 73.0, "SERVO1_MIN": 1100.0, "SERVO1_MAX": 1900.0}
    parameters |= {"SERVO3_FUNCTION": 74.0, "SERVO3_REVERSED": 1.0}
    pulses = np.array([[1100, 1500, 1250], [1900, 1500, 2000], [2000, 1500, 0]])
    found = motor_outputs(pulses, parameters)
    np.testing.assert_allclose(found, [[0.0, 0.75], [1.0, 0.0], [1.0, 0.0]])
    assert motor_outputs(pulses, {"SERVO1_FUNCTION": 26.0}) is None


def test_without_functions_every_output_in_use_counts() -> None:
    found = motor_outputs(np.array([[1500, 0, 1000], [1500, 0, 2000]]), {})
    assert found == pytest.approx(np.array([[0.5, 0.0], [0.5, 1.0]]))
