"""How much of a follower's motion its head explains beyond its own past: a measure of a follow strategy."""

import numpy as np
from flights import flown, fly
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import RidgeCV


def explained_share(features, target):
    """R² on the last third of the better of a linear model and a forest, both fitted on the first two thirds.

    R² is relative to zero, not to the mean: a straight track must count as predictable from the UAV's own past.
    """
    cut = 2 * len(features) // 3
    models = (RidgeCV(np.logspace(-3, 3, 7)), ExtraTreesRegressor(30, min_samples_leaf=3, random_state=0))
    errors = [target[cut:] - model.fit(features[:cut], target[:cut]).predict(features[cut:]) for model in models]
    return max(1.0 - float((error**2).sum() / (target[cut:] ** 2).sum()) for error in errors)


def head_dependence(follow, seed, steps=600, followers=4, lags=4):
    """The mean share of a follower's velocity variance that is explained with its head's past, and without it.

    The heads fly by ``iid``: a head's past doesn't predict its future, so any gain is due to the follow strategy.
    """
    arguments = {"memory": lags, "clusters": 1, "uavs": followers + 1, "observation_steps": steps}
    state, window = fly(follow, seed=seed, **arguments)
    v, p = flown(window)
    past = np.stack([v[lags - 1 - lag : len(v) - 1 - lag] for lag in range(lags)], axis=2)
    head = int(np.flatnonzero(state.head)[0])
    shares = []
    for i in np.flatnonzero(~state.head):
        target = v[lags:, i]
        own = np.concatenate([past[:, i].reshape(len(target), -1), p[lags:-1, i]], axis=1)
        led = past[:, head].reshape(len(target), -1)
        gap = (p[lags:-1, head] - p[lags:-1, i]) / 100.0
        with_head = np.concatenate([own, led, led**2, gap], axis=1)
        shares.append((explained_share(with_head, target), explained_share(own, target)))
    return np.mean(shares, axis=0)
