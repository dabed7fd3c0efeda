"""How the simulated vehicles come up, and that they are reproducible."""

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.sensors import draw_compasses
from mavcompass.simulation.vehicle import SimulatedAutopilot

VEHICLES = ["rover", "ackermann-rover", "boat", "copter", "sub"]
ALL = [*VEHICLES, "px4-copter"]


def test_every_seed_starts_with_a_bad_compass():
    for seed in range(30):
        vehicle = SimulatedAutopilot("rover", seed=seed)
        assert 15.0 <= heading_error_rms_deg(vehicle) <= 60.0, seed
        assert heading_error_rms_deg(vehicle, 1, vehicle.board.compass_setups[0].model.iron) < 1e-9, seed
        assert max(heading_error_rms_deg(vehicle, i) for i in (2, 3)) < 4.0, seed


def test_the_bad_compass_steers(station):
    bends = [abs(station(seed=s).ekf_error_deg) for s in range(20)]
    assert max(bends) > 25.0
    assert np.median(bends) > 8.0


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_it_comes_up_armed_in_guided_and_ready(station, vehicle):
    s = station(vehicle)
    s.stream(193, 2)
    s.wait(2.5)
    beat = [b for b in s.of(m.Heartbeat) if b.autopilot == 3][-1]
    assert beat.base_mode & 128
    assert beat.custom_mode == s.vehicle.profile.guided_mode
    assert s.of(m.EkfStatusReport)[-1].flags & 0b10011 == 0b10011


@pytest.mark.parametrize("vehicle", ALL)
def test_the_same_seed_gives_the_same_bytes_however_time_is_cut(vehicle):
    def record(cuts):
        v = SimulatedAutopilot(vehicle, seed=5)
        v.receive(m.CommandLong(1, 1, 511, 0, 27, 25000.0), 255, 190)
        v.receive(m.ParamRequestRead(1, 1, "COMPASS_OFS_X"), 255, 190)
        v.receive(m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x9FF, yaw=1.0), 255, 190)
        return [o for t in cuts for o in v.advance(t)]

    whole = record([4.0])
    assert whole == record(np.linspace(0.013, 4.0, 300).tolist())
    assert whole == record([0.001, 0.019, 0.021, 3.99, 4.0])
    assert len(whole) > 50


def test_other_seeds_are_other_vehicles():
    a, b = (draw_compasses(s, 230.0, "old")[0].model.iron for s in (1, 2))
    assert a != b


def test_a_ground_station_is_heard_before_the_vehicle(station):
    s = station()
    s.wait(1.5)
    beats = [o for o in s.heard if isinstance(o.message, m.Heartbeat)]
    assert [(o.system, o.component, o.message.autopilot) for o in beats] == [(255, 190, 8), (1, 1, 3)]


def test_heartbeats_are_routed_to_the_other_ports(station):
    s = station(other_stations=())
    s.send(m.Heartbeat(type=6, autopilot=8), system=254, port=1)
    s.send(m.Heartbeat(type=18, autopilot=8), system=1, port=0)
    out = s.wait(0.1)
    assert [(o.system, o.port) for o in out if isinstance(o.message, m.Heartbeat)] == [(254, 0), (1, 1)]


def test_an_unknown_vehicle_is_refused_with_the_list():
    from mavcompass.errors import UsageError

    with pytest.raises(UsageError, match="rover"):
        SimulatedAutopilot("hovercraft")
