"""Detectors that look for the truth, change the referee, or end, stop or litter the process in which they run."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading

import gymnasium as gym
import numpy as np
from broken_detectors import Good

import usnet_env.objectives
from detectors.lagged import LaggedRegression
from usnet_env import Detection
from usnet_env.evaluation.episode import episode_seeds

# Looking for the truth


def find_heads(thing, uavs):
    """The heads of an environment of this many UAVs, however it is wrapped; None for anything else."""
    try:
        head = thing.unwrapped.swarm.head
    except Exception:
        return None
    return head if head.shape == (uavs,) else None


class Peeks(Good):
    """Names the heads of the first environment that it finds."""

    def list_things(self):
        return []

    def detect(self, window):
        for thing in self.list_things():
            head = find_heads(thing, window.uavs)
            if head is not None:
                return Detection(head & window.alive, head)
        return super().detect(window)


class PeeksIntoFrames(Peeks):
    """Through the local variables of its callers."""

    def list_things(self):
        frame = sys._getframe()
        while frame is not None:
            yield from list(frame.f_locals.values())
            frame = frame.f_back


class PeeksIntoMemory(Peeks):
    """Through the garbage collector, the newest first: other tests leave environments as well."""

    def list_things(self):
        newest_first = [thing for generation in range(3) for thing in reversed(gc.get_objects(generation))]
        return [thing for thing in newest_first if gym.Env in type(thing).__mro__]


class PeeksIntoModules(Peeks):
    """Through the global variables of all modules."""

    def list_things(self):
        for module in list(sys.modules.values()):
            yield from list(getattr(module, "__dict__", {}).values())


class PeeksIntoTheMainModule(Peeks):
    """Through the global variables of the script."""

    def list_things(self):
        return list(vars(sys.modules["__main__"]).values())


class PeeksWhereNothingIsChecked(PeeksIntoFrames):
    """Through the frames, but not in a process that has loaded the checks: no check can see this."""

    def list_things(self):
        return [] if "detectors.checks" in sys.modules else super().list_things()


# Searching seeds


def rebuild(swarm_seed, window):
    """The heads of the swarm with this seed, if it flies as in the window."""
    arguments = {"clusters": 4, "uavs": window.uavs, "observation_steps": window.observation_steps}
    for follow in ("f3", "f5"):
        env = gym.make("USNET/MultiCluster-v0", follow=follow, **arguments)
        observation, _ = env.reset(seed=swarm_seed)
        if np.allclose(observation["position"], window.position):
            return env.unwrapped.swarm.head
    return None


class SearchesItsSeed(Good):
    """Finds the seed of the evaluation by its own seed, and simulates the swarm again."""

    def reset(self, seed=None):
        super().reset(seed)
        self.seed = seed

    def search(self):
        pairs = [(seed, episode) for seed in (0, 2022) for episode in range(10)]
        return [swarm for swarm, own in (episode_seeds(*pair) for pair in pairs) if own == self.seed]

    def detect(self, window):
        if window.uavs == 20 and window.alive.all():
            for swarm in self.search():
                head = rebuild(swarm, window)
                if head is not None:
                    return Detection(head, head)
        return super().detect(window)


class SearchesSwarms(SearchesItsSeed):
    """Compares the window with the swarms of many seeds; its own seed is not needed."""

    def search(self):
        return [episode_seeds(0, episode)[0] for episode in range(6)]


# Changing the referee


class PatchesTheScore(Good):
    def detect(self, window):
        usnet_env.objectives.hits_and_redundant = lambda head, alive, fired: (head, head & ~head)
        return super().detect(window)


class PatchesCode(Good):
    """The function stays the same object; only its code is another."""

    def detect(self, window):
        usnet_env.objectives.hits_and_redundant.__code__ = (lambda head, alive, fired: (head, head)).__code__
        return super().detect(window)


class PatchesAnEnvironment(Good):
    def detect(self, window):
        gym.Wrapper.step = lambda self, action: (None, 1.0, True, False, {})
        return super().detect(window)


class PatchesARival(Good):
    def detect(self, window):
        LaggedRegression.detect = Good.detect
        return super().detect(window)


class PatchesNumPy(Good):
    def detect(self, window):
        np.count_nonzero = lambda *_, **__: 1
        return super().detect(window)


# Ending and stopping the process


class Ends(Good):
    """Ends or stops the process in the method ``where``."""

    def __init__(self, where="detect", how="exit", count=2, names=()):
        self.where = where
        self.how = how
        self.count = count
        self.names = names

    def end(self, where):
        if where != self.where:
            return
        if self.how == "exit":
            os._exit(0)
        if self.how == "sys.exit":
            sys.exit(0)
        if self.how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.how == "memory":
            self.large = bytearray(3_000_000_000)
        if self.how == "hang":
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            threading.Event().wait()

    def reset(self, seed=None):
        super().reset(seed)
        self.end("reset")

    def detect(self, window):
        self.end("detect")
        return super().detect(window)


class EndsInItsConstructor(Good):
    def __init__(self, count=2, names=()):
        os._exit(0)


class ExitsInItsConstructor(Good):
    def __init__(self, count=2, names=()):
        sys.exit("no licence")


# Littering the process


class StartsAThread(Good):
    stop = threading.Event()

    def __init__(self, daemon=False, count=2, names=()):
        self.daemon = daemon
        self.count = count
        self.names = names

    def detect(self, window):
        threading.Thread(target=self.stop.wait, name="lookout", daemon=self.daemon).start()
        return super().detect(window)


class Forks(Good):
    """Both processes return from ``detect``."""

    def detect(self, window):
        os.fork()
        return super().detect(window)


PROGRAMS = []


class StartsAProgram(Good):
    def detect(self, window):
        PROGRAMS.append(subprocess.Popen(["sleep", "1000"]))
        return super().detect(window)


FILES = []


class LeaksFiles(Good):
    def detect(self, window):
        FILES.append(os.open(os.devnull, os.O_RDONLY))
        return super().detect(window)


class SetsAVariable(Good):
    def detect(self, window):
        os.environ["USNET_TEST_VARIABLE"] = "set"
        return super().detect(window)


class IgnoresSignals(Good):
    def detect(self, window):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        return super().detect(window)


class ChangesTheFolder(Good):
    def detect(self, window):
        os.chdir("/")
        return super().detect(window)
