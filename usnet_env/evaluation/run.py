"""Play detectors against the same swarms: cells x detectors x episodes -> rows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from itertools import product
from os import PathLike
from typing import Any, Literal

import gymnasium as gym
from pydantic import Field

from usnet_env.config import ArgumentError, Config, named_values, quote, unknown_name
from usnet_env.evaluation.agents import TRIVIAL, Agent, DetectorAgent, label_detectors
from usnet_env.evaluation.child import ChildDetector
from usnet_env.evaluation.environments import make_environment
from usnet_env.evaluation.folder import COLUMNS, RunFolder
from usnet_env.evaluation.play import TRACK_METRICS, Row, Task, detector_step, episode_seeds, play_episode, row_keys
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.suites import Cell, Suite, load_suite
from usnet_env.evaluation.tasks import EvaluationError, map_tasks
from usnet_env.files import as_path
from usnet_env.progress import progress_bar

MOST_EPISODES = 1_000_000  # of a cell

__all__ = ["TRIVIAL", "evaluate", "evaluate_suite", "map_tasks"]


class RunArguments(Config):
    """The plain arguments of a run."""

    episodes: int = Field(default=100, ge=1, le=MOST_EPISODES)
    seed: int = Field(default=0, ge=0, lt=2**192)  # published rows use a suite's seed + (a 128-bit number << 32)
    workers: int = Field(default=1, ge=1, le=4_096)
    progress: bool = False
    backend: Literal["serial", "processes", "ray"] | None = None
    trivial: bool = False
    isolate: bool = False
    time_limit: float | None = Field(default=None, gt=0, le=1e9)
    memory_limit: float | None = Field(default=None, gt=0, le=1e9)

    @property
    def isolated(self) -> bool:
        """Whether each detector plays in a child process."""
        return self.isolate or self.time_limit is not None or self.memory_limit is not None


class DetectorPlayer:
    """Plays tasks in one process, with the agent of one detector in one cell at a time, which is warmed up first."""

    def __init__(self, cells: Mapping[str, Cell], detectors: Mapping[str, Any], options: RunArguments) -> None:
        self.cells, self.detectors, self.options = cells, detectors, options
        self._env: Any = None
        self._agent: Agent = None
        self._agent_key = ("", "")  # the cell and the label of the agent
        self._failure: EvaluationError | None = None  # its constructor or its warm-up has failed

    def __call__(self, task: Task) -> Row:
        """Play one episode; that of a detector that fails is a row with its reason in ``error``."""
        try:
            if self._agent_key != task[:2]:
                self._prepare(task)
            if self._failure is not None:
                raise self._failure
            return play_episode(self._env, self._agent, task)
        except EvaluationError as error:
            if isinstance(self._agent, ChildDetector) and not self._agent.running and self._failure is None:
                self._agent_key = (task.cell, "")  # a new one is made, and warmed up as the first one was
            self._env.reset(seed=task.seeds[0])
            return {**row_keys(task, self._env.unwrapped.swarm), "error": error.reason}

    def _prepare(self, task: Task) -> None:
        """Make the agent, and the environment if the cell is another one than before."""
        self.close()
        if self._agent_key[0] != task.cell:
            cell = self.cells[task.cell]
            self._env = make_environment(cell.env, cell.arguments)
        self._agent_key, self._failure = task[:2], None
        try:
            with detector_step(task.label, "its constructor"):
                detector, limits = self.detectors[task.label], (self.options.time_limit, self.options.memory_limit)
                self._agent = ChildDetector(detector, *limits) if self.options.isolated else DetectorAgent(detector)
            observation, _ = self._env.reset(seed=task.seeds[0])
            with detector_step(task.label, "its warm-up"):
                self._agent.warm_up(observation)
        except EvaluationError as error:
            self._failure = error

    def close(self) -> None:
        """End the child process, if there is one."""
        if isinstance(self._agent, ChildDetector):
            self._agent.close()
        self._agent = None


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
    time_limit: float | None = None,
    memory_limit: float | None = None,
    isolate: bool = False,
    backend: Literal["serial", "processes", "ray"] | None = None,
) -> EvaluationResult:
    """Play the same episodes with every detector, and score them.

    The seeds of the swarm and of the detector in episode i come from two separate branches of (``seed``, i). So every
    detector plays against the same swarms, for any number of workers. Each episode starts with the detector's
    ``reset``; the detector receives windows and nothing else. A first answer is neither timed nor scored (warm-up).

    An episode in which a detector raises an exception, gives a wrong answer, exceeds a limit or ends its child process
    is a row with the reason in its column ``error`` and without metrics. The other episodes and detectors go on.

    Args:
        env: a registered id, with or without its module: ``"my_module:Mine-v0"``; or what ``gym.make`` returned, which
            is made again from its id and arguments, without other wrappers.
        detector: a name as :func:`usnet_env.make_detector` takes it, a detector, a list of these, or a mapping of the
            labels that they get: ``{"my PPO": PolicyDetector(model.policy)}``.
        episodes: number of episodes for each detector.
        seed: seed of the whole evaluation.
        env_kwargs: arguments of the environment.
        workers: number of processes; the rows do not depend on it, except for the seconds.
        trivial: also evaluate the policies of :data:`TRIVIAL`.
        out: folder for ``run.json`` and ``rows.csv``, to which each row is appended. The same call plays what is
            missing or has failed; one with more episodes or other detectors extends the run.
        progress: show a progress bar on standard error.
        time_limit: largest wall time in seconds of one answer, or of one ``reset``, in a child process.
        memory_limit: largest memory in megabytes (10^6 bytes) that one of them may allocate there. Linux only.
        isolate: play each detector in a child process, so that an accident there ends no run.
        backend: where episodes are played, as of :func:`map_tasks`: ``"serial"``, ``"processes"`` or ``"ray"``.

    Returns:
        Rows, summary and tables: of all detectors and episodes that ``out`` holds.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a worker process was ended; the same call resumes.

    >>> result = evaluate("USNET/SingleCluster-v0", ["random", "lagged-correlation"], episodes=3)
    >>> len(result.rows), list(result)
    (6, ['random', 'lagged-correlation'])
    """
    options = RunArguments(
        episodes=episodes, seed=seed, workers=workers, progress=progress, backend=backend, trivial=trivial,
        isolate=isolate, time_limit=time_limit, memory_limit=memory_limit,
    )  # fmt: skip
    arguments = named_values("env_kwargs", env_kwargs)
    if isinstance(env, gym.Env):
        if env.spec is None:
            raise ArgumentError(f"env must be an id or made by gym.make, got {quote(env)}.")
        env_arguments = {name: value for name, value in env.spec.kwargs.items() if name != "render_mode"}
        env, arguments = env.spec.id, env_arguments | arguments
    return _evaluate_cells({env: Cell(env=env, arguments=arguments)}, detector, options, out)


def evaluate_suite(
    suite: str | PathLike[str] | Suite,
    detector: Any,
    *,
    cells: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    out: str | PathLike[str] | None = None,
    **options: Any,
) -> EvaluationResult:
    """Evaluate detectors in every cell of a suite; all cells have the same seeds, unless they were drawn at random.

    Args:
        suite: a name, the path of a YAML file, or what :func:`load_suite` returns.
        detector: as of :func:`usnet_env.evaluate`.
        cells: names of the cells to play; ``None`` for all.
        episodes: number of episodes of each cell; ``None`` for that of the suite.
        seed: seed of the episodes; ``None`` for that of the suite.
        out: folder of the run; as of :func:`usnet_env.evaluate`. A call with other cells extends the run.
        options: further arguments of :func:`usnet_env.evaluate`, which says what is returned and raised.

    Example:
        >>> evaluate_suite("paper", "destroy-all", cells=["f1"], episodes=2).rows["exact"].tolist()
        [0.0, 0.0]
    """
    chosen = suite if isinstance(suite, Suite) else load_suite(suite)
    for name in cells or ():
        if name not in chosen.cells:
            raise unknown_name("cells", name, chosen.cells)
    episodes = chosen.episodes if episodes is None else episodes
    seed = chosen.seed if seed is None else seed
    arguments = RunArguments(episodes=episodes, seed=seed, **options)
    chosen_cells = {name: chosen.cells[name] for name in cells} if cells else chosen.cells
    return _evaluate_cells(chosen_cells, detector, arguments, out, suite=chosen)


def _evaluate_cells(
    cells: Mapping[str, Cell],
    detector: Any,
    options: RunArguments,
    out: str | PathLike[str] | None,
    suite: Suite | None = None,
) -> EvaluationResult:
    """Check everything that can be refused, then play the missing episodes of a run."""
    import pandas as pd  # not at the top: worker processes do without it

    detectors, metrics = label_detectors(detector, options.trivial, options.isolated), set[str]()
    for name, cell in (cells if suite is None else suite.cells).items():
        try:
            with closing(make_environment(cell.env, cell.arguments)) as env:
                metrics |= set(TRACK_METRICS if hasattr(env.unwrapped, "score_answer") else ())
        except ArgumentError as error:
            location = "" if suite is None else f", in the cell {name!r} of the suite {suite.name}"
            raise ArgumentError(f"{str(error).removesuffix('.')}{location}.") from None
    config = {
        "suite": None if suite is None else suite.label,
        "unit": "swarm" if suite is None else suite.unit,
        "cells": {name: cell.model_dump() for name, cell in cells.items()},
        "detectors": list(detectors),
        "episodes": options.episodes,
        "seed": options.seed,
    }
    text = json.dumps(config, default=lambda value: value.tolist() if hasattr(value, "tolist") else quote(value))
    config, columns, rows = json.loads(text), [*COLUMNS[:-1], *metrics, "error"], list[Row]()
    with closing(DetectorPlayer(cells, detectors, options)) as play, ExitStack() as stack:
        folder = None if out is None else stack.enter_context(closing(RunFolder(as_path("out", out), config, columns)))
        old_rows = pd.DataFrame(columns=columns) if folder is None else folder.rows
        scored = old_rows.loc[old_rows["error"] == "", ["cell", "detector", "episode"]]
        scored_keys = set(scored.itertuples(index=False, name=None))
        keys = list(product(config["cells"], config["detectors"], range(options.episodes)))
        drawn_cells = suite.cells if suite is not None and suite.unit == "cell" else ()  # each has swarms of its own
        first_episode = {cell: number * MOST_EPISODES for number, cell in enumerate(drawn_cells)}
        missing = [key for key in keys if key not in scored_keys]
        tasks = [Task(*key, episode_seeds(options.seed, first_episode.get(key[0], 0) + key[2])) for key in missing]
        show_progress = stack.enter_context(progress_bar("episodes", options.progress))
        played = stack.enter_context(closing(map_tasks(play, tasks, workers=options.workers, backend=options.backend)))
        for number, row in enumerate(played, len(keys) - len(tasks) + 1):
            (rows if folder is None else folder).append(row)
            show_progress(number, len(keys))
    return EvaluationResult(pd.DataFrame(rows, columns=columns), config) if out is None else EvaluationResult.load(out)
