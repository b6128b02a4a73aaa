"""Play one game with a policy for every role, and keep what happened."""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from usnet_env.config import ArgumentError, quote
from usnet_env.multiagent.base import Decided, UsnetParallelEnv
from usnet_env.provenance import versions

__all__ = ["Acting", "Played", "play_game"]


class Acting(Protocol):
    """Whatever serves as a policy; see :class:`usnet_env.multiagent.policies.Policy`."""

    def reset(self, seed: int, action_space: Any) -> None:
        """Start a game."""

    def act(self, observation: Any) -> Any:
        """The action for one observation."""


@dataclass(frozen=True)
class Played:
    """One game, played to its end.

    Args:
        returns: by agent, the sum of its rewards.
        prices: by agent, the sum of the prices it paid; 0 in a game without prices.
        J: J_m.
        rounds: R, rounds played.
        success: whether every head was hit.
        first_hits: heads hit in the first round.
        first_redundant: redundant candidates in the first round.
        redundant: redundant candidates in all rounds.
        record: the arguments of :class:`usnet_env.replay.EpisodeRecord`, from which replays and figures are made.
    """

    returns: dict[str, float]
    prices: dict[str, float]
    J: float
    rounds: int
    success: bool
    first_hits: int
    first_redundant: int
    redundant: int
    record: dict[str, Any]


def role_of(agent: str) -> str:
    """``observer`` of ``observer_0``."""
    return agent.rpartition("_")[0]


def play_game(env: UsnetParallelEnv, policies: Mapping[str, Acting], seed: int, label: str = "") -> Played:
    """Play one game in Parallel form.

    Args:
        env: one of the games' ``parallel_env``.
        policies: by agent, or by role (``"observer"``, ``"head"``). One that several agents share is copied for each
            of them; one that a single agent has plays itself, so it need not be such that it can be copied.
        seed: seeds the game; the policies' own seeds come from a separate branch of it.
        label: name of who names candidates, in the record.

    Returns:
        What happened; ``usnet_env.replay.EpisodeRecord(**played.record)`` is the episode as a file keeps it.

    Raises:
        ArgumentError: an env of another kind, or no policy for an agent.
    """
    if not isinstance(env, UsnetParallelEnv):
        raise ArgumentError(f"env must be the parallel_env of a game of this project, got {quote(env)}.")
    observations, infos = env.reset(seed=seed)
    chosen = {}
    for agent in env.possible_agents:
        policy = policies.get(agent, policies.get(role_of(agent)))
        if policy is None:
            raise ArgumentError(f"policies must name {agent} or its role {role_of(agent)}, got {sorted(policies)}.")
        chosen[agent] = policy
    uses = Counter(map(id, chosen.values()))
    players = {agent: copy.deepcopy(one) if uses[id(one)] > 1 else one for agent, one in chosen.items()}
    branches = np.random.SeedSequence(seed, spawn_key=(1,)).generate_state(len(env.possible_agents), np.uint32)
    for (agent, player), own in zip(players.items(), branches, strict=True):
        player.reset(int(own), env.action_space(agent))
    returns = dict.fromkeys(env.possible_agents, 0.0)
    prices = dict.fromkeys(env.possible_agents, 0.0)
    rounds: list[Decided] = []
    seconds: list[float] = []
    redundant = 0
    first = info = infos[env.possible_agents[0]]
    while env.agents:
        began = time.perf_counter()
        actions = {agent: players[agent].act(observations[agent]) for agent in env.agents}
        spent = time.perf_counter() - began
        observations, rewards, _, _, infos = env.step(actions)
        for agent, reward in rewards.items():
            returns[agent] += reward
            prices[agent] += float(infos[agent].get("price", 0.0))
        info = infos[env.possible_agents[0]]
        redundant += int(info["redundant"])
        if env.decided is not None:  # not the opening, in which nothing is decided
            rounds.append(env.decided)
            seconds.append(spent)
            first = info if len(rounds) == 1 else first
    return Played(
        returns=returns,
        prices=prices,
        J=float(info["J"]),
        rounds=len(rounds),
        success=bool(info["success"]),
        first_hits=int(first["hits"]),
        first_redundant=int(first["redundant"]),
        redundant=redundant,
        record=_record(env, rounds, seconds, seed, label),
    )


def _record(
    env: UsnetParallelEnv, rounds: list[Decided], seconds: list[float], seed: int, label: str
) -> dict[str, Any]:
    config = {name: getattr(env.config, name) for name in type(env.config).model_fields} | env.rules.model_dump()
    return {
        "position": np.stack([one.sighting.position for one in rounds]),
        "velocity": np.stack([one.sighting.velocity for one in rounds]),
        "seen": np.stack([one.sighting.seen for one in rounds]),
        "alive": np.stack([one.truth.alive for one in rounds]),
        "leader": np.stack([one.truth.leader for one in rounds]),
        "candidates": np.stack([one.candidates for one in rounds]),
        "scores": np.stack([one.scores for one in rounds]),
        "objective": np.array([one.objective for one in rounds]),
        "head": rounds[0].truth.head,
        "decoy": env.swarm.decoy,  # of the whole episode; who was one for a window only follows nobody in it
        "over_budget": np.array([one.over_budget for one in rounds]),
        "seconds": np.array(seconds),
        "problem": "P2",
        "env_id": str(env.metadata["name"]),
        "seed": seed,
        "detector": label,
        "config": config,
        "versions": versions(["pettingzoo"]),
    }
