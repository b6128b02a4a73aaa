"""The game of detection rounds, for a batch of B episodes at once; a single env is a batch of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.objectives import hits_and_redundant
from usnet_env.swarm import Sighting, SwarmConfig, SwarmState, advance, destroy, start

COUNTERS = ("rounds", "redundant", "terminated", "truncated")

__all__ = [
    "COUNTERS",
    "GameState",
    "Rules",
    "Turn",
    "action_space",
    "begin",
    "candidates_from",
    "observation_space",
    "observe",
    "opening",
    "play",
    "truth_info",
]

Observation = dict[str, NDArray[Any]]


class Rules(Config):
    """What is played and what it costs.

    Args:
        problem: ``"P1"`` (one cluster, one round) or ``"P2"`` (rounds until no head is left).
        max_rounds: R_m, after which P2 is truncated.
        shot_budget: most candidates of a round; with more, nobody is destroyed. ``None``: no limit.
        redundancy_price: price of a redundant candidate; 1 is the paper's objective.
    """

    problem: Literal["P1", "P2"] = "P2"
    max_rounds: Annotated[int, Field(ge=1, le=10_000)] = 20
    shot_budget: Annotated[int, Field(ge=1, le=100_000)] | None = None
    redundancy_price: Annotated[float, Field(ge=0, le=1e6)] = 1.0


@dataclass(frozen=True)
class GameState:
    """B games between two rounds.

    Args:
        swarm: the truth.
        rounds: ``(B,)`` int64, rounds played.
        redundant: ``(B,)`` int64, redundant candidates of all rounds.
        terminated: ``(B,)`` bool, the game has ended by its rules.
        truncated: ``(B,)`` bool, it was cut off at ``max_rounds``.
    """

    swarm: SwarmState
    rounds: NDArray[np.int64]
    redundant: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    def with_rows(self, episodes: NDArray[np.intp], other: GameState) -> Self:
        """This batch with some of its games exchanged for those of ``other``."""
        changed: dict[str, Any] = {"swarm": self.swarm.with_rows(episodes, other.swarm)}
        for name in COUNTERS:
            changed[name] = getattr(self, name).copy()
            changed[name][episodes] = getattr(other, name)
        return replace(self, **changed)


@dataclass(frozen=True)
class Turn:
    """What a round gives back, each ``(B,)``: rewards, and the metrics of ``info`` by name."""

    reward: NDArray[np.float64]
    metrics: dict[str, NDArray[Any]]


def observation_space(config: SwarmConfig, rules: Rules) -> spaces.Dict:
    """The observation of one env: finite boxes and masks."""
    instants, uavs = config.observation_steps + 1, config.uavs
    far, fast = config.position_bound(rules.max_rounds), config.velocity_bound()
    return spaces.Dict(
        {
            "position": spaces.Box(-far, far, (instants, uavs, 3), np.float32),
            "velocity": spaces.Box(-fast, fast, (instants - 1, uavs, 3), np.float32),
            "seen": spaces.MultiBinary((instants, uavs)),
            "alive": spaces.MultiBinary(uavs),
            "round": spaces.Box(1, rules.max_rounds + 1, (1,), np.float32),
        }
    )


def action_space(config: SwarmConfig) -> spaces.MultiBinary:
    """The action of one env: one bit a UAV."""
    return spaces.MultiBinary(config.uavs)


def candidates_from(action: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """The action as booleans of that shape; agents send int8, booleans or floats.

    Raises:
        ArgumentError: another shape, or anything but 0 and 1.
    """
    try:
        values = np.asarray(action)
    except ValueError:
        values = np.empty(0, object)
    if values.shape != shape:
        raise ArgumentError(f"action must have shape {shape} (one 0 or 1 a UAV), got {quote(action)}.")
    if values.dtype.kind not in "biuf" or not ((values == 0) | (values == 1)).all():
        raise ArgumentError(f"action must hold only 0 and 1, got {quote(action)}.")
    return values.astype(bool)


def begin(config: SwarmConfig, rngs: Sequence[np.random.Generator]) -> GameState:
    """B new games, one a generator."""
    swarm = start(config, rngs)
    zeros = np.zeros(len(rngs), np.int64)
    return GameState(swarm, zeros, zeros.copy(), zeros.astype(bool), zeros.astype(bool))


def play(rules: Rules, state: GameState, candidates: NDArray[np.bool_]) -> tuple[GameState, Turn]:
    """One round: the candidates ``(B, N)`` are destroyed and scored; orphans re-merge."""
    swarm, uavs = state.swarm, candidates.shape[1]
    named = candidates.sum(axis=1)
    budget = uavs if rules.shot_budget is None else rules.shot_budget
    over_budget = named > budget
    fired = candidates & ~over_budget[:, None]
    hits, redundant = hits_and_redundant(swarm.head, swarm.alive, fired)
    after = destroy(swarm, fired)
    left = after.heads_left
    rounds, total = state.rounds + 1, state.redundant + redundant
    price = rules.redundancy_price
    if rules.problem == "P1":
        # J_s = 1{hit} - |C| splits into what a miss costs and what every candidate beyond one costs.
        shots = fired.sum(axis=1)
        missed = np.where(shots > 0, hits - 1.0, -1.0)  # decision (k): the empty answer scores -1
        extra = -np.maximum(shots - 1, 0.0)
        terms = {"reward_hit": missed, "reward_redundancy": price * extra}
        objective = missed + extra
        terminated = np.ones(len(left), bool)
        truncated = np.zeros(len(left), bool)
    else:
        terms = {"reward_round": np.full(len(left), -1.0), "reward_redundancy": -price * redundant / uavs}
        objective = rounds + total / uavs
        terminated = left == 0
        truncated = ~terminated & (rounds >= rules.max_rounds)
    reward = sum(terms.values(), np.zeros(len(left)))
    metrics = {
        "hits": hits,
        "redundant": redundant,
        "round": rounds,
        "success": (left == 0).astype(np.int64),
        "J": objective,
        "over_budget": over_budget.astype(np.int64),
        **terms,
    }
    return GameState(after, rounds, total, terminated, truncated), Turn(reward, metrics)


def opening(rules: Rules, state: GameState) -> dict[str, NDArray[Any]]:
    """The metrics of ``info`` before the first round: the names of :func:`play`, all zero."""
    count = len(state.rounds)
    first = "reward_hit" if rules.problem == "P1" else "reward_round"
    return {
        **{name: np.zeros(count, np.int64) for name in ("hits", "redundant", "round", "success")},
        "J": np.zeros(count),
        "over_budget": np.zeros(count, np.int64),
        first: np.zeros(count),
        "reward_redundancy": np.zeros(count),
    }


def truth_info(swarm: SwarmState) -> dict[str, NDArray[Any]]:
    """What ``reveal_truth`` adds to ``info``: the roles and ``heads_left``, which with ``hits`` tells M.

    Args:
        swarm: B swarms, or one without the leading axis.

    Returns:
        ``head``, ``decoy`` ``(B, N)`` int8, ``leader`` ``(B, N)`` int64 and ``heads_left`` ``(B,)`` int64.
    """
    return {
        "head": swarm.head.astype(np.int8),
        "decoy": swarm.decoy.astype(np.int8),
        "leader": swarm.leader,
        "heads_left": swarm.heads_left,
    }


def observe(
    config: SwarmConfig, state: GameState, rngs: Sequence[np.random.Generator]
) -> tuple[GameState, Observation]:
    """Fly the next window of every game that has not terminated; the others see an empty one.

    Returns:
        The games after the flight, and the observation with a leading axis B.
    """
    going = np.flatnonzero(~state.terminated)
    if len(going) == len(rngs):
        swarm, sighting = advance(config, state.swarm, rngs)
        return replace(state, swarm=swarm), _observation(state, sighting)
    instants, uavs = config.observation_steps + 1, config.uavs
    whole = Sighting(
        position=np.zeros((len(rngs), instants, uavs, 3), np.float32),
        velocity=np.zeros((len(rngs), instants - 1, uavs, 3), np.float32),
        seen=np.zeros((len(rngs), instants, uavs), bool),
        alive=state.swarm.alive,
    )
    swarm = state.swarm
    if len(going):
        part, sighting = advance(config, state.swarm.rows(going), [rngs[int(b)] for b in going])
        swarm = state.swarm.with_rows(going, part)
        for field in fields(Sighting):
            if field.name != "alive":
                getattr(whole, field.name)[going] = getattr(sighting, field.name)
    return replace(state, swarm=swarm), _observation(state, whole)


def _observation(state: GameState, sighting: Sighting) -> Observation:
    return {
        "position": sighting.position,
        "velocity": sighting.velocity,
        "seen": sighting.seen.view(np.int8),
        "alive": sighting.alive.astype(np.int8),
        "round": (state.rounds[:, None] + 1).astype(np.float32),
    }
