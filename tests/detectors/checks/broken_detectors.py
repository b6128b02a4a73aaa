"""One good detector, and for every check one that differs from it in a single mistake."""

from __future__ import annotations

import gc
import random
import sys
import time

import gymnasium as gym
import numpy as np
import torch

from detectors import Detector
from usnet_env import Detection
from usnet_env.swarm import SwarmConfig, SwarmState, start


class Good(Detector):
    """Names the living UAVs whose velocity agrees most with what others do a step later; ties by chance."""

    def __init__(self, count=2, names=()):
        self.count = count
        self.names = names

    def scores(self, window):
        v = np.where(window.velocity_seen[..., None], window.velocity, 0.0).astype(float)
        return np.einsum("tic,tjc->ij", v[1:], v[:-1]).clip(0).sum(axis=0).round(6)

    def answer(self, window, scores):
        tie = self.rng.random(window.uavs)
        order = np.lexsort((tie, -np.where(window.alive, scores, -np.inf)))
        candidates = np.zeros(window.uavs, bool)
        candidates[order[: self.count]] = True
        return Detection(candidates & window.alive, scores)

    def detect(self, window):
        return self.answer(window, self.scores(window))


class StoresMore(Good):
    def __init__(self, count=2, names=()):
        super().__init__(count, names)
        self.extra = 1


class ChecksInConstructor(Good):
    def __init__(self, count=2):
        super().__init__(int(count))


class CopiesItsArgument(Good):
    def __init__(self, names=()):
        self.count = 2
        self.names = list(names)


class ChangesItsArgument(Good):
    def detect(self, window):
        self.count += 1
        return super().detect(window)


class FillsItsArgument(Good):
    """A mutable argument that grows."""

    def __init__(self, count=2, names=None):
        self.count = count
        self.names = names

    def reset(self, seed=None):
        super().reset(seed)
        if self.names is not None:
            self.names.append(seed)


class HidesAParameter(Good):
    def get_params(self, deep=True):
        return {"count": self.count}


class NoDetection(Good):
    def detect(self, window):
        return super().detect(window).candidates


class TooShort(Good):
    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates[1:], answer.scores[1:])


class NeedsASeed(Good):
    def reset(self, seed):
        super().reset(seed)


class NeedsFour(Good):
    def detect(self, window):
        assert window.uavs > 3, "too small a swarm"
        return super().detect(window)


class NeedsTwoClusters(Good):
    """Stands for detectors that need at least two clusters: the check of a single cluster has 16 UAVs."""

    def detect(self, window):
        if window.uavs == 16:
            raise ValueError("clusters must be at least 2")
        return super().detect(window)


class NamesTheDead(Good):
    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates | (~window.alive & (window.uavs == 20)), answer.scores)


class NeedsEverySample(Good):
    def detect(self, window):
        if not window.seen[:, window.alive].any(axis=1).all():
            raise ZeroDivisionError("a UAV was never seen")
        return super().detect(window)


class DividesByTheSpread(Good):
    def detect(self, window):
        with np.errstate(all="ignore"):
            return self.answer(window, self.scores(window) / window.velocity.std())


class ProbabilityAboveOne(Good):
    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates, answer.scores, extras={"probability": np.full(window.uavs, 1.5)})


class NoProbability(Good):
    """Not broken: ``Detection`` takes ``None`` for an answer without probabilities."""

    def detect(self, window):
        answer = super().detect(window)
        return Detection(answer.candidates, answer.scores, extras={"probability": None})


class LosesAWindow(Good):
    def detect_batch(self, windows):
        return [self.detect(window) for window in windows][:3]


class EmptiesTheList(Good):
    def detect_batch(self, windows):
        return [self.detect(windows.pop(0)) for _ in range(len(windows))]


class WritesIntoTheWindow(Good):
    def detect(self, window):
        answer = super().detect(window)
        window.velocity.setflags(write=True)
        window.velocity[0, 0] += 1.0
        return answer


class ReplacesAnArray(Good):
    def detect(self, window):
        object.__setattr__(window, "position", window.position * 2)
        return super().detect(window)


class OwnClockAsSeed(Good):
    def reset(self, seed=None):
        super().reset(time.perf_counter_ns())

    def detect(self, window):
        return self.answer(window, self.rng.random(window.uavs))


