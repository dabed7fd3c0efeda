"""Calibrate all vehicles of one link, each in its own time, one after the other."""

from __future__ import annotations

from dataclasses import replace

from mavcompass.cli.calibration.vehicle import calibrate_one
from mavcompass.cli.calibration.wanted import STEERS_OFF, Wanted
from mavcompass.cli.terminal.colour import styled
from mavcompass.errors import MavCompassError, PoorCalibration
from mavcompass.procedure.calibrate import CalibrateSettings
from mavcompass.procedure.script import Machine
from mavcompass.procedure.vehicle_state import find_vehicles
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.stopping import StopRequest

SCHEMA = "mavcompass.calibrations/1"


def calibrate_all(link: Link, wanted: Wanted, settings: CalibrateSettings, speak: bool) -> int:
    """Calibrate every vehicle that is heard; return the largest exit code of them.

    What befalls one vehicle does not keep the next from its turn; a person's stop does.
    Raises NoVehicle where none is heard.
    """
    output, stop = wanted.output, StopRequest()
    found = run(Machine(find_vehicles), link, stop=stop)
    documents: list[dict[str, object]] = []
    worst, lines = 0, []
    for vehicle in found:
        name = str(vehicle)
        output.say(styled(f"{name}:", bold=True))
        mine = wanted.of_system(vehicle.system)
        trouble: MavCompassError | None = None
        try:
            document, code = calibrate_one(link, mine, replace(settings, system=vehicle.system), speak, stop)
        except MavCompassError as error:
            trouble, code = error, error.exit_code
            refused = (
                mine.refused(error, settings.instances or (1,)) if isinstance(error, PoorCalibration) else {}
            )
            document = {**refused, "error": error.what, "remedy": error.remedy}
            output.say(styled(str(error), fg="red"))
        documents.append({"system": vehicle.system, "exit_code": code, **document})
        worst = max(worst, code)
        lines.append(f"{name}: {_ending(document, code, trouble)}")
        if stop.reason is not None:
            break
    output.write_json({"schema": SCHEMA, "source": wanted.source, "vehicles": documents})
    for line in lines:
        output.say(line)
    left = [str(vehicle.system) for vehicle in found[len(documents) :]]
    if left:
        output.say(f"Stopped; not calibrated: system {', '.join(left)}.")
    return worst


def _ending(document: dict[str, object], code: int, trouble: MavCompassError | None) -> str:
    if trouble is not None:
        return trouble.what
    compasses = document["compasses"]
    assert isinstance(compasses, list)
    accepted = all(compass["accepted"] for compass in compasses)
    done = "written and checked" if document["written"] else "not written"
    steers = " The autopilot's own heading is still off: see above." if code == STEERS_OFF else ""
    return f"{'calibrated' if accepted else 'not accepted'}, {done}.{steers}"
