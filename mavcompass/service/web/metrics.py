"""What Prometheus scrapes: gathered when it asks, kept nowhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from prometheus_client import generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from mavcompass.service.station import Station
from mavcompass.service.view import VehicleView

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class _Collector:
    def __init__(self, station: Station) -> None:
        self._station = station

    def collect(self) -> Iterator[Any]:
        """Yield every metric."""
        station = self._station
        yield _gauge("connected", "Whether the vehicle was heard lately.", float(station.connected))
        yield _counter("headings", "Headings published.", station.headings)
        link, task = station.link, station.desk.current
        if link is not None:
            counts = link.statistics
            yield _counter("messages_received", "Messages heard.", counts.received)
            yield _counter("messages_lost", "Frames missing by sequence number.", counts.lost)
            yield _counter("frames_malformed", "Bytes that were no frame.", counts.malformed)
            yield _counter("messages_dropped", "Messages that could not be sent.", counts.dropped)
        yield _gauge("task_running", "Whether a procedure is under way.", float(station.desk.busy))
        yield _counter("tasks", "Requests taken.", 0 if task is None else task.number)
        if station.view is not None:
            yield from self._of_vehicle(station.view)

    def _of_vehicle(self, view: VehicleView) -> Iterator[Any]:
        yield _counter("reconnects", "Times the vehicle came back after a silence.", view.reconnects)
        yield _counter("reboots", "Times the vehicle was restarted.", view.reboots)
        gauges = {
            name: GaugeMetricFamily(f"mavcompass_{name}", text, labels=["compass"])
            for name, text in (
                ("heading_magnetic_degrees", "Magnetic heading."),
                ("heading_sigma_degrees", "Its standard deviation."),
                ("field_milligauss", "Length of the field."),
                ("dip_degrees", "Angle of the field below the horizon."),
            )
        }
        for instance, compass in list(view.compasses.items()):
            heading = compass.latest
            if heading is None:
                continue
            values = (
                math.degrees(heading.magnetic_rad),
                math.degrees(heading.sigma_rad),
                heading.total_mgauss,
                math.degrees(heading.dip_rad),
            )
            for gauge, value in zip(gauges.values(), values, strict=True):
                gauge.add_metric([str(instance)], value)
        yield from gauges.values()
        findings = GaugeMetricFamily(
            "mavcompass_finding", "What the watch finds wrong.", labels=["id", "compass", "severity"]
        )
        for finding in self._station.findings:
            findings.add_metric([finding.id, str(finding.instance), finding.severity], 1.0)
        yield findings


def _gauge(name: str, text: str, value: float) -> Any:
    return GaugeMetricFamily(f"mavcompass_{name}", text, value=value)


def _counter(name: str, text: str, value: float) -> Any:
    return CounterMetricFamily(f"mavcompass_{name}", text, value=value)


def metrics_text(station: Station) -> bytes:
    """Return a station's metrics in their text form."""
    return generate_latest(_Collector(station))  # which does nothing but collect
