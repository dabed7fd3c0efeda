"""What runs in a worker process: `python -m mavcompass.workers SOCKET [MODULE]`, started by `child.Child`.

It takes (function, arguments) from the socket and sends back ("value", value) or ("error", kind, text,
error). MODULE is imported first, so that its functions are at hand when the first task comes.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import queue
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any

_OWNER_IS_GONE = 3
# The kernel that runs out of memory takes the process that a task has blown up, and nobody else's.
_TAKE_ME_FIRST = "800"


def main(descriptor: int, module: str | None = None) -> None:
    """Answer until the owner closes its end, then leave at once, whatever is under way."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write(_TAKE_ME_FIRST)
    line: Connection[Any, Any] = Connection(descriptor)
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(line, tasks), daemon=True).start()
    if module is not None:
        importlib.import_module(module)
    line.send("ready")
    while True:
        line.send_bytes(reply_to(tasks.get()))


def _listen(line: Connection[Any, Any], tasks: queue.SimpleQueue[bytes]) -> None:
    """Pass on tasks; end the process when the owner is gone, even in the middle of a task."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            tasks.put(line.recv_bytes())
    os._exit(_OWNER_IS_GONE)


def reply_to(task: bytes) -> bytes:
    """Do one task and return its pickled reply."""
    try:
        function, arguments = pickle.loads(task)
        return pickle.dumps(("value", function(*arguments)))
    except Exception as error:  # whatever it is, it costs only this task
        told = ("error", type(error).__name__, str(error))
        try:
            reply = pickle.dumps((*told, error))
            pickle.loads(reply)  # some errors can be written, but not read
        except Exception:
            reply = pickle.dumps((*told, None))
        return reply


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
