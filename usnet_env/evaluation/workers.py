"""Run the episodes of an evaluation, in this process or spread over several worker processes."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.config import ArgumentError
from usnet_env.evaluation.agents import Agent, as_agent
from usnet_env.evaluation.environments import find_environment, make_environment
from usnet_env.evaluation.episode import Row, detector_error, play_episode, warm_up
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.plugins import make_detector, register_detector, registered_detectors
from usnet_env.processes import Limits, Outcome, ProcessDied, ProcessPool, SendError
from usnet_env.swarm import register_follow_strategy, register_mobility
from usnet_env.swarm.follow import FollowFunction, follow_strategies
from usnet_env.swarm.mobility import MobilityFunction, mobilities

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
        """Create the agent: a new detector if a name is given, else the given object."""
        return as_agent(make_detector(self.detector) if isinstance(self.detector, str) else self.detector)


@dataclass
class Worker:
    """Runs episodes in one process. Each agent is created and warmed up before its first episode.

    Args:
        env: the environment of this process.
        contestants: all contestants of the evaluation.
    """

    env: gym.Env[Any, Any]
    contestants: list[Contestant]
    _agents: dict[int, Agent] = field(default_factory=dict)

    def run_task(self, task: Task) -> Row | None:
        """Play one episode with one contestant; ``None`` if the contestant was only prepared.

        Raises:
            EvaluationError: the contestant failed.
            ArgumentError: the contestant refused one of its arguments.
        """
        episode, number, seeds = task
        contestant = self.contestants[number]
        if number not in self._agents:
            agent = contestant.make_agent()
            warm_up(self.env, agent, contestant.label, seeds[0])
            self._agents[number] = agent
        if episode == PREPARE:
            return None
        return play_episode(self.env, self._agents[number], contestant.label, episode, seeds)


@dataclass(frozen=True)
class Plan:
    """All that another process needs to know of an evaluation.

    Args:
        env_id: id of the environment, created once in each process; a module before the id is imported there.
        env_kwargs: arguments of the environment.
        contestants: all contestants of the evaluation.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    contestants: list[Contestant]


@dataclass
class _RemoteWorker:
    """A :class:`Worker` that is created in another process, by its first task.

    Args:
        plan: the evaluation.
        registered: what the program has registered itself.
    """

    plan: Plan
    registered: list[_Part]
    _worker: Worker | None = None

    def run_task(self, task: Task) -> Row | None:
        if self._worker is None:
            _register_parts(self.registered)
            environment = make_environment(find_environment(self.plan.env_id), self.plan.env_kwargs)
            self._worker = Worker(environment, self.plan.contestants)
        return self._worker.run_task(task)


@dataclass(frozen=True)
class _Sent:
    """Carries a :class:`_RemoteWorker` to another process by value: classes of a notebook cannot be imported there."""

    wrapper: Any

    def __call__(self, task: Task) -> Row | None:
        return self.wrapper.fn.run_task(task)


_REGISTER = {"follow": register_follow_strategy, "mobility": register_mobility, "detector": register_detector}


@dataclass(frozen=True)
class _Part:
    """A follow strategy, mobility or detector that the program has registered itself.

    Args:
        kind, name: what it is, and its name.
        module: where it is defined.
        part: the object, to be pickled by value.
    """

    kind: str
    name: str
    module: str
    part: CloudpickleWrapper[Any]


def _registered_parts() -> list[_Part]:
    """What this program has registered itself.

    What cannot be pickled is left out; a worker process that needs it then refuses its name.
    """
    found: list[tuple[str, str, Any, Any]] = [
        (kind, name, part, part.function if isinstance(part, FollowFunction | MobilityFunction) else type(part))
        for kind, parts in (("follow", follow_strategies()), ("mobility", mobilities()))
        for name, part in parts.items()
    ]
    found += [("detector", name, factory, factory) for name, factory in registered_detectors().items()]
    parts = []
    for kind, name, part, origin in found:
        module = str(getattr(origin, "__module__", ""))
        if not module.startswith("usnet_env."):
            with suppress(Exception):
                pickle.dumps(wrapper := CloudpickleWrapper(part))
                parts.append(_Part(kind, name, module, wrapper))
    return parts


def _register_parts(parts: Iterable[_Part]) -> None:
    """Register parts in this process, unless the main script or their module has registered them here too."""
    known = {"follow": follow_strategies(), "mobility": mobilities(), "detector": registered_detectors()}
    for part in parts:
        with suppress(Exception):  # its module cannot be imported here: its name is refused if it is used
            if part.module != "__main__":
                import_module(part.module)
            if part.name not in known[part.kind]:
                _REGISTER[part.kind](part.name, part.part.fn)  # type: ignore[operator]


def run_here(
    env: gym.Env[Any, Any], contestants: list[Contestant], tasks: Iterable[Task], threads: list[_Thread]
) -> Generator[Outcome[Task, Row | None], None, None]:
    """Run all tasks in this process.

    Args:
        env: the environment.
        contestants: all contestants of the evaluation.
        tasks: what to play.
        threads: receives the names of threads that are not daemons and stay after a task, each with the task.
    """
    worker = Worker(env, contestants)
    known = set(threading.enumerate())
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
        remote: Any = _RemoteWorker(plan, _registered_parts())
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
