"""Run functions on tasks: here, in child processes with limits of time and memory, or on a Ray cluster.

The three backends have the same methods (:class:`Backend`); :func:`make_backend` makes one by name.

A :class:`ProcessPool` starts its processes anew (they inherit no memory), gives each task to one of them, and yields
the outcomes as they come. A child process that ends before its task is finished does not end the run: the outcome of
that task is a :class:`ProcessDied` with the reason, and a new process takes the other tasks.

A child process never outlives its parent: it ends with the parent, whatever ended the parent. The pool kills its
processes when it is closed, so nothing waits for a task that hangs.

A :class:`PlainProcess` calls a function that is not trusted: the two processes exchange data, and never objects.

Inside a task, :func:`limited` marks the part to which the limits apply, such as one answer of a detector::

    def play(seed):                      # in a module
        with limited("round 1"):
            return detector.detect(window)

    with ProcessPool(play, workers=2, limits=Limits(seconds=60, megabytes=2000)) as pool:
        for outcome in pool.run(range(10)):
            print(outcome.task, outcome.result or outcome.error)
"""

from usnet_env.processes.backends import BACKENDS, InProcess, check_backend, make_backend
from usnet_env.processes.frames import describe_place, find_frame, is_installed
from usnet_env.processes.limits import Limits, ProcessDied, limited
from usnet_env.processes.outcome import Backend, Outcome
from usnet_env.processes.parent import SendError
from usnet_env.processes.plain import Arrays, PlainError, PlainFunction, PlainProcess
from usnet_env.processes.pool import ProcessPool
from usnet_env.processes.ray_pool import RayPool

__all__ = [
    "BACKENDS",
    "Arrays",
    "Backend",
    "InProcess",
    "Limits",
    "Outcome",
    "PlainError",
    "PlainFunction",
    "PlainProcess",
    "ProcessDied",
    "ProcessPool",
    "RayPool",
    "SendError",
    "check_backend",
    "describe_place",
    "find_frame",
    "is_installed",
    "limited",
    "make_backend",
]
