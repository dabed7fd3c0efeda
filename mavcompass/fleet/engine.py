"""Who does the work: processes of this machine, or the workers of a Dask cluster with a process each.

Both are an executor of `concurrent.futures` here: threads that mind one process each, or the cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mavcompass.errors import LinkError, MavCompassError
from mavcompass.installation.parts import require
from mavcompass.workers import Answer, Children, Failure
from mavcompass.workers.child import Task

_CONNECT_S = 10.0
_LOOK_UP_S = 1.0
# Tasks under way per thread of the cluster: enough to keep it busy, few enough for any number of recordings.
_AHEAD = 4
# Of a worker of a cluster, which serves many clients and threads.
_of_this_process = Children()

Function = Callable[..., Any]
UnderWay = Callable[[list[tuple[Task, float]]], None]


@dataclass(frozen=True, slots=True)
class Engine:
    """Say who does the work: `workers` processes of this machine, or a Dask cluster's `scheduler`."""

    workers: int = 1
    scheduler: str | None = None
    timeout_s: float = 600.0

    def run(
        self, function: Function, tasks: Iterable[Task], on_wait: UnderWay = lambda _: None
    ) -> Iterator[tuple[Task, Answer]]:
        """Yield each task, its arguments, with its answer, as they are done.

        `on_wait` is told, at least once a second, which tasks are under way on this machine and for how long,
        the longest first; a cluster does not tell. A process that dies or is over its time is replaced, and
        costs only its task. When the iterator is closed, or an error or an interrupt passes through it, the
        processes end at once. Raises UsageError where Dask is not installed, LinkError where the scheduler
        does not answer.
        """
        if self.scheduler is None:
            # The children end first, so that no thread waits for one.
            with ThreadPoolExecutor(self.workers) as threads, Children() as children:

                def submit(task: Task) -> Future[Answer]:
                    return threads.submit(children.do, function, task, self.timeout_s)

                yield from _answers(submit, tasks, self.workers, lambda: on_wait(children.under_way()))
        else:
            with _cluster(self.scheduler) as client:
                executor = client.get_executor(pure=False)

                def submit(task: Task) -> Future[Answer]:
                    return executor.submit(isolated, function, task, self.timeout_s)

                ahead = _AHEAD * max(sum(client.nthreads().values()), 1)
                yield from _answers(submit, tasks, ahead, lambda: on_wait([]))


def _answers(
    submit: Callable[[Task], Future[Answer]], tasks: Iterable[Task], ahead: int, on_wait: Callable[[], None]
) -> Iterator[tuple[Task, Answer]]:
    waiting = iter(tasks)
    under_way: dict[Future[Answer], Task] = {}

    def submit_more() -> None:
        while len(under_way) < ahead and (task := next(waiting, None)) is not None:
            under_way[submit(task)] = task

    submit_more()
    while under_way:
        done = wait(under_way, _LOOK_UP_S, FIRST_COMPLETED).done
        answered = [(under_way.pop(future), future) for future in done]
        submit_more()
        on_wait()
        for task, future in answered:
            yield task, _answer(future)


def _answer(future: Future[Answer]) -> Answer:
    error = future.exception()
    if isinstance(error, MavCompassError):  # no process can begin on this machine
        raise error
    if error is not None:  # the cluster's worker itself was lost, several times over
        return Answer(failure=Failure(type(error).__name__, str(error)))
    return future.result()


@contextmanager
def _cluster(scheduler: str) -> Iterator[Any]:
    """Hold a client of a cluster, whose workers keep no processes of ours afterwards."""
    require("A cluster (--scheduler)")
    import distributed

    connect: Any = distributed.Client
    try:
        client = connect(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise LinkError(
            f"No Dask scheduler answers at {scheduler} ({error}).",
            "Give the address that `dask scheduler` prints, e.g. tcp://192.168.1.5:8786.",
        ) from error
    with client:
        try:
            yield client
        finally:
            if client.status == "running":
                client.run(end_idle)


def isolated(function: Function, task: Task, timeout_s: float) -> Answer:
    """Do a task in a process of this worker's, so that the cluster's worker survives whatever it is."""
    try:
        return _of_this_process.do(function, task, timeout_s)
    except MavCompassError as error:  # this machine of the cluster cannot; others may
        return Answer(failure=Failure(type(error).__name__, str(error)))


def end_idle() -> None:
    """End the processes that wait for the next task on this worker of a cluster."""
    _of_this_process.end_idle()
