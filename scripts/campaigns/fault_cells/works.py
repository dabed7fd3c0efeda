"""What is done to the vehicle, cell by cell: each procedure of the product that commands or writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from campaign import borrow

from fault_cells.scene import Scene, WatchedLink
from mavcompass.errors import MavCompassError
from mavcompass.procedure.check import CheckSettings
from mavcompass.procedure.check import check as check_script
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.script import Machine
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.service import station as station_module
from mavcompass.service.config import ServiceConfig, StorageConfig, VehicleConfig
from mavcompass.service.work.history import History
from mavcompass.service.work.tasks import CalibrationRequest, Request, Task, UndoRequest
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.parameters.files import write_parameter_file
from mavcompass.vehicle.parameters.undo import read_kept, undo_saver
from mavcompass.vehicle.session import WriteReport, compass_part, write_values

borrow("procedure")
from bent_vehicles import bent_compasses  # noqa: E402

SOURCE = "sim:vehicle"
AT_ONCE = CalibrateSettings(motion="vehicle", writing="yes")
ROUND = replace(AT_ONCE, continuous=True)
IRON_MGAUSS = 300.0
NOW = "2026-05-01T00:00:00+00:00"


@dataclass
class Ending:
    """Say how a work ended, as the person sees it.

    Attributes:
        written: it says that new values are written and proven. error: what it ended with.
    """

    written: bool = False
    error: BaseException | None = None


@dataclass(frozen=True)
class Work:
    """Be one procedure on one kind of vehicle.

    Attributes:
        on_the_ground: it begins disarmed, with iron beside its compass for which it would not arm.
        share: of the cells, in proportion. moves: it turns the vehicle. goes_on: after a fault, by itself.
        flies_on_s: so long the autopilot follows a target whose successor never came, or it runs on.
    """

    name: str
    kind: str
    do: Callable[[Scene], bool]
    prepare: Callable[[Scene], None] = field(default=lambda scene: None)
    share: float = 1.0
    moves: bool = False
    goes_on: bool = False
    flies_on_s: float = 0.0
    on_the_ground: bool = False

    def vehicle(self) -> SimulatedAutopilot:
        """Make the vehicle that it is done to."""
        if not self.on_the_ground:
            return SimulatedAutopilot(self.kind, seed=3)
        setups = bent_compasses(self.kind, 3, IRON_MGAUSS, 0.0)
        made = SimulatedAutopilot(self.kind, seed=3, compasses=setups, armed=False, ready_s=2.0)
        made.advance(8.0)
        return made


def arm(scene: Scene) -> bool:
    """Calibrate a vehicle that must be armed for it, and would not for its compass."""
    permissions = Permissions(set_mode=True, arm=True, exempt="yes")
    settings = CalibrateSettings(motion="vehicle", writing="yes", permissions=permissions)
    return calibrate(scene, settings)


def calibrate(scene: Scene, settings: CalibrateSettings = AT_ONCE) -> bool:
    """Calibrate, and write without asking."""
    with scene.link() as link:
        report = calibrate_on(
            link, SOURCE, settings, on_show=scene.show, stop=scene.stop, undo_directory=scene.undo_folder
        )
    scene.told += report.messages
    return report.written and not report.undone


def check(scene: Scene) -> bool:
    """Check before a flight, with a turn."""
    machine = Machine(lambda context: check_script(context, make_dialect, CheckSettings(turn="vehicle")))
    with scene.link() as link:
        scene.told.append(run(machine, link, on_show=scene.show, stop=scene.stop).summary())
    return False


def write(scene: Scene) -> bool:
    """Write a parameter file."""
    return write_file(scene, scene.folder / "wanted.param", checked=True)


def restore(scene: Scene) -> bool:
    """Put back what the first undo file holds, as `params restore` and the service do."""
    return write_file(scene, first_undo(scene), checked=False)


def write_file(scene: Scene, path: Path, checked: bool) -> bool:
    """Do what `params write` and `params restore` do."""
    kept = read_kept(path)
    machine: Machine[WriteReport] = Machine(
        lambda context: write_values(
            context,
            SOURCE,
            lambda held, vehicle: compass_part(kept, held),
            undo_saver(SOURCE, scene.undo_folder),
            checked=checked,
            consent=lambda held, plan: "",
        )
    )
    with scene.link() as link:
        report = run(machine, link, on_show=scene.show, stop=scene.stop)
    return report.outcome is not None and report.outcome.verified


def serve(scene: Scene) -> bool:
    """Have the service calibrate."""
    request = CalibrationRequest(compasses=(1,), motion="vehicle", writing="yes")
    return _serve(scene, lambda: request)


def serve_undo(scene: Scene) -> bool:
    """Have the service put back what the first undo file holds."""
    return _serve(scene, lambda: UndoRequest(first_undo(scene).name, 1))


def prepare_write(scene: Scene) -> None:
    """Make the file that is to be written: other offsets, and other scales, of the first compass."""
    held, kinds = scene.compass_values(), {"CAL_MAG0_{}OFF": 0.03, "CAL_MAG0_{}SCALE": 0.05}
    if "COMPASS_OFS_X" in held:
        kinds = {"COMPASS_OFS_{}": 20.0, "COMPASS_DIA_{}": 0.05}
    steps = {kind.format(axis): step for kind, step in kinds.items() for axis in "XYZ"}
    wanted = {n: held[n] + steps[n] * (1 if k % 2 else -1) for k, n in enumerate(steps)}
    write_parameter_file(scene.folder / "wanted.param", wanted)


def prepare_undo(scene: Scene) -> None:
    """Write a parameter file undisturbed, so that there is something to put back."""
    prepare_write(scene)
    write(scene)


def first_undo(scene: Scene) -> Path:
    """Return the oldest undo file."""
    return min(scene.undo_folder.glob("*.json"))


WORKS = (
    Work("calibrate", "rover", calibrate, share=0.8, moves=True),
    Work("round", "rover", partial(calibrate, settings=ROUND), share=0.2, moves=True, flies_on_s=0.3),
    Work("calibrate", "ackermann-rover", calibrate, share=0.05, moves=True, flies_on_s=2.3),  # a target lasts
    Work("calibrate", "boat", calibrate, share=0.05, moves=True, flies_on_s=1.5),  # on the water
    Work("calibrate", "sub", calibrate, share=0.05, moves=True),
    Work("calibrate", "copter", calibrate, share=0.05, moves=True),
    Work("calibrate", "px4-copter", calibrate, share=0.01, moves=True, flies_on_s=1.0),  # COM_OF_LOSS_T
    Work("arm", "rover", arm, share=0.3, moves=True, flies_on_s=3.0, on_the_ground=True),  # a target lasts
    Work("check", "rover", check, share=1.5, moves=True),
    Work("write", "rover", write, prepare_write, share=2.5),
    Work("write", "px4-copter", write, prepare_write, share=1.2),
    Work("restore", "rover", restore, prepare_undo, share=3.0),
    Work("serve", "rover", serve, share=0.3, moves=True, goes_on=True),
    Work("serve undo", "rover", serve_undo, prepare_undo, share=0.7, goes_on=True),
)


# --- the service, on this thread and in virtual time ------------------------------------------------


class _HereWorker:
    """Do the service's heavy work in this process: thousands of cells cannot start one each."""

    def start(self) -> None: ...

    def end(self) -> None: ...

    def close(self) -> None: ...

    def call(self, function: Callable[..., Any], *arguments: Any, timeout_s: float = 0.0) -> Any:
        return None if function.__name__ == "write_calibration_report" else function(*arguments)


