"""Detectors with one mistake each; without it they would pass all checks."""

import sys
import time

import numpy as np

from detectors import Detector
from usnet_env import Detection


class Good(Detector):
    """Names the UAVs with the highest speeds; a mistake of a subclass is the only one."""

    count: int = 2

    def detect(self, window):
        speed = np.abs(np.where(window.velocity_seen[..., None], window.velocity, 0.0)).sum(axis=(0, 2))
        order = self.rng.permutation(window.uavs)
        best = order[np.argsort(-np.where(window.alive, speed, -1.0)[order], kind="stable")[: self.count]]
        return Detection(np.isin(np.arange(window.uavs), best) & window.alive, speed)


class StoresMore(Good):
    def __init__(self, count=2):
        self.count, self.extra = count, 1


class ChecksInConstructor(Good):
    def __init__(self, count=2):
        self.count = count + 0


class ChangesItsArgument(Good):
    def detect(self, window):
        self.count = 3
        return super().detect(window)


class NoDetection(Good):
    def detect(self, window):
        return super().detect(window).candidates


class TooShort(Good):
    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates[1:], answer.scores[1:])


class ClockAsSeed(Good):
    def reset(self, seed=None):
        super().reset(time.perf_counter_ns())

    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates, self.rng.random(window.uavs))


class Remembers(Good):
    past = 0

    def detect(self, window):
        self.past += 1
        answer = super().detect(window)
        return Detection(answer.candidates, answer.scores + self.past)


class DrawsFromNumPy(Good):
    def detect(self, window):
        sys.modules["numpy.random"].random()
        return super().detect(window)


class SeedsPython(Good):
    def detect(self, window):
        sys.modules["random"].seed(0)
        return super().detect(window)


class NeedsEverySample(Good):
    def detect(self, window):
        if not window.seen[:, window.alive].all():
            raise ValueError("a UAV was not always seen")
        return super().detect(window)


class NeedsFour(Good):
    def detect(self, window):
        if window.uavs < 4:
            raise IndexError("too small a swarm")
        return super().detect(window)


class NamesTheFirst(Good):
    def detect(self, window):
        candidates = np.arange(window.uavs) < self.count
        return Detection(candidates & window.alive, candidates)


class NamesTheDead(Good):
    def detect(self, window):
        return Detection(super().detect(window).candidates | ~window.alive, np.zeros(window.uavs))


class ForgetsWhenPickled(Good):
    def detect(self, window):
        return Detection(super().detect(window).candidates, self.rng.random(window.uavs))

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != "rng"}
