"""A wrapper that writes the episodes of an environment as episode files, used like Gymnasium's ``RecordVideo``."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from usnet_env.config import ArgumentError, plain_text, quote
from usnet_env.detection import Detection
from usnet_env.envs.play import PlayedRound
from usnet_env.files import as_path
from usnet_env.replay.play import check_environment, make_record
from usnet_env.swarm import SwarmState


class RecordReplay(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Write episodes as episode files, from which replays and pictures are made.

    An episode is written when it ends, or with the rounds that were played when :meth:`reset` or :meth:`close` is
    called before. Its answers are the actions alone, unless :meth:`note` is called with the detection before each step.

    Args:
        env: an environment of this project; wrappers below must keep the form of observations and actions.
        folder: where to; the files are ``episode-0.npz``, ``episode-1.npz``, … Files of these names are replaced, and a
            warning says so.
        trigger: whether to write an episode, given its number from 0; ``None``: every episode.
        label: name of the agent in the files.

    Raises:
        ArgumentError: ``env`` is no environment of this project, or another argument has another type.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        folder: str | os.PathLike[str],
        trigger: Callable[[int], bool] | None = None,
        *,
        label: str = "agent",
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, folder=folder, trigger=trigger, label=label)
        check_environment(env)
        if trigger is not None and not callable(trigger):
            raise ArgumentError(f"trigger must be a function or None, got {quote(trigger)}.")
        super().__init__(env)
        self.folder = as_path("folder", folder)
        if any(self.folder.glob("episode-*.npz")):
            warnings.warn(
                f"folder {str(self.folder)!r} holds episode files, and those of the same number will be replaced.",
                stacklevel=2,
            )
        self._trigger = trigger
        self._label = plain_text("label", label)
        self._episode = -1
        self._seed: int | None = None
        self._wanted = False
        self._observation: Any = None
        self._noted: Detection | None = None
        self._rounds: list[PlayedRound[Detection]] = []
        self._seconds: list[float] = []
        self._began = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        self._write()
        self._observation, info = self.env.reset(seed=seed, options=options)
        self._episode, self._seed = self._episode + 1, seed
        self._wanted = self._trigger is None or bool(self._trigger(self._episode))
        self._noted = None
        self._began = time.perf_counter()
        return self._observation, info

    def note(self, detection: Detection) -> None:
        """Keep the detection from which the next action is made: its scores, clusters, leaders and the rest."""
        self._noted = detection

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Play a round; write the episode if it is the last one."""
        spent = time.perf_counter() - self._began
        game: Any = self.env.unwrapped
        truth: SwarmState = game.swarm
        following, reward, terminated, truncated, info = self.env.step(action)
        if self._wanted:
            candidates = np.asarray(action, bool).reshape(truth.alive.shape)
            noted = self._noted or Detection(candidates, candidates.astype(np.float64))
            answer = replace(noted, candidates=candidates)
            self._rounds.append(PlayedRound(self._observation, truth, answer, info, game.swarm))
            self._seconds.append(spent)
            if terminated or truncated:
                self._write()
        self._observation, self._noted = following, None
        self._began = time.perf_counter()
        return following, reward, bool(terminated), bool(truncated), info

    def close(self) -> None:
        """Write what was played, and close the environment."""
        self._write()
        super().close()

    def _write(self) -> None:
        """Write the rounds that were played since the last call, if there are any."""
        if self._rounds:
            record = make_record(self.env, self._rounds, self._seconds, self._seed, None, self._label)
            record.save(self.folder / f"episode-{self._episode}.npz")
        self._rounds, self._seconds = [], []
