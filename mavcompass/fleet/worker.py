"""The process that examines recordings: `python -m mavcompass.fleet.worker`, started by `child.Child`.

It reads pickled (function, arguments) from standard input and writes pickled replies to what was its
standard output; nothing else may import heavily here, so that it can set itself up first.
"""

from __future__ import annotations

import os
import pickle
import queue
import struct
import threading
from typing import Any

LENGTH = struct.Struct("<Q")
READY = ("ready", None)
_PARENT_IS_GONE = 3
# The kernel that runs out of memory takes the process that a recording has blown up, and nobody else's.
_TAKE_ME_FIRST = "800"


def main() -> None:
    """Answer until the parent closes its end, then leave at once, whatever is under way."""
    replies = os.dup(1)
    os.dup2(2, 1)  # a library that prints must not speak into the replies
    try:
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write(_TAKE_ME_FIRST)
    except OSError:
        pass
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    _write(replies, pickle.dumps(READY))
    while True:
        _write(replies, answer(tasks.get()))


def _listen(tasks: queue.SimpleQueue[bytes]) -> None:
    """Pass on tasks; end the process when the parent is gone, even in the middle of a recording."""
    with os.fdopen(0, "rb", closefd=False) as source:
        while len(head := source.read(LENGTH.size)) == LENGTH.size:
            tasks.put(source.read(LENGTH.unpack(head)[0]))
    os._exit(_PARENT_IS_GONE)


def answer(task: bytes) -> bytes:
    """Do one task and return its pickled reply: ("value", value) or ("failure", (kind, text))."""
    reply: tuple[str, Any]
    try:
        function, arguments = pickle.loads(task)
        reply = ("value", function(*arguments))
        return pickle.dumps(reply)
    except Exception as error:  # whatever it is, it costs only this task
        return pickle.dumps(("failure", (type(error).__name__, str(error))))


def _write(descriptor: int, content: bytes) -> None:
    rest = memoryview(LENGTH.pack(len(content)) + content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


if __name__ == "__main__":
    main()
