"""Small real detectors, policies and a suite for these tests; in a module, so that worker processes can import them."""

import os
import signal
import time

import numpy as np

from usnet_env import Detection, Window

SUITE = """
version: 2
purpose: A test.
episodes: 2
seed: 4711
tuning_seed: 7
arguments: {clusters: 2, uavs: 12, observation_steps: 20, max_rounds: 3}
cells:
  plain:
  run.json: {follow: f4}
"""


def untimed(result):
    """The rows without the seconds, which differ from run to run."""
    return result.rows.drop(columns="seconds_per_round")


class Base:
    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)


class AllAlive(Base):
    def detect(self, window):
        return Detection(window.alive, window.alive)


class NoUav(Base):
    def detect(self, window):
        return Detection(np.zeros(window.uavs), np.zeros(window.uavs))


class RandomThird(Base):
    """Names about a third of the living UAVs, drawn with its own generator."""

    def detect(self, window):
        scores = self.rng.random(window.uavs)
        return Detection((scores > 0.67) & window.alive, scores)


class Followed(Base):
    """Names the UAVs whose velocity most others repeat one step later; exact for f1 without observation noise."""

    def __init__(self, clusters=3):
        self.clusters = clusters

    def detect(self, window):
        v = np.asarray(window.velocity, float)
        v = np.where(window.velocity_seen[..., None], v, 0.0)
        agreement = np.einsum("tic,tjc->ij", v[1:], v[:-1])  # row i repeats column j
        np.fill_diagonal(agreement, -np.inf)
        agreement[:, ~window.alive] = -np.inf
        votes = np.bincount(agreement.argmax(axis=1)[window.alive], minlength=window.uavs)
        candidates = np.zeros(window.uavs, bool)
        candidates[np.argsort(-votes)[: self.clusters]] = True
        leader = np.where(candidates, np.arange(window.uavs), agreement.argmax(axis=1))
        return Detection(candidates & (votes > 0), votes, clusters=leader)


class Recorder(Base):
    """Keeps the first windows and its seeds, and names all living UAVs."""

    def __init__(self):
        self.seeds, self.windows = [], []

    def reset(self, seed=None):
        self.seeds.append(seed)

    def detect(self, window):
        assert isinstance(window, Window)
        if window.round == 1:
            self.windows.append(window)
        return Detection(window.alive, window.alive)

    def __deepcopy__(self, memo):
        return Recorder()


class Answering(Base):
    """A detector that returns what its arguments say, or raises it."""

    def __init__(self, answer):
        self.answer = answer

    def detect(self, window):
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


class FailingWithOne(Base):
    """Raises in every round, in worker processes as well as in this one."""

    def detect(self, window):
        raise ZeroDivisionError("no luck")


ENDS = {
    "os._exit": lambda: os._exit(0),
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "hang": lambda: time.sleep(10_000),
    "memory": lambda: np.ones(500_000_000),
}


class Ending(AllAlive):
    """Ends its process, hangs, or takes too much of something in the second round of an episode, or in its warm-up."""

    def __init__(self, how="os._exit", first=False):
        self.how = how
        self.first = first

    def detect(self, window):
        if window.round == 1 and not self.first:
            return Detection(np.zeros(window.uavs), np.zeros(window.uavs))
        ENDS[self.how]()
        return super().detect(window)


class Slow(RandomThird):
    """Takes a twentieth of a second for each round, so that a run can be ended in its middle."""

    def detect(self, window):
        time.sleep(0.05)
        return super().detect(window)
