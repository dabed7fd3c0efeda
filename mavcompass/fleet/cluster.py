"""The same work on an existing Dask cluster, with the same isolation of each recording."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from mavcompass.errors import LinkError
from mavcompass.fleet.child import DIED, TIMEOUT, Answer, Child, Failure
from mavcompass.fleet.pool import Task
from mavcompass.parts import require

_CONNECT_S = 10.0
# Tasks under way per thread of the cluster: enough to keep it busy, few enough for any number of recordings.
_AHEAD = 4
_own = threading.local()


def run_on_cluster(
    function: Callable[..., Any], tasks: Iterable[Task], scheduler: str, timeout_s: float
) -> Iterator[tuple[Task, Answer]]:
    """Yield each task with its answer, as `pool.run_in_processes`, computed by the workers of a cluster.

    Raises UsageError where Dask is not installed, LinkError where the scheduler does not answer.
    """
    distributed = _dask()
    waiting = iter(tasks)
    with _connect(distributed, scheduler) as client:
        under_way: dict[Any, Task] = {}
        done = distributed.as_completed(loop=client.loop, raise_errors=False)

        def submit_next() -> bool:
            task = next(waiting, None)
            if task is None:
                return False
            future = client.submit(isolated, function, task, timeout_s, pure=False)
            under_way[future.key] = task
            done.add(future)
            return True

        threads = sum(client.nthreads().values())
        for _ in range(_AHEAD * max(threads, 1)):
            if not submit_next():
                break
        while under_way:
            future = next(done)
            task = under_way.pop(future.key)
            answer = _answer(future)
            future.release()
            submit_next()
            yield task, answer


def isolated(function: Callable[..., Any], task: Task, timeout_s: float) -> Answer:
    """Do a task in a process of this thread's own, so that the cluster's worker survives whatever it is."""
    child: Child | None = getattr(_own, "child", None)
    if child is None:
        child = Child()
    _own.child = None  # until the answer shows that it is still of use
    child.give(function, task, timeout_s)
    answer = child.wait()
    if answer.failure is None or answer.failure.kind not in (DIED, TIMEOUT):
        _own.child = child
    return answer


def _answer(future: Any) -> Answer:
    if future.status == "finished":
        result = future.result()
        assert isinstance(result, Answer)
        return result
    error = future.exception() if future.status == "error" else None
    # The cluster's worker itself was lost, several times over, or the task was cancelled.
    return Answer(
        failure=Failure(type(error).__name__ if error else "Cancelled", str(error or future.status))
    )


def _dask() -> Any:
    require("A cluster (--scheduler)")
    import distributed

    return distributed


def _connect(distributed: Any, scheduler: str) -> Any:
    try:
        return distributed.Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise LinkError(
            f"No Dask scheduler answers at {scheduler} ({error}).",
            "Give the address that `dask scheduler` prints, e.g. tcp://192.168.1.5:8786.",
        ) from error
