"""Every step of every procedure crossed with every fault: no torn set without a way back, nothing hangs.

    python scripts/campaigns/fault_matrix.py [--cells 5000] [--seed 1] [--work write].. [--fault killed]..
    python scripts/campaigns/fault_matrix.py --cell write/rover/57/lost/1     # one cell again, with its story

The steps are found by tracing one undisturbed run of each procedure on the embedded firmware in virtual
time: each message sent or heard, each file opened, written, flushed or renamed, each change of phase. A cell
runs the procedure anew and lets one fault happen at one step. Cells are drawn evenly over procedures, faults
and kinds of steps. Afterwards the vehicle must hold the old set or the new one, or there are an undo file
and the sentence that restores it, which is then followed; it stands within a second; nothing went on for too
long; nothing but the product's own errors was raised or logged. Where somebody steps in (a stick, the mode
switch, disarming, a low battery, a stop) a calibration also commands nothing a second later, mode and message
rates are what they were, and it is told as a refusal. Half of the procedures that were killed, or
whose link was closed, are started again first and must come to an end of their own. `--processes` has real
programs killed by the system. Exit code 1 if any cell fails, 130 if Ctrl-C or SIGTERM ended it early.
"""

from __future__ import annotations

import gc
import logging
import random
import signal
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from campaign import Several, ended, folder, limit, options, share, tried
from fault_cells.faults import FAULTS, applies, clock_of
from fault_cells.judge import judge_end, judge_way_back
from fault_cells.processes import killed_process
from fault_cells.scene import Fault, Hung, Killed, Scene, Step, watched_files
from fault_cells.works import WORKS, Ending, Work

from mavcompass.errors import MavCompassError
from mavcompass.vehicle import driver
from mavcompass.vehicle.parameters.values import same_value
from mavcompass.vehicle.stopping import StopRequest

LONGEST_CPU_S = 60.0
TOO_LONG = Hung(f"still going on after {LONGEST_CPU_S:.0f} s of work")
STARTED_AGAIN = ("killed", "link closed")
STOPPED = 130


@dataclass(frozen=True)
class Trace:
    """Hold what an undisturbed run showed: its steps, how long it took, the parameters that it wrote."""

    steps: tuple[Step, ...]
    seconds: float
    touched: frozenset[str]


@dataclass(frozen=True)
class Cell:
    """Name a cell: a fault at a step of a procedure; the seed draws what the fault leaves open."""

    work: Work
    number: int
    step: Step
    fault: Fault
    seed: int

    def __str__(self) -> str:
        return f"{self.work.name}/{self.work.kind}/{self.number}/{self.fault.name}/{self.seed}"


@dataclass
class Outcome:
    """Hold what became of a cell."""

    cell: Cell
    wrong: list[str]
    told: str
    scene: Scene | None = None


def new_scene(work: Work, place: Path) -> Scene:
    """Build a vehicle for a procedure, and what it needs."""
    scene = Scene(work.vehicle(), place)
    work.prepare(scene)
    scene.told.clear()
    scene.before = scene.compass_values()
    scene.mode, scene.rates = scene.mode_and_rates()
    return scene


def trace(work: Work) -> Trace:
    """Run a procedure undisturbed."""
    with folder() as place:
        scene = new_scene(work, place)
        start_s, scene.active = scene.vehicle.time_s, True
        with watched_files(scene):
            work.do(scene)
        now = scene.compass_values()
        touched = frozenset(n for n, v in scene.before.items() if not same_value(v, now[n]))
        # A check writes nothing; others may write what it looks at all the same.
        touched = touched or frozenset(n for n in now if "OFS" in n)
        return Trace(tuple(scene.steps), scene.vehicle.time_s - start_s, touched)


