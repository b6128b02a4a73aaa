"""From radar detections to leaders: a simulated swarm is tracked by Stone Soup, and a detector gets the tracks.

    pip install -e '.[tracker]'
    python examples/stone_soup_tracks.py

A radar sees the swarm as points without names: some UAVs are missed, places are noisy, and some points are false. Stone
Soup (https://stonesoup.readthedocs.io) joins the points to tracks, which have gaps, or end and go on under other names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stonesoup.base import Property
from stonesoup.buffered_generator import BufferedGenerator
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.reader import DetectionReader
from stonesoup.tracker.simple import MultiTargetTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater

import usnet_env  # noqa: F401  registers the environments
from usnet_env.tracks import Tracks, find_leaders

NOISE, DETECTED, FALSE = 0.2, 0.9, 2.0  # metres; probability; mean number of false points in a scan
BEGIN = datetime(2026, 1, 1)
Scans = list[tuple[datetime, set[Detection]]]


def scan(position: NDArray[np.float32], rng: np.random.Generator) -> Scans:
    """The points that a radar sees of positions ``(T + 1, N, 3)``, one scan a second.

    The true UAV of a point is in its metadata, which the tracker doesn't read; -1 is a false point.
    """
    model = LinearGaussian(ndim_state=6, mapping=(0, 2, 4), noise_covar=np.eye(3) * NOISE**2)
    low, high = position.min(axis=(0, 1)), position.max(axis=(0, 1))
    scans = []
    for t, places in enumerate(position):
        seen = np.flatnonzero(rng.random(len(places)) < DETECTED)
        false = rng.uniform(low, high, (rng.poisson(FALSE), 3))
        points = np.concatenate([places[seen] + rng.normal(0, NOISE, (len(seen), 3)), false])
        uavs, now = [*seen.tolist(), *[-1] * len(false)], BEGIN + timedelta(seconds=t)
        made = {
            Detection(point.reshape(3, 1), timestamp=now, measurement_model=model, metadata={"uav": uav})
            for point, uav in zip(points, uavs, strict=True)
        }
        scans.append((now, made))
    return scans


class Scans3D(DetectionReader):
    """The scans as Stone Soup reads them."""

    scans: Sequence[Any] = Property()

    @BufferedGenerator.generator_method
    def detections_gen(self) -> Iterator[tuple[datetime, set[Detection]]]:
        """The scans in the order of time."""
        yield from self.scans


def track(scans: Scans) -> list[Any]:
    """Join the points to tracks: a Kalman filter with nearly constant velocity, and global nearest neighbours."""
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1)] * 3))
    updater = KalmanUpdater(None)
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4))
    prior = GaussianState(np.zeros((6, 1)), np.diag([0.0, 1.0] * 3))
    initiator = MultiMeasurementInitiator(prior, UpdateTimeStepsDeleter(2), associator, updater, min_points=4)
    tracker = MultiTargetTracker(initiator, UpdateTimeStepsDeleter(3), Scans3D(scans), associator, updater)
    made: dict[str, Any] = {}
    for _, current in tracker:
        made |= {each.id: each for each in current}
    return list(made.values())


def true_uavs(one: Any) -> list[int]:
    """The true UAV of each point of a track."""
    return [state.hypothesis.measurement.metadata["uav"] for state in one if isinstance(state, Update)]


def count_switches(made: Sequence[Any]) -> int:
    """How often the points of a UAV go on in another track."""
    points = sorted(
        (state.timestamp, uav, k)
        for k, one in enumerate(made)
        for state, uav in zip((each for each in one if isinstance(each, Update)), true_uavs(one), strict=True)
    )
    names: dict[int, list[int]] = {}
    for _, uav, k in points:
        names.setdefault(uav, []).append(k)
    return sum(a != b for uav, own in names.items() if uav >= 0 for a, b in pairwise(own))


def to_tracks(made: Sequence[Any]) -> Tracks:
    """The tracks where they have points, under the names T0, T1 and so on."""
    ids, time, place = [], [], []
    for k, one in enumerate(made):
        states = {state.timestamp: state for state in one if isinstance(state, Update)}
        ids += [f"T{k}"] * len(states)
        time += [(when - BEGIN).total_seconds() for when in states]
        place += [np.ravel(state.state_vector[[0, 2, 4]]).astype(float) for state in states.values()]
    return Tracks.from_samples(ids, time, np.array(place))


def main(seed: int = 0) -> None:
    """Simulate, scan, track, and name the leaders."""
    env = gym.make(
        "USNET/MultiCluster-v0", clusters=2, uavs=20, follow="f2", mobility="gauss_markov", formation="around",
        observation_steps=200, reveal_truth=True,
    )  # fmt: skip
    observation, info = env.reset(seed=seed)
    scans = scan(observation["position"], np.random.default_rng(seed))
    made = track(scans)
    usual = [Counter(true_uavs(each)).most_common(1)[0][0] for each in made]
    points = sum(len(each) for _, each in scans)
    print(f"{points} points of {len(info['head'])} UAVs gave {len(made)} tracks; ", end="")
    print(f"the points of a UAV go on in another track {count_switches(made)} times.")
    tracks = to_tracks(made)
    print(tracks.report())
    found = find_leaders(tracks.resample(1.0, max_gap=4.0), "lagged-regression", length=100)
    for window in found.windows:
        named = [f"{leader.id} (UAV {usual[int(leader.id[1:])]})" for leader in window.leaders]
        print(f"{window.start:g} to {window.end:g} s: {', '.join(named) or 'no leader'}")
    print("The heads are the UAVs", np.flatnonzero(info["head"]).tolist())


if __name__ == "__main__":
    main()
