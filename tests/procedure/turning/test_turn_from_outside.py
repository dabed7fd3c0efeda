"""A new way to turn is one new file, which a vehicle's profile names."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from types import ModuleType

import pytest
from bent_vehicles import bent_vehicle, perform

from mavcompass import messages as mav
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import GyroAngle, profiles, strategies_for, ways
from mavcompass.procedure.turning.profiles import known_ways
from mavcompass.procedure.vehicle_state import VehicleState

NUDGES = '''
    """Nudge the vehicle along, a fixed rate at a time."""

    import math
    from dataclasses import dataclass

    from mavcompass.procedure.turning.steered import SteeredTurn
    from mavcompass.procedure.turning.targets import YAW_RATE_ONLY, send_target


    @dataclass(frozen=True)
    class Nudge:
        def turn(self, context, rate_radps, left_rad):
            send_target(context, YAW_RATE_ONLY, yaw_rate_radps=math.copysign(0.5, rate_radps))

        def stand(self, context):
            send_target(context, YAW_RATE_ONLY)

        def let_go(self, context):
            pass


    WAYS = {"nudges": lambda way, modes: SteeredTurn(Nudge(), way)}
'''


@pytest.fixture
def nudged_rovers(
    add_file: Callable[[ModuleType, str, str], None], monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    profile = profiles.VehicleProfile(
        "nudged", "ardupilot", ("rover",), (profiles.TurnWay("nudges", math.radians(30.0)),)
    )
    monkeypatch.setattr(profiles, "vehicle_profiles", lambda: (profile,))
    add_file(ways, "nudges", NUDGES)
    known_ways.cache_clear()
    yield
    known_ways.cache_clear()


@pytest.mark.usefixtures("nudged_rovers")
def test_a_file_in_the_folder_turns_a_vehicle() -> None:
    (strategy,) = strategies_for("rover", "ardupilot")
    vehicle, gyro = bent_vehicle("rover", seed=3), GyroAngle()

    def quarter_turn(context: Context, state: VehicleState) -> Script[bool]:
        yield from MessageRates().ask(context, {mav.RawImu: 25.0})
        moved = yield from strategy.turn(context, gyro, math.pi / 2.0)
        yield from pause(context, 3.0)
        strategy.halt(context)
        yield from strategy.release(context)
        return moved

    before_rad = vehicle.body.yaw_rad
    assert perform(vehicle, quarter_turn, (gyro.hear,))
    turned_rad = math.remainder(vehicle.body.yaw_rad - before_rad, 2.0 * math.pi)
    assert math.degrees(turned_rad) == pytest.approx(90.0, abs=25.0)
