"""What a person wants of a calibration, live or of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass.cli.options import Output
from mavcompass.errors import PoorCalibration

if TYPE_CHECKING:
    from mavcompass.procedure.nameplate import Nameplate
    from mavcompass.track import Track

NOT_ACCEPTED = 5
# Written and proven, but the autopilot still steers by another heading.
STEERS_OFF = 8


@dataclass(frozen=True, slots=True)
class Wanted:
    """Hold the options that both kinds share, and write the files they name."""

    source: str
    method: str
    instances: tuple[int, ...]
    max_error_deg: float
    params_out: Path | None
    report_file: Path | None
    output: Output

    def refused(
        self, error: PoorCalibration, instances: tuple[int, ...], track: Track | None = None
    ) -> dict[str, object]:
        """Put together the document of a calibration that could not be solved."""
        from mavcompass.report.document import refused_document

        return refused_document(self.source, self.method, instances, str(error), track)

    def of_system(self, system: int) -> Wanted:
        """Return the same for one of several vehicles: its files are named by its system id."""

        def named(path: Path | None) -> Path | None:
            return None if path is None else path.with_name(f"{path.stem}-system{system}{path.suffix}")

        return replace(self, params_out=named(self.params_out), report_file=named(self.report_file))

    def write_params(self, document: dict[str, Any], vehicle: Nameplate | None = None) -> None:
        """Write the parameters of an accepted calibration where a file was named, and whose they are."""
        if self.params_out is None:
            return
        from mavcompass.vehicle.parameters.files import write_parameter_file
        from mavcompass.vehicle.parameters.undo import marked

        values: dict[str, float] = {}
        for compass in document["compasses"]:
            values |= compass["parameters"]
        write_parameter_file(
            self.params_out,
            values,
            marked(vehicle, f"Compass calibration from {self.source}, by mavcompass."),
        )
        self.output.say(f"Parameters: {self.params_out}")
