"""Who calibrates by `import mavcompass` gets the linear algebra of one thread, and the threads back."""

from __future__ import annotations

from unittest.mock import Mock

import pytest
from calibration_worlds import iron_of, turning_track

from mavcompass import blas
from mavcompass.calibration import calibrate_track
from mavcompass.correction import FieldCorrection


def test_matrix_products_of_a_calibration_have_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    setter = Mock()
    monkeypatch.setattr(blas, "_libraries", lambda: ((setter, lambda: 7),))
    calibrate_track(turning_track(iron_of(FieldCorrection((60.0, -40.0, 25.0)))), "four-positions")
    counts = [call.args[0] for call in setter.call_args_list]
    assert counts[0] == 1 and counts[-1] == 7