def run_cell(cell: Cell, traced: Trace) -> Outcome:
    """Run one cell and judge it."""
    with folder() as place:
        scene = new_scene(cell.work, place)
        known = frozenset(scene.undo_folder.glob("*.json"))
        scene.fault, scene.target, scene.chance = cell.fault, cell.number, random.Random(str(cell))
        scene.touched = traced.touched
        scene.limit_s = scene.vehicle.time_s + 2.0 * traced.seconds + 200.0
        scene.active = True
        ending = attempt(cell.work, scene)
        ended_s, scene.active, scene.dead = scene.vehicle.time_s, False, False
        scene.disk_error, scene.limit_s, scene.silent_until_s = 0, float("inf"), -float("inf")
        scene.stop = StopRequest()
        if scene.count < cell.number:
            return Outcome(cell, ["the step never came"], "", scene)
        told = "killed" if isinstance(ending.error, Killed) else str(ending.error or "done")
        wrong = judge_end(scene, cell.work, ending, ended_s, known)
        if cell.fault.name in STARTED_AGAIN and cell.seed % 2:
            wrong += started_again(cell.work, scene, traced)
        scene.told.append(told)
        wrong += judge_way_back(scene, known)
        return Outcome(cell, wrong, told, scene)


def attempt(work: Work, scene: Scene) -> Ending:
    """Run a procedure with the scene's fault; nothing that it raises gets further than this."""
    with (
        watched_files(scene),
        clock_of(scene),
        limit(LONGEST_CPU_S, TOO_LONG, processor=True),
        tracebacks_noted(scene),
    ):
        try:
            return Ending(written=work.do(scene))
        except (Exception, Killed, Hung) as error:
            return Ending(error=error.with_traceback(None))


def started_again(work: Work, scene: Scene, traced: Trace) -> list[str]:
    """Run the procedure once more, undisturbed: it must end, and by its own errors if by any."""
    scene.limit_s = scene.vehicle.time_s + 2.0 * traced.seconds + 200.0
    with limit(LONGEST_CPU_S, TOO_LONG, processor=True):
        try:
            work.do(scene)
        except MavCompassError:
            return []
        except (Exception, Hung) as error:
            return [f"started again: {type(error).__name__}: {error}"]
        finally:
            scene.limit_s = float("inf")
    return []


