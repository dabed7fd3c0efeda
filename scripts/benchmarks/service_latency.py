"""Measure the service's way from an IMU message to a published heading beside a bare pymavlink loop.

    scripts/bench service_latency [-- --seconds 20 --rate 400]

One process plays the vehicle and sends each RAW_IMU to both at the same moment, stamped with the monotonic
clock. One process receives with pymavlink's `recv_match` and does nothing. One is the whole service, its
HTTP interface and one listener of the page's stream included. Latency is stamp to return of `recv_match`,
and stamp to the heading's datagram being sent. CPU is user and system time of each process.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT))
WARM_UP_S = 4.0


QUICK = ("--seconds", "5")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure both; return their figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=400.0)
    parser.add_argument("--role", choices=("bare", "service"), help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.role:
        {"bare": bare, "service": service}[options.role](options.port, options.seconds)
        return {}
    figures = measure(options.rate, options.seconds)
    for name in ("bare", "service"):
        print(
            f"{name:8} median {figures[name]['median_us']:7.0f} us   99 % {figures[name]['p99_us']:7.0f} us"
            f"   CPU {figures[name]['cpu_percent']:5.1f} %   {figures[name]['resident_mb']:.0f} MB"
            f"   {figures[name]['count']} messages"
        )
    print(f"service / bare: median {figures['median_ratio']:.2f}, CPU {figures['cpu_ratio']:.2f}")
    return figures


def measure(rate_hz: float, seconds: float) -> dict[str, Any]:
    """Run both receivers under one sender and return their figures."""
    ports = {"bare": free_port(), "service": free_port()}
    children = {
        name: subprocess.Popen(
            [sys.executable, __file__, "--role", name, "--port", str(port), "--seconds", str(seconds)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for name, port in ports.items()
    }
    send(list(ports.values()), rate_hz, children)
    figures: dict[str, Any] = {
        name: json.loads(child.communicate()[0].splitlines()[-1]) for name, child in children.items()
    }
    figures["rate_hz"] = rate_hz
    figures["median_ratio"] = figures["service"]["median_us"] / figures["bare"]["median_us"]
    figures["cpu_ratio"] = figures["service"]["cpu_percent"] / figures["bare"]["cpu_percent"]
    return figures


def free_port() -> int:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def send(ports: list[int], rate_hz: float, children: dict[str, subprocess.Popen[str]]) -> None:
    """Play the vehicle until both receivers have ended."""
    import socket

    from mavcompass.messages import GlobalPositionInt, Heartbeat, RawImu
    from mavcompass.vehicle.wire import FrameWriter

    writer = FrameWriter(2, None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def both(message: Any) -> None:
            data = writer.write(message, 1, 1)
            for port in ports:
                out.sendto(data, ("127.0.0.1", port))

        due_s, count = time.monotonic(), 0
        while any(child.poll() is None for child in children.values()):
            if count % int(rate_hz) == 0:
                both(Heartbeat(type=10, autopilot=3, base_mode=0, system_status=4))
                both(GlobalPositionInt(time.monotonic_ns() // 1_000_000, -353632620, 1491652370, 584000))
            wobble = count % 3
            both(RawImu(time.monotonic_ns() // 1000, 0, 0, -1000, 0, 0, 0, 232 + wobble, 52, -528 - wobble))
            count += 1
            due_s += 1.0 / rate_hz
            time.sleep(max(due_s - time.monotonic(), 0.0))


def summary(delays_us: list[float], cpu_s: float, wall_s: float) -> dict[str, float]:
    delays_us = sorted(delays_us)
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6
    return {
        "median_us": statistics.median(delays_us),
        "p99_us": delays_us[int(0.99 * len(delays_us))],
        "cpu_percent": 100.0 * cpu_s / wall_s,
        "resident_mb": resident,
        "count": len(delays_us),
    }


def bare(port: int, seconds: float) -> None:
    """Receive with pymavlink and do nothing with it."""
    from pymavlink import mavutil

    connection = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="ardupilotmega")
    end = time.monotonic() + WARM_UP_S
    while time.monotonic() < end:
        connection.recv_match(type="RAW_IMU", blocking=True)
    delays: list[float] = []
    began, used = time.monotonic(), time.process_time()
    while time.monotonic() < began + seconds:
        message = connection.recv_match(type="RAW_IMU", blocking=True)
        delays.append(time.monotonic_ns() / 1000 - message.time_usec)
    print(json.dumps(summary(delays, time.process_time() - used, time.monotonic() - began)))


def service(port: int, seconds: float) -> None:
    """Run the whole service; the stamp of a heading is compared with the clock once it is sent."""
    from websockets.sync.client import connect

    from mavcompass.heading.live import Heading
    from mavcompass.service.config import (
        HeadingConfig,
        HttpConfig,
        ServiceConfig,
        StorageConfig,
        VehicleConfig,
    )
    from mavcompass.service.run import Service
    from mavcompass.service.station import HeadingPublisher

    delays: list[float] = []

    class Timed(HeadingPublisher):
        def publish(self, heading: Heading) -> None:
            super().publish(heading)
            delays.append(time.monotonic_ns() / 1000 - heading.boot_s * 1e6)

    publish = f"udp:127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        served = Service(
            ServiceConfig(
                vehicle=VehicleConfig(source=f"udpin:127.0.0.1:{port}"),
                http=HttpConfig(listen="127.0.0.1:0"),
                heading=HeadingConfig(publish),
                storage=StorageConfig(folder),
            )
        )
        served.station._publisher = Timed(publish)

        def look() -> None:
            time.sleep(WARM_UP_S)
            with connect(served.url.replace("http", "ws") + "api/stream?rate_hz=10") as page:
                page.recv()
                delays.clear()
                began, used = time.monotonic(), time.process_time()
                while time.monotonic() < began + seconds:
                    page.recv()
                figures = summary(list(delays), time.process_time() - used, time.monotonic() - began)
            print(json.dumps(figures), flush=True)
            served.stop()

        threading.Thread(target=look, daemon=True).start()
        served.run()


if __name__ == "__main__":
    main()
