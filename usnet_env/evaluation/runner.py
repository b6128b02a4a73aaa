"""The referee: one function that lets detectors meet the same swarms and scores them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
from pydantic import BaseModel, Field

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.evaluation.environments import environment_spec, is_usnet, make_environment
from usnet_env.evaluation.episode import Row
from usnet_env.evaluation.match import Entrant, Match, play_in_processes
from usnet_env.evaluation.players import PolicyPlayer, as_player
from usnet_env.evaluation.result import EvaluationResult, summarise
from usnet_env.evaluation.store import RunStore
from usnet_env.plugins import detector_label, make_detector

__all__ = ["MOST_EPISODES", "MOST_WORKERS", "TRIVIAL", "evaluate"]

#: The trivial policies that stand beside every published row (decision (l) of the paper's silent points).
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
    """Let detectors play the same episodes, and score them.

    Episode i's swarm and the detector's own seed come from two separate branches of (``seed``, i), so every detector
    meets the same swarms, on any number of workers, and none can rebuild a swarm from its seed. Detectors start each
    episode with ``reset`` and see windows only. One answer of each, apart and untimed, comes before its first episode.

    Args:
        env: a registered id, or an environment that was made (then with one worker, and it stays open).
        detector: a name as :func:`usnet_env.make_detector` takes it, a detector, anything with Stable-Baselines3's
            ``predict`` (asked with ``deterministic=True``; it gets the observation itself), or a list of these.
        episodes: how many, for each detector.
        seed: of the whole evaluation.
        env_kwargs: arguments of the environment.
        workers: processes; the rows are the same for any number of them, seconds apart.
        trivial: also evaluate the policies of :data:`TRIVIAL`.
        out: folder for ``run.json`` (what was asked for, versions, machine), ``episodes.csv`` and ``summary.json``.
            An interrupted run leaves the episodes that were finished, and the same call goes on with the others.
        progress: show a progress bar on standard error.

    Returns:
        Rows, summary and table.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector raised or gave an answer that does not fit; the sentence names it, the episode and
            the cause. Rows that were finished are kept in ``out``.
    """
    run = _Run(episodes=episodes, seed=seed, workers=workers, trivial=trivial, progress=progress)
    arguments = _env_kwargs(env_kwargs)
    entrants = _entrants(detector, run.trivial)
    made_here = isinstance(env, str)
    if isinstance(env, str):
        arena = make_environment(environment_spec(env), arguments)
    else:
        arena = _made(env, arguments, run.workers)
    try:
        config = _config(arena, arguments, entrants, run)
        store = None if out is None else RunStore(Path(out), config)
        rows = _known_rows(store, entrants, run.episodes)
        tasks = [
            (episode, number)
            for episode in range(run.episodes)
            for number, entrant in enumerate(entrants)
            if (entrant.label, episode) not in rows
        ]
        try:
            with _progress(run.progress, run.episodes * len(entrants), len(rows)) as advance:

                def collect(row: Row) -> None:
                    rows[row["detector"], row["episode"]] = row
                    advance()
                    if store is not None and store.due():
                        store.save_rows(_sorted(rows, entrants))

                if isinstance(env, str) and run.workers > 1 and len(tasks) > 1:
                    workers = min(run.workers, len(tasks))
                    play_in_processes(env, arguments, entrants, run.seed, tasks, workers, collect)
                else:
                    match = Match(arena, entrants, run.seed)
                    for task in tasks:
                        collect(match.play(task))
        finally:
            if store is not None and rows:
                store.save_rows(_sorted(rows, entrants))
    finally:
        if made_here:
            arena.close()
    ordered = _sorted(rows, entrants)
    result = EvaluationResult(ordered, summarise(ordered), config)
    if store is not None:
        store.save_summary(result.summary)
    return result


Rows = dict[tuple[str, int], Row]


def _sorted(rows: Rows, entrants: Sequence[Entrant]) -> list[Row]:
    """The rows by detector, in the order asked for, then by episode."""
    order = {entrant.label: number for number, entrant in enumerate(entrants)}
    return sorted(rows.values(), key=lambda row: (order[row["detector"]], row["episode"]))


def _known_rows(store: RunStore | None, entrants: Sequence[Entrant], episodes: int) -> Rows:
    rows = {} if store is None else {(row["detector"], row["episode"]): row for row in store.rows()}
    labels = {entrant.label for entrant in entrants}
    if any(label not in labels or not 0 <= episode < episodes for label, episode in rows):
        raise ArgumentError("out must hold rows of this run only, got rows of other detectors or episodes.")
    return rows


def _env_kwargs(env_kwargs: Mapping[str, Any] | None) -> dict[str, Any]:
    if env_kwargs is None:
        return {}
    if not isinstance(env_kwargs, Mapping) or not all(isinstance(name, str) for name in env_kwargs):
        raise ArgumentError(f"env_kwargs must be a mapping of names to values, got {quote(env_kwargs)}.")
    return dict(env_kwargs)


def _made(env: Any, arguments: Mapping[str, Any], workers: int) -> gym.Env[Any, Any]:
    """An environment that the caller made."""
    if not isinstance(env, gym.Env) or not is_usnet(env):
        raise ArgumentError(f"env must be a registered id or a USNET environment, got {quote(env)}.")
    if arguments:
        raise ArgumentError("env_kwargs must be empty for an environment that was already made.")
    if workers != 1:
        raise ArgumentError(f"workers must be 1 for an environment that was already made, got {workers}.")
    return env


def _entrants(detector: Any, trivial: bool) -> list[Entrant]:
    """Every detector under a label of its own."""
    asked = list(detector) if isinstance(detector, list | tuple) else [detector]
    if not asked:
        raise ArgumentError("detector must name at least one detector, got an empty list.")
    entrants: dict[str, Entrant] = {}
    for one in asked:
        label = _label(one)
        if label in entrants and isinstance(one, str):
            raise ArgumentError(f"detector must name each detector once, got {label!r} twice.")
        twin = 2
        while label in entrants:
            label = f"{_label(one)} #{twin}"
            twin += 1
        entrants[label] = Entrant(label, one)
    for name in TRIVIAL if trivial else ():
        entrants.setdefault(name, Entrant(name, name))
    return list(entrants.values())


def _label(detector: Any) -> str:
    """The label of a detector, which is thereby seen to be one."""
    player = as_player(make_detector(detector) if isinstance(detector, str) else detector)
    return type(detector).__name__ if isinstance(player, PolicyPlayer) else detector_label(detector)


def _plain(value: Any) -> Any:
    """``value`` as JSON can hold it; an object without such a form stands under its class's name."""
    if isinstance(value, BaseModel):
        return _plain(value.model_dump())
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value if value is None or isinstance(value, str | int | float) else type(value).__qualname__


def _config(
    arena: gym.Env[Any, Any], arguments: Mapping[str, Any], entrants: Sequence[Entrant], run: _Run
) -> dict[str, Any]:
    """What was asked for: two runs with the same config have the same rows."""
    inner: Any = arena.unwrapped
    return {
        "env": type(inner).__name__ if arena.spec is None else arena.spec.id,
        "env_kwargs": _plain(arguments),
        "environment": {name: _plain(getattr(inner, name)) for name in ("config", "rules") if hasattr(inner, name)},
        "detectors": [entrant.label for entrant in entrants],
        "episodes": run.episodes,
        "seed": run.seed,
    }


@contextmanager
def _progress(show: bool, total: int, done: int) -> Iterator[Callable[[], None]]:
    """A bar on standard error, or nothing."""
    if not show:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("episodes"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("episodes", total=total, completed=done)
        yield lambda: bar.advance(task)
