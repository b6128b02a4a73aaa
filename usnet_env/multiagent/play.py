"""Play one game with a policy for every role, and return its result."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from usnet_env.config import ArgumentError, describe_arguments, quote
from usnet_env.multiagent.base import UsnetParallelEnv
from usnet_env.multiagent.policies import DetectorObserver, Policy
from usnet_env.plugins import detector_label
from usnet_env.provenance import versions


@dataclass(frozen=True)
class GameResult:
    """The result of one game.

    Args:
        returns: the sum of the rewards of each agent.
        prices: the sum of the prices that each agent paid; 0 in a game without prices.
        J: J_m, the objective of P2.
        rounds: R, the number of rounds.
        success: whether every head was hit.
        redundant: number of redundant candidates in all rounds.
        record: the arguments of :class:`usnet_env.replay.EpisodeRecord`, from which replays and figures are made.
    """

    returns: dict[str, float]
    prices: dict[str, float]
    J: float
    rounds: int
    success: bool
    redundant: int
    record: dict[str, Any]


def choose_policies(env: UsnetParallelEnv, policies: Mapping[str, Any]) -> dict[str, Policy]:
    """The policy of each agent in a mapping of agents or roles to policies."""
    chosen = {}
    for agent in env.possible_agents:
        role = agent.rpartition("_")[0]
        policy = policies.get(agent, policies.get(role))
        if policy is None or (isinstance(policy, DetectorObserver) and role != "observer"):
            raise ArgumentError(
                f"policies must hold a policy for {agent} or its role {role}, and detectors for observers only, "
                f"got {quote(dict(policies))}."
            )
        chosen[agent] = policy
    return chosen


def play_game(env: UsnetParallelEnv, policies: Mapping[str, Policy], seed: int, label: str = "") -> GameResult:
    """Play one game in Parallel form.

    Args:
        env: one of the games' ``parallel_env``.
        policies: a policy for each agent, or for each role (``"observer"``, ``"head"``). A policy that several agents
            share is copied for each of them.
        seed: the seed of the game; those of the policies come from a separate branch of it.
        label: name of the detector in the record; by default those of the observers' detectors or policies.

    Raises:
        ArgumentError: an agent has no policy, or the seed is no whole number.
    """
    chosen = choose_policies(env, policies)
    uses = [id(policy) for policy in chosen.values()]
    agents = {name: copy.deepcopy(each) if uses.count(id(each)) > 1 else each for name, each in chosen.items()}
    observations, _ = env.reset(seed=seed)
    source = np.random.SeedSequence(seed, spawn_key=(1,))
    for (name, policy), number in zip(agents.items(), source.generate_state(len(agents), np.uint32), strict=True):
        policy.reset(int(number), env.action_space(name))
    returns, prices = dict.fromkeys(agents, 0.0), dict.fromkeys(agents, 0.0)
    rounds, choices, seconds = [], [], []
    chosen_before: dict[str, str] = {}  # the choices of the heads for the window that is seen now, in words
    while env.agents:
        began = time.perf_counter()
        actions = {agent: agents[agent].act(observations[agent]) for agent in env.agents}
        spent = time.perf_counter() - began
        words = {agent: env.describe_action(agent, action) for agent, action in actions.items()}
        observations, rewards, _, _, infos = env.step(actions)
        for agent, reward in rewards.items():
            returns[agent] += reward
            prices[agent] += infos[agent].get("price", 0.0)
        if env.last_round is not None:  # None after the opening step, which is not a round
            rounds.append(env.last_round)
            choices.append(chosen_before)
            seconds.append(spent)
        chosen_before = {
            agent: f"{text}; price {infos[agent]['price']:.3g}"
            for agent, text in words.items()
            if text and agent in env.agents
        }
    labels = [
        detector_label(policy.detector) if isinstance(policy, DetectorObserver) else type(policy).__name__
        for agent, policy in agents.items()
        if agent.startswith("observer")
    ]
    arrays = {name: np.array([played[name] for played in rounds]) for name in rounds[0]}
    kept = ("position", "velocity", "seen", "alive", "root", "candidates", "scores")
    record = {
        **{name: arrays[name] for name in kept},
        "objective": arrays["J"],
        "over_budget": arrays["over_budget"].astype(bool),
        "head": env.swarm.head,
        "decoy": env.swarm.decoy,  # of the whole episode; a decoy of one window has itself as root in it
        "observers": env.list_observers(),
        "problem": "P2",
        "env_id": str(env.metadata["name"]),
        "config": describe_arguments(env.config) | describe_arguments(env.rules),
        "versions": versions(["pettingzoo"]),
        "seconds": np.array(seconds),
        "choices": choices if any(choices) else None,
        "seed": int(seed),
        "detector": label or ", ".join(dict.fromkeys(labels)),
    }
    return GameResult(
        returns,
        prices,
        J=float(arrays["J"][-1]),
        rounds=len(rounds),
        success=bool(arrays["success"][-1]),
        redundant=int(arrays["redundant"].sum()),
        record=record,
    )
