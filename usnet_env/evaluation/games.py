"""Play the games of several agents as runs: the same seeds for all, the rows in a folder, on any backend."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from os import PathLike
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, named_values, quote
from usnet_env.evaluation.engine import RunArguments, choose_place, play_run
from usnet_env.evaluation.episode import Row, detector_step
from usnet_env.evaluation.identity import describe, describe_code, describe_detector
from usnet_env.evaluation.metrics import record_metrics
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.schedule import Seeds
from usnet_env.evaluation.store import COLUMNS
from usnet_env.evaluation.workers import Task
from usnet_env.files import as_path
from usnet_env.plugins import make_detector
from usnet_env.processes import Limits

if TYPE_CHECKING:
    from usnet_env.multiagent.base import UsnetParallelEnv

Players = Mapping[str, Any]


@dataclass
class _GamePlayer:
    """Plays games in one process; sent to another one, it makes the game and its policies there."""

    make_env: Callable[..., UsnetParallelEnv]
    game_kwargs: dict[str, Any]
    players: dict[str, dict[str, Any]]  # by label, the policies of each role

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("env", "teams")}

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

        return {label: {role: make(each) for role, each in own.items()} for label, own in self.players.items()}

    def run_task(self, task: Task) -> Row | None:
        """Play one game."""
        from usnet_env.multiagent.play import play_game

        label, episode, (swarm_seed, policy_seed) = task
        if episode is None:
            return None
        with detector_step(label, f"game {episode}"):
            game = play_game(self.env, self.teams[label], swarm_seed, label, policy_seed)
        return {
            "detector": label,
            "episode": episode,
            "swarm_seed": swarm_seed,
            "detector_seed": policy_seed,
            "uavs": len(game.record["head"]),
            "heads": int(game.record["head"].sum()),
            **record_metrics(SimpleNamespace(**{"clusters": None, **game.record})),
            **_role_means("return", game.returns),
            **_role_means("price", game.prices),
        }

    def close(self) -> None:
        """Do nothing: the game holds no resources."""


def _identify(policy: Any) -> Any:
    """What distinguishes a policy from others: its class and arguments, not what it has counted since."""
    detector = getattr(policy, "detector", None)
    return describe_detector(policy) if detector is None else [describe(type(policy)), describe_detector(detector)]


def _role_means(what: str, values: Mapping[str, float]) -> dict[str, float]:
    """The mean over the agents of each role, by the name of its column."""
    roles: dict[str, list[float]] = {}
    for agent, value in values.items():
        roles.setdefault(agent.rpartition("_")[0], []).append(value)
    return {f"{what}_{role}": float(np.mean(own)) for role, own in roles.items()}


def evaluate_games(
    game: str | Callable[..., UsnetParallelEnv],
    players: Mapping[str, Players],
    *,
    episodes: int = 100,
    seed: int = 0,
    game_kwargs: Mapping[str, Any] | None = None,
    workers: int = 1,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
    backend: str | None = None,
    address: str | None = None,
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
        backend: where games are played; as of :func:`usnet_env.evaluate`.
        address: of a Ray cluster.

    Returns:
        The result. Besides the metrics of :data:`usnet_env.evaluation.METRICS`, its rows have ``return_<role>``, the
        sum of the rewards of a game, and ``price_<role>``, the sum of the prices paid: means over the agents of a role.

    Raises:
        ArgumentError: an argument was refused, or an agent has no policy.
        EvaluationError: a policy raised an exception; the other teams have played to the end.
    """
    folder = None if out is None else as_path("out", out)
    run = RunArguments(episodes=episodes, seed=seed, workers=workers, progress=progress)
    place = choose_place(backend, run.workers, Limits(), address)
    if not isinstance(players, Mapping) or not players:
        raise ArgumentError(f"players must be a mapping of labels to policies, got {quote(players)}.")
    if not all(isinstance(label, str) and label and label.isprintable() for label in players):
        raise ArgumentError(f"players must have labels of printable characters, got {quote(list(players))}.")
    if not all(isinstance(own, Mapping) for own in players.values()):
        raise ArgumentError(f"players must map each label to a mapping of roles to policies, got {quote(players)}.")
    kwargs = named_values("game_kwargs", game_kwargs)
    player = _GamePlayer(_find_game(game), kwargs, {label: dict(own) for label, own in players.items()})
    from usnet_env.multiagent.play import choose_policies

    for policies in player.teams.values():
        choose_policies(player.env, policies)  # refuses a missing one before anything is played
    settings = {"config": describe(player.env.config), "rules": describe(player.env.rules)}
    config = {
        "env": str(player.env.metadata["name"]),
        "game_kwargs": describe(kwargs),
        "environment": settings,
        **describe_code(type(player.env), [settings, describe(kwargs)]),
        "detectors": list(player.players),
        "identities": [{role: _identify(own[role]) for role in own} for own in player.players.values()],
        "episodes": run.episodes,
        "seed": run.seed,
    }
    roles = dict.fromkeys(agent.rpartition("_")[0] for agent in player.env.possible_agents)
    columns = {**COLUMNS, **{f"{what}_{role}": "float" for what in ("return", "price") for role in roles}}
    return play_run(player, config, Seeds(run.seed), place, folder, run.progress, columns)


def _find_game(game: Any) -> Callable[..., UsnetParallelEnv]:
    from usnet_env.multiagent.registration import GAMES  # not at the top: it registers the games with PettingZoo

    if callable(game):
        return game
    if not isinstance(game, str) or game not in GAMES:
        raise ArgumentError(f"game must be one of {', '.join(GAMES)} or a function, got {quote(game)}.")
    make: Callable[..., UsnetParallelEnv] = import_module(f"usnet_env.multiagent.{game}").parallel_env
    return make
