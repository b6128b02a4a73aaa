"""How the examples score what they have trained: beside detectors, on swarms that nobody was trained on."""

from collections.abc import Mapping
from typing import Any

import usnet_env


def compared(env: str, arguments: Mapping[str, Any], detectors: Mapping[str, Any], episodes: int) -> dict[str, Any]:
    """Let detectors play the same episodes and print a line for each.

    Args:
        env: id of the environment.
        arguments: its arguments.
        detectors: detectors, or names of detectors, each under the name for its line.
        episodes: how many each plays.

    Returns:
        The metrics, by the names of ``detectors``.
    """
    result = usnet_env.evaluate(env, list(detectors.values()), episodes=episodes, seed=2022, env_kwargs=arguments)
    metrics = {name: entry["metrics"] for name, entry in zip(detectors, result.summary, strict=True)}
    for name, own in metrics.items():
        print(f"{name:20} F1 of round 1: {own['f1_first']['mean']:.2f}   J: {own['J']['mean']:.2f}")
    return metrics
