"""Vehicle: a connected vehicle for programs and notebooks; `mavcompass.connect` gives one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from mavcompass.messages import Incoming
from mavcompass.procedure.dialect import describe_compasses
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Machine, Script, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import VehicleIdentity, find_vehicle
from mavcompass.track import Track
from mavcompass.track_builder import TrackBuilder
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.opening import open_link


class Vehicle:
    """Be a vehicle on a link; use it as a context manager.

    Attributes:
        link: the link, for what is not offered here. identity: who answered.
    """

    def __init__(self, link: Link, source: str, identity: VehicleIdentity) -> None:
        self.link = link
        self.identity = identity
        self._source = source

    def __enter__(self) -> Vehicle:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the link."""
        self.close()

    def close(self) -> None:
        """Close the link."""
        self.link.close()

    def parameters(self) -> dict[str, float]:
        """Read everything about the vehicle's compasses.

        Raises NoReply where the vehicle does not answer, LinkLost where it fell silent.
        """
        dialect = make_dialect(self.identity.autopilot, self._source)

        def script(context: Context) -> Script[dict[str, float]]:
            context.system, context.component = self.identity.system, self.identity.component
            return (yield from dialect.compass_parameters(context))

        return run(Machine(script), self.link)

    def messages(self, seconds: float) -> Iterator[Incoming]:
        """Yield what the vehicle says for some time of the link's clock."""
        end_s = self.link.now() + seconds
        while (left_s := end_s - self.link.now()) > 0.0:
            heard = self.link.receive(left_s)
            if heard is not None and heard.system == self.identity.system:
                yield heard

    def record(self, seconds: float) -> Track:
        """Record what the vehicle streams by itself, with the corrections in force."""
        parameters = self.parameters()
        dialect = make_dialect(self.identity.autopilot, self._source)
        builder = TrackBuilder(self.identity.autopilot, self.identity.kind, self._source)
        builder.parameters.update(parameters)
        describe_compasses(builder, dialect, parameters)
        for heard in self.messages(seconds):
            builder.add(heard)
        return builder.build()

    def calibrate(
        self,
        settings: CalibrateSettings | None = None,
        method: str | None = None,
        max_heading_error_deg: float | None = None,
        on_show: Callable[[Show], None] | None = None,
    ) -> CalibrationReport:
        """Run the calibration; without settings compass 1, and nothing is written.

        A method, and what is accepted at most, may be named here instead of in the settings.

        Raises what `procedure.calibrate.calibrate` raises.
        """
        chosen = CalibrateSettings(writing="never") if settings is None else settings
        limit = chosen.max_heading_error_deg if max_heading_error_deg is None else max_heading_error_deg
        method = method or chosen.method
        chosen = replace(chosen, system=self.identity.system, method=method, max_heading_error_deg=limit)
        return calibrate_on(self.link, self._source, chosen, on_show=on_show)


def connect(source: str, system: int | None = None, timeout_s: float = 10.0) -> Vehicle:
    """Open a link and wait for an autopilot's heartbeat.

    Raises UsageError for a wrong address, or where several autopilots are heard and `system` picks none;
    NoVehicle where none is.
    """
    link = open_link(source)
    try:
        identity = run(Machine(lambda context: find_vehicle(context, system, timeout_s)), link)
    except BaseException:
        link.close()
        raise
    return Vehicle(link, source, identity)