def _serve(scene: Scene, request: Callable[[], Request]) -> bool:
    """Run the service's station until a request that it is given has ended."""
    scene.folder.mkdir(exist_ok=True)
    config = ServiceConfig(
        vehicle=VehicleConfig(source=SOURCE, compasses=(1,)), storage=StorageConfig(str(scene.folder))
    )
    history = _WatchedHistory(scene)
    tasks: list[Task] = []
    with patch.object(station_module, "_REOPEN_S", 0.0), _task_told(scene):
        try:
            station = station_module.Station(config, history, scene.link)
            station._jobs._worker = station._jobs._results._worker = _HereWorker()  # type: ignore[assignment]
            hear = station._hear
            deadline_s = scene.vehicle.time_s + 120.0

            def hear_and_ask(link: WatchedLink, heard: Any) -> None:
                hear(link, heard)
                if not tasks and station.view is not None and station.view.fresh:
                    tasks.append(station.desk.submit(request(), "http", NOW))
                    tasks[0].stop = scene.stop
                if (tasks and tasks[0].finished) or (not tasks and link.now() > deadline_s):
                    station._ending.reason = "done"

            station._hear = hear_and_ask  # type: ignore[method-assign,assignment]
            station._run()
        finally:
            history.close()
    if not tasks:
        raise MavCompassError("The service never met the vehicle.")
    task = tasks[0]
    scene.told += [task.error, task.remedy]
    if task.state == "failed":
        raise MavCompassError(task.error, task.remedy)
    document = task.document or {}
    return bool(document.get("written", document.get("verified")))


class _WatchedHistory(History):
    """Be a history each of whose entries is a step, on a disk that may be full."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.folder / "history.db")
        self._scene = scene

    def add(self, *arguments: Any, **named: Any) -> int:
        self._scene.step("file", "history")
        if self._scene.disk_error:
            pages = self._database.execute("PRAGMA page_count").fetchone()[0]
            self._database.execute(f"PRAGMA max_page_count = {pages}")
        return super().add(*arguments, **named)


@contextmanager
def _task_told(scene: Scene) -> Iterator[None]:
    show = Task.show

    def told(self: Task, line: Any) -> None:
        show(self, line)
        scene.show(line)

    with patch.object(Task, "show", told):
        yield
