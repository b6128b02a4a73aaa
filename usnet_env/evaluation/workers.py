"""Run the episodes of an evaluation, in this process or spread over several worker processes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.config import ArgumentError
from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.environments import find_environment, make_environment
from usnet_env.evaluation.episode import Row, detector_error, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.isolation import IsolatedAgent
from usnet_env.evaluation.parts import Part, register_parts, registered_parts
from usnet_env.plugins import make_detector
from usnet_env.processes import Limits, Outcome, PlainError, ProcessDied, ProcessPool, SendError

__all__ = ["PREPARE", "Contestant", "Plan", "Task", "Worker", "run_here", "run_in_processes"]

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
    """

    label: str
    detector: Any

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


@dataclass(frozen=True)
class Plan:
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


@dataclass
class _RemoteWorker:
    """A :class:`Worker` that is created in another process, by its first task.

    Args:
        plan: the evaluation.
        registered: what the program has registered itself.
    """

    plan: Plan
    registered: list[Part]
    _worker: Worker | None = None

    def run_task(self, task: Task) -> Row | None:
        if self._worker is None:
            register_parts(self.registered)
            environment = make_environment(find_environment(self.plan.env_id), self.plan.env_kwargs)
            self._worker = Worker(environment, self.plan.contestants, self.plan.isolation)
        return self._worker.run_task(task)


@dataclass(frozen=True)
class _Sent:
    """Carries a :class:`_RemoteWorker` to another process by value: classes of a notebook cannot be imported there."""

    wrapper: Any

    def __call__(self, task: Task) -> Row | None:
        return self.wrapper.fn.run_task(task)


def run_here(
    worker: Worker, tasks: Iterable[Task], threads: list[_Thread]
) -> Generator[Outcome[Task, Row | None], None, None]:
    """Run all tasks in this process.

    Args:
        worker: plays them; it is closed at the end.
        tasks: what to play.
        threads: receives the names of threads that are not daemons and stay after a task, each with the task.
    """
    known = set(threading.enumerate())
    with closing(worker):
        for task in tasks:
            try:
                yield Outcome(task, worker.run_task(task))
            except EvaluationError as error:
                yield Outcome(task, error=error)
            fresh = [each for each in threading.enumerate() if each not in known]
            threads += [(each.name, task) for each in fresh if not each.daemon]
            known.update(fresh)


_Thread = tuple[str, Task]


def run_in_processes(
    plan: Plan,
    tasks: Iterable[Task],
    is_wanted: Callable[[Task], bool],
    workers: int,
    limits: Limits,
    threads: list[_Thread],
) -> Generator[Outcome[Task, Row | None], None, None]:
    """Run all tasks in separate processes; the outcomes come in any order.

    Args:
        plan: the evaluation.
        tasks: what to play.
        is_wanted: whether a task is still wanted whose process has died before the task was begun.
        workers: number of processes.
        limits: limits of each answer.
        threads: receives the names of threads because of which a process did not end by itself, each with its task.

    Raises:
        ArgumentError: an argument cannot be sent to another process, or was refused there.
        EvaluationError: no process could start.
    """
    try:
        remote: Any = _RemoteWorker(plan, registered_parts())
        pool = ProcessPool[Task, "Row | None"](_Sent(CloudpickleWrapper(remote)), workers, limits)
    except SendError as error:
        raise _cannot_be_sent(workers, limits, error) from None
    with pool:
        try:
            for outcome in pool.run(tasks, is_wanted):
                yield _as_failure(outcome, plan.contestants)
        except SendError as error:
            if error.started:
                raise _cannot_be_sent(workers, limits, error) from None
            raise EvaluationError(f"{error}. {_GUARD}") from None
        threads += pool.left_threads


_GUARD = (
    "A worker process imports the script that started it, so a script must call evaluate in a block that begins with "
    '`if __name__ == "__main__":`.'
)


def _cannot_be_sent(workers: int, limits: Limits, error: SendError) -> ArgumentError:
    what = f"got {workers}" if workers > 1 else "and time_limit and memory_limit must be None, got a limit"
    return ArgumentError(
        f"workers must be 1 for a detector or argument that cannot be sent to another process, {what}: {error}."
    )


def _as_failure(outcome: Outcome[Task, Row | None], contestants: list[Contestant]) -> Outcome[Task, Row | None]:
    """Turn what ended a task into the failure of its detector; errors of arguments are raised."""
    error, (episode, number, _) = outcome.error, outcome.task
    if error is None or isinstance(error, EvaluationError):
        return outcome
    if isinstance(error, ProcessDied) or not isinstance(error, Exception):
        where = "its warm-up" if episode == PREPARE else f"episode {episode}"
        return Outcome(outcome.task, error=detector_error(contestants[number].label, where, error))
    raise error
