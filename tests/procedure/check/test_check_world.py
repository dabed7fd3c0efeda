"""The world that a check compares with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mavcompass import messages as mav
from mavcompass.earth_field import earth_field
from mavcompass.procedure.check import CheckSettings
from mavcompass.procedure.check.preflight import _Checker
from mavcompass.procedure.vehicle_state import VehicleState


def test_the_world_is_that_of_the_place_and_the_date_where_they_are_known() -> None:
    desk: Any = SimpleNamespace(state=VehicleState(), parameters={}, identity=None, gyro=None, rest=None)
    check = _Checker(desk, CheckSettings())
    assert check.world() is None
    check.desk.state.place = mav.GlobalPositionInt()
    assert check.world() is None  # nobody is in the Gulf of Guinea without knowing it
    check.desk.state.place = None
    for fix_type, lat, told in ((2, 474_000_000, False), (3, 474_000_000, True), (3, 974_000_000, False)):
        check.desk.state.gps = mav.GpsRawInt(fix_type=fix_type, lat=lat, lon=85_000_000, alt=400_000)
        assert (check.world() is not None) == told
    check.desk.state.place = mav.GlobalPositionInt(lat=474_000_000, lon=85_000_000, alt=400_000)
    undated = check.world()
    assert undated is not None
    assert undated.ned_mgauss == earth_field(47.4, 8.5, 400.0, round(check.settings.year, 2)).ned_mgauss
    for unix_s, year in ((1_798_761_600, 2027.0), (1_399_999_999, round(check.settings.year, 2))):
        check.desk.state.utc = mav.SystemTime(time_unix_usec=unix_s * 1_000_000)
        dated = check.world()
        assert dated is not None and dated.ned_mgauss == earth_field(47.4, 8.5, 400.0, year).ned_mgauss
