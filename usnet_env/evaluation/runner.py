"""The evaluator: one function that plays all detectors against the same swarms and scores them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
from pydantic import BaseModel, Field

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.evaluation.agents import PolicyAgent, as_agent
from usnet_env.evaluation.environments import find_environment, is_usnet, make_environment
from usnet_env.evaluation.episode import Row
from usnet_env.evaluation.result import EvaluationResult, summarise
from usnet_env.evaluation.store import RunStore
from usnet_env.evaluation.workers import Contestant, Worker, run_in_processes
from usnet_env.files import as_path
from usnet_env.plugins import detector_label, make_detector

__all__ = ["MOST_EPISODES", "MOST_WORKERS", "TRIVIAL", "evaluate"]

#: The trivial policies that every published table also shows: decision (l) of ``docs/game.md``.
TRIVIAL = ("destroy-all", "none", "random", "one-per-round")

MOST_EPISODES = 1_000_000
MOST_WORKERS = 256


class _Run(Config):
    """The plain arguments of :func:`evaluate`."""

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)]
    trivial: bool
    progress: bool


def evaluate(
    env: str | gym.Env[Any, Any],
    detector: Any,
    *,
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    workers: int = 1,
    trivial: bool = False,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
) -> EvaluationResult:
    """Play the same episodes with every detector, and score them.

    The seeds of the swarm and of the detector in episode i come from two separate branches of (``seed``, i). So every
    detector plays against the same swarms, for any number of workers. Each episode starts with the detector's
    ``reset``; the detector receives windows and nothing else. Before its first episode each detector answers one window
    that is neither timed nor scored (warm-up).

    Args:
        env: a registered id, or an environment object (which allows one worker only, and is not closed).
        detector: a name as :func:`usnet_env.make_detector` takes it, a detector, an object with the ``predict`` method
            of Stable-Baselines3 (called with the observation and ``deterministic=True``), or a list of these.
        episodes: number of episodes for each detector.
        seed: seed of the whole evaluation.
        env_kwargs: arguments of the environment.
        workers: number of processes; the rows do not depend on it, except for the seconds.
        trivial: also evaluate the policies of :data:`TRIVIAL`.
        out: folder for ``run.json`` (arguments, versions, machine), ``episodes.csv`` and ``summary.json``. An
            interrupted run keeps its finished episodes there, and the same call plays the remaining ones.
        progress: show a progress bar on standard error.

    Returns:
        Rows, summary and table.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector raised an exception, or its answer has a wrong type or shape; the message names the
            detector, the episode and the cause. Finished rows are kept in ``out``.
    """
    folder = None if out is None else as_path("out", out)
    run = _Run(episodes=episodes, seed=seed, workers=workers, trivial=trivial, progress=progress)
    arguments = _check_env_kwargs(env_kwargs)
    contestants = _make_contestants(detector, run.trivial)
    created_here = isinstance(env, str)
    if isinstance(env, str):
        environment = make_environment(find_environment(env), arguments)
    else:
        environment = _check_environment(env, arguments, run.workers)
    try:
        config = _make_config(environment, arguments, contestants, run)
        store = None if folder is None else RunStore(folder, config)
        rows = _load_rows(store, contestants, run.episodes)
        tasks = [
            (episode, number)
            for episode in range(run.episodes)
            for number, contestant in enumerate(contestants)
            if (contestant.label, episode) not in rows
        ]
        try:
            with _progress_bar(run.progress, run.episodes * len(contestants), len(rows)) as advance:

                def collect(row: Row) -> None:
                    rows[row["detector"], row["episode"]] = row
                    advance()
                    if store is not None and store.should_save():
                        store.save_rows(_sort_rows(rows, contestants))

                if isinstance(env, str) and run.workers > 1 and len(tasks) > 1:
                    workers = min(run.workers, len(tasks))
                    run_in_processes(env, arguments, contestants, run.seed, tasks, workers, collect)
                else:
                    worker = Worker(environment, contestants, run.seed)
                    for task in tasks:
                        collect(worker.run_task(task))
        finally:
            if store is not None and rows:
                store.save_rows(_sort_rows(rows, contestants))
    finally:
        if created_here:
            environment.close()
    ordered = _sort_rows(rows, contestants)
    result = EvaluationResult(ordered, summarise(ordered), config)
    if store is not None:
        store.save_summary(result.summary)
    return result


Rows = dict[tuple[str, int], Row]


def _sort_rows(rows: Rows, contestants: Sequence[Contestant]) -> list[Row]:
    """Sort rows by detector, in the order of the contestants, then by episode."""
    order = {contestant.label: number for number, contestant in enumerate(contestants)}
    return sorted(rows.values(), key=lambda row: (order[row["detector"]], row["episode"]))


def _load_rows(store: RunStore | None, contestants: Sequence[Contestant], episodes: int) -> Rows:
    rows = {} if store is None else {(row["detector"], row["episode"]): row for row in store.load_rows()}
    labels = {contestant.label for contestant in contestants}
    if any(label not in labels or not 0 <= episode < episodes for label, episode in rows):
        raise ArgumentError("out must hold only rows of this run, got rows of other detectors or episodes.")
    return rows


def _check_env_kwargs(env_kwargs: Mapping[str, Any] | None) -> dict[str, Any]:
    if env_kwargs is None:
        return {}
    if not isinstance(env_kwargs, Mapping) or not all(isinstance(name, str) for name in env_kwargs):
        raise ArgumentError(f"env_kwargs must be a mapping of names to values, got {quote(env_kwargs)}.")
    return dict(env_kwargs)


def _check_environment(env: Any, arguments: Mapping[str, Any], workers: int) -> gym.Env[Any, Any]:
    """Check an environment object given by the caller, and return it."""
    if not isinstance(env, gym.Env) or not is_usnet(env):
        raise ArgumentError(f"env must be a registered id or a USNET environment, got {quote(env)}.")
    if arguments:
        raise ArgumentError("env_kwargs must be empty if env is an environment object, got arguments for it.")
    if workers != 1:
        raise ArgumentError(f"workers must be 1 if env is an environment object, got {workers}.")
    return env


def _make_contestants(detector: Any, trivial: bool) -> list[Contestant]:
    """Give each detector its own label."""
    detectors = list(detector) if isinstance(detector, list | tuple) else [detector]
    if not detectors:
        raise ArgumentError("detector must name at least one detector, got an empty list.")
    contestants: dict[str, Contestant] = {}
    for each in detectors:
        label = _make_label(each)
        if label in contestants and isinstance(each, str):
            raise ArgumentError(f"detector must name each detector once, got {label!r} twice.")
        number = 2
        while label in contestants:
            label = f"{_make_label(each)} #{number}"
            number += 1
        contestants[label] = Contestant(label, each)
    for name in TRIVIAL if trivial else ():
        contestants.setdefault(name, Contestant(name, name))
    return list(contestants.values())


def _make_label(detector: Any) -> str:
    """Return the label of a detector; whatever is not a detector is refused."""
    agent = as_agent(make_detector(detector) if isinstance(detector, str) else detector)
    return type(detector).__name__ if isinstance(agent, PolicyAgent) else detector_label(detector)


def _to_plain(value: Any) -> Any:
    """Convert a value to plain JSON types; an object without such a form becomes the name of its class."""
    if isinstance(value, BaseModel):
        return _to_plain(value.model_dump())
    if isinstance(value, Mapping):
        return {str(name): _to_plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value if value is None or isinstance(value, str | int | float) else type(value).__qualname__


def _make_config(
    environment: gym.Env[Any, Any], arguments: Mapping[str, Any], contestants: Sequence[Contestant], run: _Run
) -> dict[str, Any]:
    """Return the arguments of the run as plain values: runs with the same config have the same rows."""
    inner: Any = environment.unwrapped
    return {
        "env": type(inner).__name__ if environment.spec is None else environment.spec.id,
        "env_kwargs": _to_plain(arguments),
        "environment": {name: _to_plain(getattr(inner, name)) for name in ("config", "rules") if hasattr(inner, name)},
        "detectors": [contestant.label for contestant in contestants],
        "episodes": run.episodes,
        "seed": run.seed,
    }


@contextmanager
def _progress_bar(visible: bool, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar on standard error if ``visible``; yields the function that advances it by one episode."""
    if not visible:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("episodes"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("episodes", total=total, completed=done)
        yield lambda: bar.advance(task)
