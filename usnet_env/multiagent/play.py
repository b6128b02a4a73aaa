"""Play one game with a policy for every role, and return its result."""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from usnet_env.config import ArgumentError, describe_arguments, plain_text, quote, whole_number
from usnet_env.multiagent.base import RoundRecord, UsnetParallelEnv
from usnet_env.multiagent.policies import DetectorObserver
from usnet_env.plugins import detector_label
from usnet_env.provenance import versions


class PolicyLike(Protocol):
    """The methods that a policy needs; :class:`usnet_env.multiagent.policies.Policy` is a base class with them."""

    def reset(self, seed: int, action_space: Any) -> None:
        """Start a game."""

    def act(self, observation: Any) -> Any:
        """Return the action for one observation."""


@dataclass(frozen=True)
class GameResult:
    """The result of one game.

    Args:
        returns: the sum of the rewards of each agent.
        prices: the sum of the prices that each agent paid; 0 in a game without prices.
        J: J_m, the objective of P2.
        rounds: R, the number of rounds.
        success: whether every head was hit.
        first_hits: number of heads hit in the first round.
        first_redundant: number of redundant candidates in the first round.
        redundant: number of redundant candidates in all rounds.
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


def agent_role(agent: str) -> str:
    """Return the role of an agent: ``"observer"`` for ``"observer_0"``."""
    return agent.rpartition("_")[0]


def choose_policies(env: UsnetParallelEnv, policies: Any) -> dict[str, PolicyLike]:
    """Find the policy of each agent in a mapping of agents or roles to policies.

    Raises:
        ArgumentError: an agent has no policy, or a policy lacks a method.
    """
    if not isinstance(policies, Mapping):
        raise ArgumentError(f"policies must be a mapping of agents or roles to policies, got {quote(policies)}.")
    chosen = {}
    for agent in env.possible_agents:
        policy = policies.get(agent, policies.get(agent_role(agent)))
        if policy is None:
            raise ArgumentError(
                f"policies must hold a policy for {agent} or its role {agent_role(agent)}, got {quote(list(policies))}."
            )
        if not all(callable(getattr(policy, method, None)) for method in ("reset", "act")):
            raise ArgumentError(f"policies must have the methods reset and act, got {quote(policy)} for {agent}.")
        if isinstance(policy, DetectorObserver) and agent_role(agent) != "observer":
            label = detector_label(policy.detector)
            raise ArgumentError(f"policies must hold no detector for {agent}, which gets no window, got {label}.")
        chosen[agent] = policy
    return chosen


def play_game(
    env: UsnetParallelEnv,
    policies: Mapping[str, PolicyLike],
    seed: int,
    label: str = "",
    policy_seed: int | None = None,
) -> GameResult:
    """Play one game in Parallel form.

    Args:
        env: one of the games' ``parallel_env``.
        policies: a policy for each agent, or for each role (``"observer"``, ``"head"``). A policy that several agents
            share is copied for each of them; a policy of a single agent is used as it is, without a copy.
        seed: the seed of the game.
        label: name of the detector in the record; by default those of the observers' detectors or policies.
        policy_seed: the seed from which the seeds of the policies come; ``None``: a separate branch of ``seed``.

    Returns:
        The result; ``usnet_env.replay.EpisodeRecord(**result.record)`` is the episode in the form that can be saved.

    Raises:
        ArgumentError: ``env`` is not one of the games, an agent has no policy, or another argument has another type.
    """
    if not isinstance(env, UsnetParallelEnv):
        raise ArgumentError(f"env must be the parallel_env of a usnet_env game, got {quote(env)}.")
    chosen = choose_policies(env, policies)
    seed = whole_number("seed", seed, 0)
    label = plain_text("label", label)
    observations, infos = env.reset(seed=seed)
    uses = Counter(map(id, chosen.values()))
    agents = {name: copy.deepcopy(policy) if uses[id(policy)] > 1 else policy for name, policy in chosen.items()}
    label = label or ", ".join(dict.fromkeys(_name(agents[name]) for name in agents if agent_role(name) == "observer"))
    if policy_seed is None:
        source = np.random.SeedSequence(seed, spawn_key=(1,))
    else:
        source = np.random.SeedSequence(whole_number("policy_seed", policy_seed, 0))
    branches = source.generate_state(len(env.possible_agents), np.uint32)
    for (name, policy), own_seed in zip(agents.items(), branches, strict=True):
        policy.reset(int(own_seed), env.action_space(name))
    returns = dict.fromkeys(env.possible_agents, 0.0)
    prices = dict.fromkeys(env.possible_agents, 0.0)
    rounds: list[RoundRecord] = []
    choices: list[dict[str, str]] = []  # of the agents before each round
    chosen_now: dict[str, str] = {}
    seconds: list[float] = []
    redundant = 0
    first = info = infos[env.possible_agents[0]]
    while env.agents:
        began = time.perf_counter()
        actions = {agent: agents[agent].act(observations[agent]) for agent in env.agents}
        spent = time.perf_counter() - began
        flown, words = chosen_now, {agent: env.describe_action(agent, action) for agent, action in actions.items()}
        observations, rewards, _, _, infos = env.step(actions)
        for agent, reward in rewards.items():
            returns[agent] += reward
            prices[agent] += float(infos[agent].get("price", 0.0))
        costs = {agent: f"; price {infos[agent]['price']:.3g}" if "price" in infos[agent] else "" for agent in words}
        chosen_now = {agent: text + costs[agent] for agent, text in words.items() if text and agent in env.agents}
        info = infos[env.possible_agents[0]]
        redundant += int(info["redundant"])
        if env.last_round is not None:  # None after the opening step, which is not a round
            rounds.append(env.last_round)
            choices.append(flown)
            seconds.append(spent)
            first = info if len(rounds) == 1 else first
    return GameResult(
        returns=returns,
        prices=prices,
        J=float(info["J"]),
        rounds=len(rounds),
        success=bool(info["success"]),
        first_hits=int(first["hits"]),
        first_redundant=int(first["redundant"]),
        redundant=redundant,
        record=_make_record(env, rounds, choices, seconds, seed, label),
    )


def _name(policy: PolicyLike) -> str:
    """The label of a policy's detector, or else the name of its class."""
    detector = getattr(policy, "detector", None)
    return type(policy).__name__ if detector is None else detector_label(detector)


def _make_record(
    env: UsnetParallelEnv,
    rounds: list[RoundRecord],
    choices: list[dict[str, str]],
    seconds: list[float],
    seed: int,
    label: str,
) -> dict[str, Any]:
    config = describe_arguments(env.config) | describe_arguments(env.rules)
    return {
        "position": np.stack([each.sighting.position for each in rounds]),
        "velocity": np.stack([each.sighting.velocity for each in rounds]),
        "seen": np.stack([each.sighting.seen for each in rounds]),
        "alive": np.stack([each.truth.alive for each in rounds]),
        "root": np.stack([each.truth.root for each in rounds]),
        "candidates": np.stack([each.candidates for each in rounds]),
        "scores": np.stack([each.scores for each in rounds]),
        "objective": np.array([each.objective for each in rounds]),
        "head": rounds[0].truth.head,
        "decoy": env.swarm.decoy,  # of the whole episode; a decoy of one window has itself as root in it
        "over_budget": np.array([each.over_budget for each in rounds]),
        "seconds": np.array(seconds),
        "choices": choices if any(choices) else None,
        "observers": env.list_observers(),
        "problem": "P2",
        "env_id": str(env.metadata["name"]),
        "seed": seed,
        "detector": label,
        "config": config,
        "versions": versions(["pettingzoo"]),
    }
