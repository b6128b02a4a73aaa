"""The learning curve of a training by PPO."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback


class Curve(BaseCallback):
    """A row for every batch of steps: the means over the games that ended in it.

    Args:
        match: what every row begins with.
        measure: returns the values of a game whose means are kept, from its last ``info``.
    """

    def __init__(self, match: Mapping[str, Any], measure: Callable[[Mapping[str, Any]], Mapping[str, float]]) -> None:
        super().__init__()
        self.match, self.measure = match, measure
        self.rows, self.ended = [], []

    def _on_step(self) -> bool:
        infos = zip(self.locals["infos"], self.locals["dones"], strict=True)
        self.ended += [self.measure(info) for info, done in infos if done]
        return True

    def _on_rollout_end(self) -> None:
        means = {name: round(float(np.mean([one[name] for one in self.ended])), 4) for name in self.ended[0]}
        self.rows.append({**self.match, "steps": self.num_timesteps, "games": len(self.ended), **means})
        print(self.rows[-1], flush=True)
        self.ended = []