class Remembers(Good):
    """Scores of the episode before leak into the next."""

    def detect(self, window):
        before = getattr(self, "before", 0.0)
        self.before = before + 1.0
        return self.answer(window, self.scores(window) * (1.0 + before))


class FavoursLowIndices(Good):
    def answer(self, window, scores):
        candidates = np.zeros(window.uavs, bool)
        candidates[np.argsort(-np.where(window.alive, scores, -np.inf), kind="stable")[: self.count]] = True
        return Detection(candidates & window.alive, scores)


class NamesTheFirst(Good):
    """At random, but never from the second half."""

    def detect(self, window):
        return self.answer(window, self.rng.random(window.uavs) * (np.arange(window.uavs) < window.uavs / 2))


class CannotBePickled(Good):
    def reset(self, seed=None):
        super().reset(seed)
        self.score = lambda window: self.scores(window)


class ForgetsWhenPickled(Good):
    """The generator stays behind."""

    def __getstate__(self):
        return {"count": self.count, "names": self.names}

    def detect(self, window):
        self.rng = getattr(self, "rng", None) or np.random.default_rng(0)
        return self.answer(window, self.rng.random(window.uavs))

    def __deepcopy__(self, memo):
        return type(self)(self.count, self.names)


class DrawsFromNumPy(Good):
    def detect(self, window):
        np.random.random()  # noqa: NPY002
        return super().detect(window)


class DrawsFromPython(Good):
    def detect(self, window):
        random.random()
        return super().detect(window)


class SeedsTorch(Good):
    def reset(self, seed=None):
        super().reset(seed)
        torch.manual_seed(0)


class SetsThreads(Good):
    def detect(self, window):
        torch.set_num_threads(3)
        return super().detect(window)


class SilencesNumPy(Good):
    def detect(self, window):
        np.seterr(all="ignore")
        return super().detect(window)


class KeepsAnEnv(Good):
    """Looks up nothing, but could."""

    def reset(self, seed=None):
        super().reset(seed)
        self.tools = {"simulate": [gym.make("USNET/SingleCluster-v0").reset]}


class KeepsAState(Good):
    def __init__(self, count=2, names=()):
        self.count = count
        self.names = names

    def reset(self, seed=None):
        super().reset(seed)
        state = start(SwarmConfig(), [np.random.default_rng(0)])
        self.look = lambda: state.head


class SharesAGenerator(Good):
    generator = np.random.default_rng(0)


BITS = np.random.PCG64(0)


class SharesBits(Good):
    def reset(self, seed=None):
        super().reset(seed)
        self.more = np.random.Generator(BITS)


class KeepsTheGlobalGenerator(Good):
    def reset(self, seed=None):
        super().reset(seed)
        self.fallback = np.random.mtrand._rand


class LooksAtTheCaller(Good):
    """Searches the calling frames for the heads."""

    def detect(self, window):
        frame = sys._getframe()
        while frame is not None:
            for value in list(frame.f_locals.values()):
                if isinstance(value, SwarmState) and value.head.shape == (window.uavs,):
                    return Detection(value.head & window.alive, value.head)
            frame = frame.f_back
        return super().detect(window)


class SearchesMemory(Good):
    """Searches all that lives for a swarm of the right size."""

    def detect(self, window):
        gc.collect()  # swarms of other tests no longer live
        for value in gc.get_objects():
            if type(value) is SwarmState and value.head.shape == (window.uavs,):
                return Detection(value.head & window.alive, value.head)
        return super().detect(window)


class NeedsLessMemory(Good):
    def detect(self, window):
        if window.uavs > 200:
            raise MemoryError("Unable to allocate 1.2 TiB")
        return super().detect(window)


class Slow(Good):
    def detect(self, window):
        if window.uavs == 82:
            time.sleep(0.06)
        return super().detect(window)


class NoBase:
    """No base class, no parameters: it has the two methods, and that is enough."""

    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)

    def detect(self, window):
        return Detection(window.alive, window.alive)


class Fitted(Good):
    """Has learned something that its constructor doesn't know."""

    def fit(self):
        self.weights_ = np.ones(3)
        return self

    def scores(self, window):
        return super().scores(window) * self.weights_.sum()
