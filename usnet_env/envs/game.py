"""The rules of the detection rounds, for a batch of B games; a single environment is a batch of one."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from gymnasium import logger, spaces
from numpy.typing import NDArray
from pydantic import Field, model_validator

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, Config, format_count, quote
from usnet_env.objectives import hits_and_redundant, single_cluster_objective
from usnet_env.swarm import SwarmConfig, SwarmState, destroy
from usnet_env.swarm.config import Count, Price
from usnet_env.swarm.state import Rows
from usnet_env.window import as_array

Part = Literal["position", "velocity", "seen", "alive", "round"]
PARTS: tuple[Part, ...] = ("position", "velocity", "seen", "alive", "round")  # of an observation
TYPES: dict[str, type] = dict.fromkeys(PARTS, np.float32) | dict.fromkeys(("seen", "alive"), np.int8)
COUNTERS = ("uavs", "rounds", "redundant", "terminated", "truncated")
UNANSWERED = "round 1: observed, no answer yet"  # the title of the picture of a window before the first round


class ShotArguments(Config):
    """The arguments about candidates, which both problems have."""

    shot_budget: Count | None = Field(None, description="most candidates in a round; a larger set destroys no UAV")
    redundancy_price: Price = Field(1.0, description="price of a redundant candidate; 1 gives the paper's objective")


class RoundArguments(ShotArguments):
    """The arguments of P2."""

    max_rounds: Annotated[int, Field(ge=1, le=10_000)] = Field(
        20, description="R_m, rounds until the game is truncated"
    )


class Rules(RoundArguments):
    """The rules: the problem, its limits and its prices."""

    problem: Literal["P1", "P2"] = Field("P2", description="one cluster and one round, or rounds until no head is left")

    @model_validator(mode="after")
    def _warn_of_free_candidates(self) -> Self:
        if self.redundancy_price == 0 and self.shot_budget is None:
            warnings.warn("redundancy_price is 0, so to name all UAVs is the best answer.", stacklevel=2)
        return self


class RenderArguments(Config):
    """The argument about pictures."""

    render_mode: Literal["rgb_array"] | None = Field(None, description='``"rgb_array"`` to draw pictures')


@dataclass(frozen=True)
class GameState:
    """B games between two rounds; each array is ``(B,)``."""

    swarm: SwarmState
    uavs: Indices  # at the start; a smaller swarm of a batch doesn't fill its arrays
    rounds: Indices  # played so far
    redundant: Indices  # candidates in all rounds
    terminated: Mask  # whether the game ended by its rules
    truncated: Mask  # whether the game was stopped after ``max_rounds``

    def rows(self, games: Rows) -> Self:
        """Some games of the batch."""
        counters = {name: getattr(self, name)[games] for name in COUNTERS}
        return replace(self, swarm=self.swarm.rows(games), **counters)

    def with_rows(self, games: Indices, other: GameState) -> Self:
        """A copy of this batch in which ``other`` replaces some games."""
        counters = {name: getattr(self, name).copy() for name in COUNTERS}
        for name, values in counters.items():
            values[games] = getattr(other, name)
        return replace(self, swarm=self.swarm.with_rows(games, other.swarm), **counters)


def window_spaces(steps: int, uavs: int, rounds: int, reach: float, speed: float) -> dict[str, spaces.Space[Any]]:
    """The spaces of a window's arrays, with bounds of the coordinates in metres and in metres per step."""
    return {
        "position": spaces.Box(-reach, reach, (steps + 1, uavs, 3), np.float32),
        "velocity": spaces.Box(-speed, speed, (steps, uavs, 3), np.float32),
        "seen": spaces.MultiBinary((steps + 1, uavs)),
        "alive": spaces.MultiBinary(uavs),
        "round": spaces.Box(1, rounds, (1,), np.float32),
    }


def observation_space(config: SwarmConfig, rules: Rules, observe: Sequence[str] = PARTS) -> spaces.Dict:
    """The space of the observed parts of one environment's windows: bounded boxes and masks."""
    rounds = rules.max_rounds + 1  # after the last round of a truncated episode another window is observed
    reach, speed = config.position_bound(rounds), config.velocity_bound()
    parts = window_spaces(config.observation_steps, config.uavs, rounds, reach, speed)
    return spaces.Dict({name: parts[name] for name in observe})


