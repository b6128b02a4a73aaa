"""Does a follow strategy really follow? How much of a follower's motion its head explains, and its own past does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import RidgeCV

from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.follow import FollowStrategy
from usnet_env.swarm.simulator import advance, start

__all__ = ["HeadDependence", "head_dependence"]


@dataclass(frozen=True)
class HeadDependence:
    """Held-out shares of a follower's velocity variance that can be predicted.

    Args:
        with_head: from the head's past and the follower's own.
        without_head: from the follower's own past (velocities and position) alone.
    """

    with_head: float
    without_head: float

    @property
    def gain(self) -> float:
        """What the head adds: near 0 for a strategy that does not look at its head."""
        return self.with_head - self.without_head


def _explained(features: NDArray[np.float64], target: NDArray[np.float64]) -> float:
    """R² on the later third, of the better of a linear model and a forest fitted on the earlier two thirds.

    R² is against zero, not the mean: a UAV that flies straight is predicted by its own past, and that must show.
    """
    cut = 2 * len(features) // 3
    models = (RidgeCV(np.logspace(-3, 3, 7)), ExtraTreesRegressor(100, min_samples_leaf=3, random_state=0))
    shares = []
    for model in models:
        error = target[cut:] - model.fit(features[:cut], target[:cut]).predict(features[cut:])
        shares.append(1.0 - float((error**2).sum() / (target[cut:] ** 2).sum()))
    return max(shares)


def head_dependence(
    follow: str | FollowStrategy,
    rng: np.random.Generator,
    *,
    mobility: str = "iid",
    steps: int = 600,
    followers: int = 4,
) -> HeadDependence:
    """Measure on one cluster how a follower's velocity depends on its head.

    Args:
        follow: the strategy, by name or itself.
        rng: seeds the flight.
        mobility: how the head moves; with ``"iid"`` its past says nothing about its future, so any gain is following.
        steps: length of the flight.
        followers: followers in the cluster; the mean over them is returned.
    """
    config = SwarmConfig(
        follow=follow, mobility=mobility, clusters=1, uavs=followers + 1, observation_steps=steps, formation="uniform"
    )
    state = start(config, [rng])
    _, window = advance(config, state, [rng])
    velocity, position = window.velocity[0].astype(float), window.position[0].astype(float)
    lags = 4
    past = np.stack([velocity[lags - 1 - lag : len(velocity) - 1 - lag] for lag in range(lags)], axis=2)
    head = int(np.flatnonzero(state.head[0])[0])
    scores = []
    for i in range(followers + 1):
        if i == head:
            continue
        target = velocity[lags:, i]
        own = np.concatenate([past[:, i].reshape(len(target), -1), position[lags:-1, i]], axis=1)
        gap = (position[lags:-1, head] - position[lags:-1, i]) / 100.0
        led = past[:, head].reshape(len(target), -1)
        scores.append((_explained(np.concatenate([own, led, led**2, gap], axis=1), target), _explained(own, target)))
    with_head, without_head = np.mean(scores, axis=0)
    return HeadDependence(float(with_head), float(without_head))
