"""A whole service on an embedded vehicle, in a thread of the test."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx

from mavcompass.service.config import HttpConfig, ServiceConfig, StorageConfig, VehicleConfig
from mavcompass.service.run import Service
from mavcompass.vehicle.links.simulated import SimulatedLink

# What hangs ends by it; on a busy machine all takes ten times as long, and that is no failure.
_PATIENCE_S = 300.0


def wait_for(what: Callable[[], Any]) -> Any:
    """Wait until a function returns something true, and return it."""
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        if value := what():
            return value
        time.sleep(0.05)  # most ask over HTTP, which costs both sides some milliseconds
    raise AssertionError(f"{what} stayed false for {_PATIENCE_S:.0f} s")


class RunningService:
    """A service that runs, its vehicle, and a client that has the token."""

    def __init__(self, service: Service, link: SimulatedLink | None) -> None:
        self.service = service
        self.link = link
        self.client = httpx.Client(
            base_url=service.url, headers={"authorization": f"Bearer {service.token}"}, timeout=_PATIENCE_S
        )
        self.stranger = httpx.Client(base_url=service.url, timeout=_PATIENCE_S)
        self._thread = threading.Thread(target=service.run, daemon=True)

    def __enter__(self) -> RunningService:
        self._thread.start()
        station = self.service.station
        wait_for(lambda: station.view and station.view.fresh and station.view.world)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self.stranger.close()
        self.service.stop()
        self._thread.join(_PATIENCE_S)
        assert not self._thread.is_alive(), "the service did not stop"

    def finish(self, task: dict[str, Any]) -> dict[str, Any]:
        """Wait for the end of a task and return it."""

        def ended() -> dict[str, Any] | None:
            now: dict[str, Any] = self.client.get("/api/task").json()
            return now if now["id"] == task["id"] and now["state"] in ("done", "failed") else None

        return wait_for(ended)

    def calibrate(self, **body: Any) -> dict[str, Any]:
        """Ask for a calibration and wait for its end."""
        answer = self.client.post("/api/calibration", json=body)
        assert answer.status_code == 202, answer.text
        return self.finish(answer.json())


def configured(folder: Path, source: str = "sim:rover", **tables: Any) -> ServiceConfig:
    """A configuration for tests: any free port, all data in a folder."""
    config = ServiceConfig(
        vehicle=VehicleConfig(source=source),
        http=HttpConfig(listen="127.0.0.1:0"),
        storage=StorageConfig(str(folder)),
    )
    return replace(config, **tables)


StartService = Callable[..., RunningService]
