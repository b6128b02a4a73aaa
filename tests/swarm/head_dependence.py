"""How much of a follower's motion its head explains beyond its own past: a measure of a follow strategy."""

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
    """Shares of a follower's velocity variance that can be predicted on held-out steps.

    Args:
        with_head: from the head's past and the follower's own.
        without_head: from the follower's own past (velocities and position) alone.
    """

    with_head: float
    without_head: float

    @property
    def gain(self) -> float:
        """The increase by the head: near 0 for a strategy that does not depend on its head."""
        return self.with_head - self.without_head


def _explained_share(features: NDArray[np.float64], target: NDArray[np.float64]) -> float:
    """R² on the last third of the better of a linear model and a forest, both fitted on the first two thirds.

    R² is relative to zero, not to the mean: a straight track must count as predictable from the UAV's own past.
    """
    cut = 2 * len(features) // 3
    models = (RidgeCV(np.logspace(-3, 3, 7)), ExtraTreesRegressor(30, min_samples_leaf=3, random_state=0))
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
    """Measure how a follower's velocity depends on its head, in one cluster.

    Args:
        follow: the strategy, by name or as an object.
        rng: generator of the simulation.
        mobility: how the head moves; with ``"iid"`` the head's past does not predict its future, so any gain
            is due to the follow strategy.
        steps: number of simulated steps.
        followers: number of followers; the result is the mean over them.
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
        from_head = past[:, head].reshape(len(target), -1)
        with_head = np.concatenate([own, from_head, from_head**2, gap], axis=1)
        scores.append((_explained_share(with_head, target), _explained_share(own, target)))
    return HeadDependence(*(float(share) for share in np.mean(scores, axis=0)))
