"""Play the episodes of a run in one process: this one, or another one that gets a plan of the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.environments import find_environment, make_environment
from usnet_env.evaluation.episode import Row, detector_error, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.evaluation.parts import Part, register_parts, registered_parts
from usnet_env.plugins import make_detector
from usnet_env.processes import Limits, Outcome, PlainError, ProcessDied

#: In place of an episode: only create the agent and warm it up.
PREPARE = -1


class Task(NamedTuple):
    """An episode that a contestant is to play.

    Args:
        episode: number of the episode, or :data:`PREPARE`.
        contestant: index of the contestant.
        seeds: of the swarm and of the detector; those of episode 0 for :data:`PREPARE`.
    """

    episode: int
    contestant: int
    seeds: tuple[int, int]


@dataclass(frozen=True)
class Contestant:
    """A detector or policy that takes part in an evaluation.

    Args:
        label: its name in rows and tables.
        detector: a name as :func:`usnet_env.make_detector` takes it, or the object itself.
        identity: what distinguishes it from others, as plain values.
    """

    label: str
    detector: Any
    identity: Any = None

    def make_agent(self) -> Agent:
        """Create the agent in this process: a new detector if a name is given, else the given object."""
        return as_agent(make_detector(self.detector) if isinstance(self.detector, str) else self.detector)


@dataclass
class Worker:
    """Runs episodes in one process. Each agent is created and warmed up before its first episode.

    Args:
        env: the environment of this process.
        contestants: all contestants of the evaluation.
        isolation: limits of each answer of a detector in a process of its own; ``None``: it runs in this process.
    """

    env: gym.Env[Any, Any]
    contestants: list[Contestant]
    isolation: Limits | None = None
    _agents: dict[int, Agent] = field(default_factory=dict)
    _starting: dict[int, IsolatedAgent] = field(default_factory=dict)

    def run_task(self, task: Task) -> Row | None:
        """Play one episode with one contestant; ``None`` if the contestant was only prepared.

        Raises:
            EvaluationError: the contestant failed.
            ArgumentError: the contestant refused one of its arguments.
        """
        episode, number, seeds = task
        contestant = self.contestants[number]
        if number not in self._agents:
            agent = contestant.make_agent() if self.isolation is None else self._isolate(number)
            warm_up(self.env, agent, contestant.label, seeds[0])
            self._agents[number] = agent
        if episode == PREPARE:
            return None
        return play_episode(self.env, self._agents[number], contestant.label, episode, seeds)

    def _isolate(self, number: int) -> Agent:
        """Create an agent in its own process; at first all those processes are started, so that they load together."""
        assert self.isolation is not None
        if not self._starting:
            for each, contestant in enumerate(self.contestants):
                self._starting[each] = IsolatedAgent(contestant.detector, self.isolation)
        try:
            self._starting[number].start()
        except (PlainError, ProcessDied) as error:
            raise detector_error(self.contestants[number].label, "its constructor", error) from error
        return self._starting[number]

    def close(self) -> None:
        """End the processes of the agents."""
        for agent in self._starting.values():
            agent.close()


class Player(Protocol):
    """Plays the episodes of a run in one process."""

    def run_task(self, task: Task) -> Row | None:
        """Play one episode with one contestant; ``None`` if the contestant was only prepared."""

    def close(self) -> None:
        """End the processes of the contestants."""


class Plan(Protocol):
    """All that another process needs to know of a run."""

    @property
    def labels(self) -> list[str]:
        """The contestants' names in rows and tables."""

    def make_player(self) -> Player:
        """Create the player of this process."""


@dataclass(frozen=True)
class EpisodePlan:
    """All that another process needs to know of an evaluation.

    Args:
        env_id: id of the environment, created once in each process; a module before the id is imported there.
        env_kwargs: arguments of the environment.
        contestants: all contestants of the evaluation.
        isolation: limits of each answer of a detector in a process of its own; ``None``: it runs in a worker process.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    contestants: list[Contestant]
    isolation: Limits | None = None

    @property
    def labels(self) -> list[str]:
        """The contestants' names in rows and tables."""
        return [contestant.label for contestant in self.contestants]

    def make_player(self) -> Worker:
        """Create the environment and the worker of this process."""
        environment = make_environment(find_environment(self.env_id), self.env_kwargs)
        return Worker(environment, self.contestants, self.isolation)


@dataclass
class _RemotePlayer:
    """A :class:`Player` that is created in another process, by its first task.

    Args:
        plan: the run.
        registered: what the program has registered itself.
    """

    plan: Plan
    registered: list[Part]
    _player: Player | None = None

    def run_task(self, task: Task) -> Row | None:
        if self._player is None:
            register_parts(self.registered)
            self._player = self.plan.make_player()
        return self._player.run_task(task)


@dataclass(frozen=True)
class _Sent:
    """Carries a :class:`_RemotePlayer` to another process by value: classes of a notebook cannot be imported there."""

    wrapper: Any

    def __call__(self, task: Task) -> Row | None:
        return self.wrapper.fn.run_task(task)


def send_plan(plan: Plan) -> Callable[[Task], Row | None]:
    """The function that plays the tasks of a run in another process; it is pickled."""
    remote: Any = _RemotePlayer(plan, registered_parts())
    return _Sent(CloudpickleWrapper(remote))


def as_failure(outcome: Outcome[Task, Row | None], label: str) -> Outcome[Task, Row | None]:
    """Turn what ended a task into the failure of its contestant; errors of arguments are raised.

    Args:
        outcome: what came of the task.
        label: of the contestant.
    """
    error, episode = outcome.error, outcome.task.episode
    if error is None or isinstance(error, EvaluationError):
        return outcome
    if isinstance(error, ProcessDied) or not isinstance(error, Exception):
        where = "its warm-up" if episode == PREPARE else f"episode {episode}"
        return Outcome(outcome.task, error=detector_error(label, where, error))
    raise error
