"""A new method is one new file: nothing else names it."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest
from calibration_worlds import Iron, turning_track

from mavcompass.calibration import calibrate_track, methods
from mavcompass.errors import UsageError

MIDDLE_OF_THE_TURN = '''
    """The middle of all readings is the hard iron."""

    from mavcompass.calibration.recorded import Recorded
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.correction import FieldCorrection


    def calibrate(recorded: Recorded) -> CalibrationResult:
        raw = recorded.track.raw_field(recorded.instance)
        middle = 0.5 * (raw.min(axis=0) + raw.max(axis=0))
        return CalibrationResult(
            instance=recorded.instance,
            method="middle-of-the-turn",
            accepted=False,
            reasons=("It knows nothing of its error.",),
            correction=FieldCorrection(offsets_mgauss=tuple((-middle).tolist())),
            in_force=recorded.in_force,
        )
'''


def test_a_file_in_the_folder_is_a_method(add_file: Callable[[ModuleType, str, str], None]) -> None:
    track = turning_track(Iron(offset=(120.0, -45.0, 0.0)), turns_deg=(360.0,), noise=0.0)
    with pytest.raises(UsageError, match="no method 'middle-of-the-turn'"):
        calibrate_track(track, "middle-of-the-turn")
    add_file(methods, "middle_of_the_turn", MIDDLE_OF_THE_TURN)
    assert "middle-of-the-turn" in methods.method_names()
    result = calibrate_track(track, "middle-of-the-turn")
    assert result.raw_offset_mgauss[:2] == pytest.approx([120.0, -45.0], abs=1.0)
    assert result.parameters["COMPASS_OFS_X"] == pytest.approx(-120.0, abs=1.0)


def test_what_methods_share_is_no_method() -> None:
    assert not any("level" in name for name in methods.method_names())
