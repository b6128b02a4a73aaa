"""Evaluate policies in the games of several agents: the same games for all teams, and one row for each game."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from importlib import import_module
from os import PathLike
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from usnet_env.config import describe_arguments, named_values, unknown_name
from usnet_env.evaluation.agents import check_labels
from usnet_env.evaluation.play import Row, detector_step, record_metrics, row_keys
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.run import RunArguments, Task, play_run
from usnet_env.evaluation.tasks import EvaluationError
from usnet_env.plugins import make_detector

if TYPE_CHECKING:
    from usnet_env.multiagent.base import UsnetParallelEnv


def _find_role(agent: str) -> str:
    return agent.rpartition("_")[0]


class GamePlayer:
    """Plays games in one process; ``make`` makes the game there."""

    def __init__(self, make: Callable[[], UsnetParallelEnv], teams: Mapping[str, Mapping[str, Any]]) -> None:
        self.make, self.teams = make, teams

    @cached_property
    def env(self) -> UsnetParallelEnv:
        """The game of this process."""
        return self.make()

    def __call__(self, task: Task) -> Row:
        """Play one game; one in which a policy fails is a row with the reason in ``error``."""
        import pandas as pd

        from usnet_env.multiagent.play import play_game

        try:
            with detector_step(task.label, "the game"):
                game = play_game(self.env, self.teams[task.label], task.seeds[0], task.label, task.seeds[1])
        except EvaluationError as error:
            self.env.reset(seed=task.seeds[0])
            return {**row_keys(*task, self.env.swarm.head), "error": error.reason}
        paid = pd.DataFrame({"return": game.returns, "price": game.prices}).groupby(_find_role).mean()
        means = {f"{what}_{role}": paid.loc[role, what] for role in paid.index for what in paid}
        metrics = record_metrics(SimpleNamespace(**{"clusters": None, **game.record}))
        return {**row_keys(*task, game.record["head"]), **metrics, **means, "error": ""}


def evaluate_games(
    game: str | Callable[..., UsnetParallelEnv],
    players: Mapping[str, Mapping[str, Any]],
    *,
    game_kwargs: Mapping[str, Any] | None = None,
    out: str | PathLike[str] | None = None,
    **how: Any,
) -> EvaluationResult:
    """Play the same games with several teams of policies, and score them, as :func:`usnet_env.evaluate` does.

    Args:
        game: ``"usnet_observers_v0"``, ``"usnet_evasion_v0"``, or a function that makes a game in Parallel form.
        players: for each label, the policies of a team: a mapping of agents or roles to policies, as
            :func:`usnet_env.multiagent.play.play_game` takes it. The name of a detector stands for an observer with it.
        game_kwargs: arguments of the game.
        out: folder of the run.
        how: ``episodes``, ``seed``, ``workers``, ``progress`` and ``backend``, as of :func:`usnet_env.evaluate`.

    Returns:
        The result. Its rows also have ``return_<role>``, the sum of the rewards of a game, and ``price_<role>``, the
        sum of the prices paid: means over the agents of a role.

    Raises:
        ArgumentError: an argument was refused, or an agent has no policy.
    """
    from usnet_env.multiagent.play import choose_policies
    from usnet_env.multiagent.policies import DetectorObserver
    from usnet_env.multiagent.registration import GAMES  # not at the top: it registers the games with PettingZoo

    arguments, kwargs = RunArguments(**how), named_values("game_kwargs", game_kwargs)
    if not callable(game) and game not in GAMES:
        raise unknown_name("game", game, GAMES)
    make = game if callable(game) else import_module(f"usnet_env.multiagent.{game}").parallel_env
    teams = {label: named_values("players", team) for label, team in named_values("players", players).items()}
    check_labels("players", list(teams))
    env = make(**kwargs)
    for team in teams.values():
        for role, policy in team.items():
            if isinstance(policy, str):
                team[role] = DetectorObserver(make_detector(policy))
        choose_policies(env, team)  # refuses a missing one before anything is played
    name = str(env.metadata["name"])
    cell = {"env": name, "arguments": describe_arguments(env.config) | describe_arguments(env.rules)}
    config = {"suite": None, "cells": {name: cell}, "detectors": list(teams)}
    roles = dict.fromkeys(map(_find_role, env.possible_agents))
    columns = [f"{what}_{role}" for what in ("return", "price") for role in roles]
    return play_run(GamePlayer(lambda: make(**kwargs), teams), config, arguments, out, columns)
