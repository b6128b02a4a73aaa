"""Play the games of several agents as runs: the same seeds for all teams, and one row for each game."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from importlib import import_module
from os import PathLike
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, describe_arguments, named_values, quote, unknown_name
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.play import Row, detector_step, record_metrics, row_keys
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.run import RunArguments, Task, play_run
from usnet_env.files import as_path
from usnet_env.plugins import make_detector

if TYPE_CHECKING:
    from usnet_env.multiagent.base import UsnetParallelEnv


class GamePlayer:
    """Plays games in one process; sent to another one, it makes the game and its policies there."""

    def __init__(self, make_env: Callable[..., UsnetParallelEnv], game_kwargs: Any, players: Any) -> None:
        self.make_env, self.game_kwargs, self.players = make_env, game_kwargs, players

    def __getstate__(self) -> dict[str, Any]:
        return {name: vars(self)[name] for name in ("make_env", "game_kwargs", "players")}

    @cached_property
    def env(self) -> UsnetParallelEnv:
        """The game of this process."""
        return self.make_env(**self.game_kwargs)

    @cached_property
    def teams(self) -> dict[str, dict[str, Any]]:
        """The policies of each label, with those of detectors that are given by name."""
        from usnet_env.multiagent.policies import DetectorObserver

        def make(policy: Any) -> Any:
            return DetectorObserver(make_detector(policy)) if isinstance(policy, str) else policy

        return {label: {role: make(policy) for role, policy in team.items()} for label, team in self.players.items()}

    def __call__(self, task: Task) -> Row:
        """Play one game; one in which a policy fails is a row with the reason in ``error``."""
        from usnet_env.multiagent.play import play_game

        label, seeds = task.label, task.seeds
        try:
            with detector_step(label, "the game"):
                game = play_game(self.env, self.teams[label], seeds[0], label, seeds[1])
        except EvaluationError as error:
            self.env.reset(seed=seeds[0])
            return {**row_keys(*task, self.env.swarm.head), "error": error.reason}
        return {
            **row_keys(*task, game.record["head"]),
            **record_metrics(SimpleNamespace(**{"clusters": None, **game.record})),
            **_role_means("return", game.returns),
            **_role_means("price", game.prices),
            "error": "",
        }


def _role_means(what: str, values: Mapping[str, float]) -> dict[str, float]:
    """The mean over the agents of each role, by the name of its column."""
    roles: dict[str, list[float]] = {}
    for agent, value in values.items():
        roles.setdefault(agent.rpartition("_")[0], []).append(value)
    return {f"{what}_{role}": float(np.mean(found)) for role, found in roles.items()}


def evaluate_games(
    game: str | Callable[..., UsnetParallelEnv],
    players: Mapping[str, Mapping[str, Any]],
    *,
    episodes: int = 100,
    seed: int = 0,
    game_kwargs: Mapping[str, Any] | None = None,
    workers: int = 1,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
    backend: str | None = None,
) -> EvaluationResult:
    """Play the same games with several teams of policies, and score them.

    As :func:`usnet_env.evaluate` does with detectors: game i of every team has the same swarm and the same seed of the
    policies, rows are kept in ``out``, and an interrupted run resumes.

    Args:
        game: ``"usnet_observers_v0"``, ``"usnet_evasion_v0"``, or a function that makes a game in Parallel form.
        players: for each label, the policies of a team: a mapping of agents or roles to policies, as
            :func:`usnet_env.multiagent.play.play_game` takes it. A name such as ``"lagged-regression"`` stands for an
            observer with the detector of this name.
        episodes: number of games of each team.
        seed: seed of the whole evaluation.
        game_kwargs: arguments of the game.
        workers: number of processes.
        out: folder of the run; as of :func:`usnet_env.evaluate`.
        progress: show a progress bar on standard error.
        backend: as of :func:`usnet_env.evaluate`.

    Returns:
        The result. Besides the metrics of :data:`usnet_env.evaluation.METRICS`, its rows have ``return_<role>``, the
        sum of the rewards of a game, and ``price_<role>``, the sum of the prices paid: means over the agents of a role.
        A game in which a policy raises an exception is a row with the reason in ``error``.

    Raises:
        ArgumentError: an argument was refused, or an agent has no policy.
    """
    folder = None if out is None else as_path("out", out)
    how = RunArguments(episodes=episodes, seed=seed, workers=workers, progress=progress, backend=backend)
    kwargs = named_values("game_kwargs", game_kwargs)
    teams = {label: named_values("players", team) for label, team in named_values("players", players).items()}
    if not teams or not all(label and label.isprintable() for label in teams):
        raise ArgumentError(f"players must map labels of printable characters to policies, got {quote(players)}.")
    player = GamePlayer(_find_game(game), kwargs, teams)
    from usnet_env.multiagent.play import choose_policies

    for team in player.teams.values():
        choose_policies(player.env, team)  # refuses a missing one before anything is played
    cell = str(player.env.metadata["name"])
    arguments = describe_arguments(player.env.config) | describe_arguments(player.env.rules)
    config = {
        "suite": None,
        "cells": {cell: {"env": cell, "arguments": arguments}},
        "detectors": list(teams),
        "episodes": how.episodes,
        "seed": how.seed,
    }
    roles = dict.fromkeys(agent.rpartition("_")[0] for agent in player.env.possible_agents)
    columns = [f"{what}_{role}" for what in ("return", "price") for role in roles]
    return play_run(player, config, how, folder, columns)


def _find_game(game: Any) -> Callable[..., UsnetParallelEnv]:
    from usnet_env.multiagent.registration import GAMES  # not at the top: it registers the games with PettingZoo

    if callable(game):
        return game
    if not isinstance(game, str) or game not in GAMES:
        raise unknown_name("game", game, GAMES)
    make: Callable[..., UsnetParallelEnv] = import_module(f"usnet_env.multiagent.{game}").parallel_env
    return make
