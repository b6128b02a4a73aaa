"""Tasks for child processes; in a module, so that these can import them."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

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
