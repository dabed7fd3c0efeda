"""Worker processes: a task done in one costs only itself, whatever becomes of it.

`child.Child` is one process and its owner's end of the line; `child.Children` are those that one owner
keeps, so that many tasks can be done at a time. `__main__` is what runs in the process.
"""

from mavcompass.workers.child import DIED, TIMEOUT, Answer, Child, Children, Failure

__all__ = ["DIED", "TIMEOUT", "Answer", "Child", "Children", "Failure"]
