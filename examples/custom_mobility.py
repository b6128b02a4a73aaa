"""A custom mobility: heads that fly level circles.

python examples/custom_mobility.py
"""

import gymnasium as gym
import numpy as np

import usnet_env


def circling(rng: np.random.Generator, position: np.ndarray, steps: int, state: np.ndarray) -> np.ndarray:
    """Level circles of 5 to 20 m radius; each UAV has its own turn rate.

    Args:
        rng: the episode's generator; use no other source of random numbers.
        position: ``(n, 3)`` metres, the present positions of the n UAVs.
        steps: the number of steps to fly.
        state: ``(n, 8)``, zeros at first and kept between rounds: here the heading and the turn per step, in radians.

    Returns:
        ``(steps, n, 3)`` directions, which the simulator normalises to 1 m a step.
    """
    new = state[:, 1] == 0
    state[new, 0] = rng.uniform(-np.pi, np.pi, new.sum())
    state[new, 1] = rng.choice([-1, 1], new.sum()) * rng.uniform(0.05, 0.2, new.sum())
    heading = state[:, 0] + np.arange(1, steps + 1)[:, None] * state[:, 1]
    state[:, 0] = heading[-1]
    return np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)


usnet_env.register_mobility("circling", circling)

if __name__ == "__main__":
    env = gym.make("USNET/SingleCluster-v0", mobility="circling", observation_steps=200)
    observation, _ = env.reset(seed=0)
    head = int(np.flatnonzero(env.unwrapped.swarm.head)[0])  # the truth, which detectors never see
    track = observation["position"][:, head]
    print(
        f"The head, UAV {head}, stays within {np.ptp(track[:, :2], axis=0).max():.1f} m at {track[0, 2]:.0f} m height."
    )
