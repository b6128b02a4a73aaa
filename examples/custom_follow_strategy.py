"""A custom follow strategy: define it, register it, and see which detectors find the heads.

python examples/custom_follow_strategy.py
"""

import numpy as np

import usnet_env
from usnet_env.swarm import FollowInputs


def turned(inputs: FollowInputs) -> np.ndarray:
    """Fly where the head flew two steps ago, turned by 90 degrees about the vertical axis.

    ``inputs.head_velocity`` is ``(n, T_0, 3)``, newest first: index 1 is v_{iL,t-1}. The simulator
    adds noise and normalises the result.
    """
    x, y, z = inputs.head_velocity[:, 1].T
    return np.stack([-y, x, z], axis=1)


usnet_env.register_follow_strategy("turned", turned, lags=2, equation="v_{i,t+1} = norm(R_z(90°) v_{iL,t-1} + κ_n n)")

if __name__ == "__main__":
    result = usnet_env.evaluate(
        "USNET/MultiCluster-v0",
        ["lagged-regression(clusters=3)", "lagged-correlation(clusters=3)", "random(count=3)"],
        episodes=5,
        env_kwargs={"follow": "turned", "clusters": 3, "uavs": 40},
    )
    for entry in result.summary:
        recall = entry["metrics"]["recall_first"]
        print(f"{entry['detector']:32} heads found in round 1: {recall['mean']:.0%}")
