"""Tasks for child processes; in a module, so that these can import them."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

import numpy as np

from usnet_env.processes import limited


def play(task):
    """Do what the task names."""
    with limited(f"part {task}"):
        if task == "hang":
            while True:
                pass
        if task == "memory":
            return len(bytearray(3_000_000_000))
        if task == "little memory":
            return len(bytearray(20_000_000))
        if task == "exit":
            os._exit(0)
        if task == "sys.exit":
            sys.exit(0)
        if task == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if task == "fork":
            os.fork()
        if task == "print":
            print("printed by a task")
        if task == "thread":
            threading.Thread(target=time.sleep, args=(1000,), name="sleeper").start()
    return task if task != "raise" else {}[task]


def make_plain(how=""):
    """A function for a process that exchanges plain data."""
    if how:
        raise ZeroDivisionError("no function")
    return do_plain


class Bomb:
    """Writes a file where it is unpickled."""

    def __reduce__(self):
        return os.system, ("touch unpickled_in_the_parent",)


def do_plain(values, arrays):
    """Do what the values name; the connection is taken from the caller, as a malicious function would."""
    what = values["do"]
    connection = sys._getframe(1).f_locals.get("connection")
    if what == "send an object":
        connection.send(Bomb())
    elif what == "half an answer":
        os.write(connection.fileno(), (1000).to_bytes(4, "big") + b"half")
        time.sleep(1000)
    elif what == "stop":
        threading.Thread(target=lambda: (time.sleep(0.2), os.kill(os.getpid(), signal.SIGSTOP))).start()
        time.sleep(1)
    elif what == "close":
        connection.close()
    elif what == "fork and exit":
        if os.fork() == 0:
            time.sleep(3)
        os._exit(0)
    elif what in ("memory", "exit", "sys.exit", "kill", "hang"):
        if what == "sys.exit":
            sys.exit(3)
        play(what)
        return {}, {"made": np.ones(10**8)}
    elif what == "raise":
        raise KeyError(what)
    return {}, {"sum": arrays["a"].sum()} if "a" in arrays else {}
