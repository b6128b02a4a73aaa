"""Play the episodes of a run in one process: this one, or another one to which the player is sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import gymnasium as gym

from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.environments import make_environment
from usnet_env.evaluation.episode import Row, detector_error, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.processes import Limits, PlainError, ProcessDied


class Task(NamedTuple):
    """An episode that a contestant is to play.

    Args:
        label: of the contestant.
        episode: number of the episode; ``None``: the contestant is only made and warmed up.
        seeds: of the swarm and of the detector; without an episode, those of episode 0.
    """

    label: str
    episode: int | None
    seeds: tuple[int, int]


class Player(Protocol):
    """Plays the episodes of a run; sent to another process, it creates there what it needs, at its first task."""

    def run_task(self, task: Task) -> Row | None:
        """Play one episode with one contestant; ``None`` if the contestant was only prepared."""

    def close(self) -> None:
        """End the processes of the contestants."""


@dataclass
class Worker:
    """Plays episodes with detectors. Each agent is created and warmed up before its first episode.

    Args:
        env_id: id of the environment; a module before the id is imported in each process.
        env_kwargs: arguments of the environment.
        detectors: names of detectors as :func:`usnet_env.make_detector` takes them, or objects, by their labels.
        isolation: limits of each answer of a detector in a process of its own; ``None``: it runs in this process.
        env: the environment of this process; other processes create their own.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    detectors: dict[str, Any]
    isolation: Limits | None = None
    env: gym.Env[Any, Any] | None = None
    _agents: dict[str, Agent] = field(default_factory=dict)
    _starting: dict[str, IsolatedAgent] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"env": None, "_agents": {}, "_starting": {}}

    def run_task(self, task: Task) -> Row | None:
        """Play one episode with one contestant; ``None`` if the contestant was only prepared.

        Raises:
            EvaluationError: the contestant failed.
            ArgumentError: the contestant refused one of its arguments.
        """
        label, episode, seeds = task
        if self.env is None:
            self.env = make_environment(self.env_id, self.env_kwargs)
        agent = self.find_agent(self.env, label, seeds[0])
        return None if episode is None else play_episode(self.env, agent, label, episode, seeds)

    def find_agent(self, env: gym.Env[Any, Any], label: str, swarm_seed: int) -> Agent:
        """The agent of a detector; a new one first answers a window of the environment with this seed.

        Raises:
            EvaluationError, ArgumentError: as :meth:`run_task`.
        """
        if label not in self._agents:
            agent = as_agent(self.detectors[label]) if self.isolation is None else self._isolate(label, self.isolation)
            warm_up(env, agent, label, swarm_seed)
            self._agents[label] = agent
        return self._agents[label]

    def _isolate(self, label: str, limits: Limits) -> Agent:
        """Create an agent in its own process; at first all those processes are started, so that they load together."""
        if not self._starting:
            for each, detector in self.detectors.items():
                self._starting[each] = IsolatedAgent(detector, limits)
        try:
            self._starting[label].start()
        except (PlainError, ProcessDied) as error:
            raise detector_error(label, "its constructor", error) from error
        return self._starting[label]

    def close(self) -> None:
        """End the processes of the agents."""
        for agent in self._starting.values():
            agent.close()


def as_failure(task: Task, error: BaseException) -> BaseException:
    """The failure of a contestant by what ended its task; errors of arguments and of starting a process are raised."""
    own = error.started if isinstance(error, EvaluationError) else isinstance(error, ProcessDied)
    if isinstance(error, Exception) and not own:
        raise error
    where = "its warm-up" if task.episode is None else f"episode {task.episode}"
    return error if isinstance(error, EvaluationError) else detector_error(task.label, where, error)
