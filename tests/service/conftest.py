"""Services for the tests of this folder."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from running_service import RunningService, StartService, configured

from mavcompass.service.run import Service
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink


@pytest.fixture
def start_service(tmp_path: Path) -> Iterator[StartService]:
    """Start services that end with the test; on a rover, twenty times faster than real."""
    with ExitStack() as stack:

        def start(link: SimulatedLink | None = None, speed: float = 20.0, **tables: Any) -> RunningService:
            vehicle = link or SimulatedLink.of("rover", seed=3, speed=speed)
            service = Service(configured(tmp_path, **tables), lambda: vehicle)
            return stack.enter_context(RunningService(service, vehicle))

        yield start


@pytest.fixture
def disarmed() -> SimulatedLink:
    """A rover on the ground whose first compass keeps it from arming."""
    iron = ["hard_iron:x=300,y=0,z=0"]
    return SimulatedLink(
        SimulatedAutopilot("rover", seed=3, effects=iron, armed=False, ready_s=2.0), speed=20.0
    )


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """One service for all tests of a file that change nothing."""
    link = SimulatedLink.of("rover", seed=3, speed=5.0)
    service = Service(configured(tmp_path_factory.mktemp("quiet")), lambda: link)
    with RunningService(service, link) as running:
        yield running


@pytest.fixture
def running(start_service: StartService) -> RunningService:
    """A service on an armed rover with a badly calibrated first compass."""
    return start_service()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """The service manager's ear."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(30.0)
        yield receiver