def require_game(state: GameState | None) -> GameState:
    """The games that have been started, if there are any."""
    if state is None:
        raise ArgumentError("reset must be called first, got a game that has not begun or is over.")
    return state


def has_mode(render_mode: str | None) -> bool:
    """Whether pictures are drawn; if not, a warning says what draws them."""
    if render_mode is None:
        logger.warn("render() returns None, because the environment was made without render_mode='rgb_array'.")
    return render_mode is not None


def parse_candidates(action: Any, shape: tuple[int, ...], name: str = "action") -> Mask:
    """Convert an action (integers, booleans or floats) to booleans of the given shape; errors call it ``name``."""
    values = as_array(name, action)
    if values.shape != shape or values.dtype.kind not in "biuf" or not ((values == 0) | (values == 1)).all():
        raise ArgumentError(f"{name} must have shape {shape} and hold only 0 and 1, got {quote(action)}.")
    return values.astype(bool)


def check_options(options: Any) -> None:
    """Refuse options of ``reset``: all properties of a game are arguments of its constructor."""
    if options:
        raise ArgumentError(f"options must be empty, since a game is changed by its arguments, got {quote(options)}.")


def play_round(rules: Rules, state: GameState, candidates: Mask) -> tuple[GameState, Floats, dict[str, NDArray[Any]]]:
    """Play one round: score and destroy the candidates; followers of a destroyed head re-merge.

    Returns:
        The games after the round, the reward ``(B,)`` float64, and the metrics of ``info`` by name, each ``(B,)``.
    """
    swarm, count = state.swarm, candidates.sum(axis=1)
    budget = candidates.shape[1] if rules.shot_budget is None else rules.shot_budget
    over_budget = count > budget
    fired = candidates & ~over_budget[:, None]
    hits, redundant = hits_and_redundant(swarm.head, swarm.alive, fired)
    next_swarm = destroy(swarm, fired)
    heads_left = next_swarm.heads_left
    rounds, total_redundant = state.rounds + 1, state.redundant + redundant
    price = rules.redundancy_price
    if rules.problem == "P1":
        # J_s is the sum of the cost of an answer without a head and the cost of every other redundant candidate.
        objective = single_cluster_objective(swarm.head, fired)
        hit_reward = np.where((hits > 0) | (objective == 0), 0.0, -1.0)
        terms = {"reward_hit": hit_reward, "reward_redundancy": price * (objective - hit_reward)}
        terminated, truncated = np.ones(len(heads_left), bool), np.zeros(len(heads_left), bool)
    else:
        terms = {"reward_round": np.full(len(heads_left), -1.0), "reward_redundancy": -price * redundant / state.uavs}
        objective = rounds + total_redundant / state.uavs
        terminated = heads_left == 0
        truncated = ~terminated & (rounds >= rules.max_rounds)
    reward = sum(terms.values(), np.zeros(len(heads_left)))
    metrics = {
        "hits": hits,
        "redundant": redundant,
        "round": rounds,
        "success": (heads_left == 0).astype(np.int64),
        "is_success": heads_left == 0,
        "J": objective,
        "over_budget": over_budget.astype(np.int64),
        **terms,
    }
    return GameState(next_swarm, state.uavs, rounds, total_redundant, terminated, truncated), reward, metrics


def title_round(metrics: Mapping[str, Any]) -> str:
    """The title of the picture of a round, from its metrics as plain numbers: its result, J so far, and the reward."""
    reward = sum(value for name, value in metrics.items() if name.startswith("reward_"))
    result = f"{format_count(metrics['hits'], 'head')} hit, {metrics['redundant']} redundant"
    result = "over the shot budget" if metrics["over_budget"] else result
    return f"round {metrics['round']}: {result}   J {metrics['J']:.3f}   reward {reward:.3f}"


def truth_info(swarm: SwarmState) -> dict[str, NDArray[Any]]:
    """The entries that ``reveal_truth`` adds to ``info``: the roles, and ``heads_left``, which with ``hits`` gives M.

    ``head`` and ``decoy`` ``(B, N)`` int8, ``root`` and ``leader`` ``(B, N)`` int64, ``heads_left`` ``(B,)`` int64.
    """
    return {
        "head": swarm.head.astype(np.int8),
        "decoy": swarm.decoy.astype(np.int8),
        "root": swarm.root,
        "leader": swarm.leader,
        "heads_left": swarm.heads_left,
    }
