"""MAVSDK, which knows nothing of us, meets the simulated vehicle as it would meet a real one."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from serving import serving

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoVehicle
from mavcompass.messages import Attitude, ParamSet, ParamValue, RawImu
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.opening import open_link
from mavcompass.vehicle.transport import mavsdk as mavsdk_transport


@contextmanager
def mavsdk_meets(vehicle: SimulatedAutopilot, speed: float = 4.0) -> Iterator[Any]:
    """Give MAVSDK's System of a vehicle that is served over TCP."""
    from mavsdk.mavsdk import Configuration, Mavsdk

    mavsdk_transport._log_through_python()
    with serving(vehicle, speed=speed) as (_, port):
        with Mavsdk(Configuration.create_manual(1, 191, True)) as mavsdk:
            mavsdk.add_any_connection(f"tcpout://127.0.0.1:{port}")
            system = mavsdk.first_autopilot(5.0)
            assert system is not None, "MAVSDK does not take it for an autopilot"
            yield system


def wait_for(condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
    end_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    return condition()


def turn_right_90(system: Any) -> int:
    """Command a relative turn; return the vehicle's answer."""
    from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage

    fields = {
        "target_system": 1,
        "target_component": 1,
        "command": int(MavCmd.CONDITION_YAW),
        "confirmation": 0,
    }
    fields |= {"param1": 90, "param2": 45, "param3": 1, "param4": 1, "param5": 0, "param6": 0, "param7": 0}
    command = MavlinkMessage("COMMAND_LONG", fields_json=json.dumps(fields))
    ack = MavlinkDirect(system).send_command(command)
    return int(json.loads(ack.fields_json)["result"])


@pytest.mark.parametrize("kind", ["rover", "copter"])
def test_it_sets_and_reads_parameters(kind: str) -> None:
    from mavsdk.plugins.param import Param, ParamError

    with mavsdk_meets(SimulatedAutopilot(kind, seed=2)) as system:
        parameters = Param(system)
        parameters.set_param_float("COMPASS_OFS_X", 123.5)
        assert parameters.get_param_float("COMPASS_OFS_X") == 123.5
        if kind == "rover":
            with pytest.raises(ParamError):  # after MAVSDK's three seconds of patience
                parameters.get_param_float("NO_SUCH_PARAM")


def test_it_reads_all_parameters_at_once() -> None:
    from mavsdk.plugins.param import Param

    with mavsdk_meets(SimulatedAutopilot("rover", seed=2)) as system:
        everything = Param(system).get_all_params()
        names = {p.name for p in everything.float_params} | {p.name for p in everything.int_params}
        assert {"COMPASS_OFS_X", "COMPASS_DIA2_Y", "COMPASS_USE"} <= names


def test_it_streams_at_the_rate_it_asks_for() -> None:
    from mavsdk.plugins.telemetry import Telemetry

    vehicle = SimulatedAutopilot("copter", seed=2)
    with mavsdk_meets(vehicle, speed=1.0) as system:
        telemetry = Telemetry(system)
        telemetry.set_rate_raw_imu(50.0)
        heard: list[Any] = []
        telemetry.subscribe_raw_imu(lambda imu, _: heard.append(imu))
        start_s = vehicle.time_s
        assert wait_for(lambda: len(heard) >= 60)
        assert len(heard) / (vehicle.time_s - start_s) == pytest.approx(50.0, rel=0.15)
        # MAVSDK labels the wire's milligauss as gauss.
        field = heard[-1].magnetic_field_frd
        assert 200.0 < math.hypot(field.forward_gauss, field.right_gauss, field.down_gauss) < 1200.0


def test_it_turns_a_copter() -> None:
    vehicle = SimulatedAutopilot("copter", seed=2)
    with mavsdk_meets(vehicle) as system:
        before_rad = vehicle.body.yaw_rad
        assert turn_right_90(system) == MavResult.ACCEPTED

        def turned_deg() -> float:
            return math.degrees(vehicle.body.yaw_rad - before_rad) % 360.0

        assert wait_for(lambda: 60.0 < turned_deg() < 120.0, 8.0)


def test_a_rover_refuses_to_turn_by_that_command() -> None:
    with mavsdk_meets(SimulatedAutopilot("rover", seed=2)) as system:
        assert turn_right_90(system) == MavResult.UNSUPPORTED


def test_the_mavsdk_link_reads_the_vehicles_second_compass() -> None:
    from mavcompass.messages import ScaledImu2

    with serving(SimulatedAutopilot("rover", seed=2), speed=4.0) as (_, port):
        with open_link(f"mavsdk+tcpout://127.0.0.1:{port}") as link:
            kinds = set()
            end_s = link.now() + 5.0
            while not {RawImu, ScaledImu2, Attitude} <= kinds and link.now() < end_s:
                if (incoming := link.receive(0.5)) is not None:
                    kinds.add(type(incoming.message))
            assert {RawImu, ScaledImu2, Attitude} <= kinds
            link.send(ParamSet(1, 1, "COMPASS_OFS_Y", math.nan))
            link.send(ParamSet(1, 1, "COMPASS_OFS_Y", -12.25))
            values = []
            while not values and link.now() < end_s:
                incoming = link.receive(0.5)
                if incoming is not None and isinstance(incoming.message, ParamValue):
                    values.append((incoming.message.param_id, incoming.message.param_value))
            assert values == [("COMPASS_OFS_Y", -12.25)]


def test_a_port_that_mavsdk_cannot_open_is_told() -> None:
    with pytest.raises(NoVehicle, match="MAVSDK could not open"):
        open_link("mavsdk+serial:///dev/no_such_port:57600")
