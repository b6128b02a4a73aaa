"""Compare a trained agent with detectors, on swarms that the agent was not trained on."""

from collections.abc import Mapping, Sequence
from typing import Any

import usnet_env


def compare_with_regression(
    env: str, swarms: Sequence[Mapping[str, Any]], names: tuple[str, str], trained: Any, episodes: int
) -> None:
    """Compare a trained detector with ``lagged-regression``, on swarms of several sizes; ``names`` are to print."""
    for swarm in swarms:
        print(f"{swarm['uavs']} UAVs in {swarm['clusters']} clusters")
        regression = f"lagged-regression(clusters={swarm['clusters']})"
        compare_detectors(env, swarm, dict(zip(names, (trained, regression), strict=True)), episodes)


def compare_detectors(
    env: str, arguments: Mapping[str, Any], detectors: Mapping[str, Any], episodes: int
) -> dict[str, Any]:
    """Let detectors play the same episodes and print one line for each.

    Args:
        env: id of the environment.
        arguments: its arguments.
        detectors: detectors or names of detectors; the keys are the names to print.
        episodes: the number of episodes for each detector.

    Returns:
        The metrics, by the keys of ``detectors``.
    """
    result = usnet_env.evaluate(env, list(detectors.values()), episodes=episodes, seed=2022, env_kwargs=arguments)
    metrics = {name: entry["metrics"] for name, entry in zip(detectors, result.summary, strict=True)}
    for name, own in metrics.items():
        print(f"{name:20} F1 of round 1: {own['f1_first']['mean']:.2f}   J: {own['J']['mean']:.2f}")
    return metrics