@contextmanager
def tracebacks_noted(scene: Scene) -> Iterator[None]:
    """Keep what is logged from the terminal, and note every traceback in it or beside it."""

    class Noting(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info:
                scene.tracebacks.append(f"traceback in the log: {record.exc_info[1]!r}")

    def unraisable(what: object) -> None:
        if not scene.dead:  # what a killed program would have done no longer counts
            scene.tracebacks.append(f"traceback nobody could catch: {getattr(what, 'exc_value', what)!r}")

    handler, hook = Noting(), sys.unraisablehook
    logging.getLogger().addHandler(handler)
    sys.unraisablehook = unraisable
    try:
        yield
        gc.collect(0)
    finally:
        sys.unraisablehook = hook
        logging.getLogger().removeHandler(handler)


@contextmanager
def stopped_at_once() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the campaign: a procedure would take them for its own and end one cell."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with patch.object(driver, "stop_signals", lambda stop: nullcontext()):
        yield


def draw(traces: dict[Work, Trace], faults: Sequence[Fault], cells: int, seed: int) -> list[Cell]:
    """Draw cells, evenly over the kinds of steps of each procedure and the faults that apply to them."""
    chance = random.Random(seed)
    strata: dict[Work, dict[Step, list[int]]] = {}
    for work, traced in traces.items():
        strata[work] = defaultdict(list)
        for number, step in enumerate(traced.steps, 1):
            strata[work][step].append(number)
    drawn: dict[str, Cell] = {}
    works, shares = list(traces), [work.share for work in traces]
    for _ in range(50 * cells):
        if len(drawn) >= cells:
            break
        (work,) = chance.choices(works, shares)
        step = chance.choice(list(strata[work]))
        fitting = [fault for fault in faults if applies(fault, step)]
        if fitting:
            cell = Cell(
                work, chance.choice(strata[work][step]), step, chance.choice(fitting), chance.randrange(8)
            )
            drawn.setdefault(str(cell), cell)
    return list(drawn.values())


def matrix_size(traces: dict[Work, Trace], faults: Sequence[Fault]) -> int:
    """Count all cells, of which some are drawn."""
    return sum(applies(fault, step) for t in traces.values() for step in t.steps for fault in faults)


def parse(name: str) -> tuple[Work, int, Fault, int]:
    """Find a cell by its name."""
    work_name, kind, number, fault_name, seed = name.split("/")
    work = next(w for w in WORKS if (w.name, w.kind) == (work_name, kind))
    return work, int(number), next(f for f in FAULTS if f.name == fault_name), int(seed)


def tell_again(name: str) -> int:
    """Run one cell again and tell its story."""
    work, number, fault, seed = parse(name)
    traced = trace(work)
    cell = Cell(work, number, traced.steps[number - 1], fault, seed)
    outcome = run_cell(cell, traced)
    print(f"{cell} at {cell.step.kind} {cell.step.what}")
    for line in outcome.scene.told if outcome.scene else []:
        print(f"  {line}")
    print("\n".join(outcome.wrong) or "right")
    return 1 if outcome.wrong else 0


def main(words: list[str] | None = None) -> int:
    """Run the campaign and print the table."""
    wanted = options(
        __doc__,
        words,
        cells=5000,
        seed=1,
        work=Several(sorted({w.name for w in WORKS})),
        fault=Several([f.name for f in FAULTS]),
        cell=("", "run this one again"),
        processes=(0, "as many real programs are killed, too"),
    )
    if wanted.cell:
        return tell_again(wanted.cell)
    began_s = time.monotonic()
    traces = {work: trace(work) for work in WORKS if not wanted.work or work.name in wanted.work}
    faults = [fault for fault in FAULTS if not wanted.fault or fault.name in wanted.fault]
    cells = draw(traces, faults, wanted.cells, wanted.seed)
    whole = matrix_size(traces, faults)
    print(
        f"{len(cells)} cells of {whole}: "
        + ", ".join(f"{w.name} {w.kind} {len(t.steps)} steps" for w, t in traces.items())
    )
    outcomes: list[Outcome] = []
    try:
        with stopped_at_once():
            for outcome in tried(lambda cell: run_cell(cell, traces[cell.work]), cells, complaint, every=250):
                outcome.scene = None
                outcomes.append(outcome)
    except KeyboardInterrupt:
        print("stopped")
        table(outcomes)
        return STOPPED
    table(outcomes)
    killed = [killed_process(number % 8 + 1) for number in range(wanted.processes)]
    print("\n".join(f"a killed program: {sentence}" for wrong in killed for sentence in wrong))
    print(f"{time.monotonic() - began_s:.0f} s")
    figures = [{"cell": str(o.cell), "told": o.told, "wrong": o.wrong} for o in outcomes]
    return ended(wanted.json, figures, any(o.wrong for o in outcomes) or any(killed))


def complaint(outcome: Outcome) -> list[str]:
    """Say what went wrong in a cell."""
    step = outcome.cell.step
    words = f"at {step.kind} {step.what}: {'; '.join(outcome.wrong)} [{outcome.told}]"
    return [words] if outcome.wrong else []


def table(outcomes: Sequence[Outcome]) -> None:
    """Print cells and failures by fault and procedure."""
    works = list(dict.fromkeys(outcome.cell.work for outcome in outcomes))
    ran, failed = (
        Counter((o.cell.fault.name, o.cell.work) for o in outcomes if o.wrong or not only_wrong)
        for only_wrong in (False, True)
    )
    print(f"{'fault':16}" + "".join(f"{f'{w.name} {w.kind}':>21}" for w in works))
    for fault in FAULTS:
        if any(ran[fault.name, work] for work in works):
            row = [f"{failed[fault.name, w]} of {ran[fault.name, w]}" for w in works]
            print(f"{fault.name:16}" + "".join(f"{text:>21}" for text in row))
    print(f"{share(sum(bool(o.wrong) for o in outcomes), len(outcomes))} cells failed")


if __name__ == "__main__":
    sys.exit(main())
