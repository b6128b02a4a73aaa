"""What both games share: agents and spaces by name, the borders, the state for a critic, pictures and records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.drawing import MissingExtraError
from usnet_env.envs.game import GameState, Rules
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState

try:
    from pettingzoo import AECEnv, ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec_wrapper
    from pettingzoo.utils.wrappers import BaseParallelWrapper, OrderEnforcingWrapper
except ImportError:
    raise MissingExtraError("Games of several agents need PettingZoo: pip install 'usnet[multiagent]'.") from None

__all__ = [
    "AECEnv",
    "BaseParallelWrapper",
    "Decided",
    "Observation",
    "Step",
    "UsnetParallelEnv",
    "in_turns",
    "in_turns_and_order",
    "rules_of",
    "scalars",
]

Observation = dict[str, NDArray[Any]]
Step = tuple[
    dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, int | float]]
]


@dataclass(frozen=True, eq=False)
class Decided:
    """One round, decided: what was seen, who led whom, and who was named.

    Args:
        sighting: the window without a leading axis; in the observers' game, what they saw together.
        truth: the swarm before the candidates were destroyed, without a leading axis.
        candidates: ``(N,)`` bool.
        scores: ``(N,)`` float64, what the candidates were chosen by.
        objective: J_m after the round.
        over_budget: more candidates than the shot budget: nobody was destroyed.
    """

    sighting: ObservationBatch
    truth: SwarmState
    candidates: NDArray[np.bool_]
    scores: NDArray[np.float64]
    objective: float
    over_budget: bool


def rules_of(
    max_rounds: int, max_cycles: int | None, before: int, shot_budget: int | None, redundancy_price: float
) -> Rules:
    """The rules of P2; ``max_cycles`` is PettingZoo's name for the most steps, ``before`` of which are no round.

    Raises:
        ArgumentError: a number out of its range.
    """
    rules = Rules(problem="P2", max_rounds=max_rounds, shot_budget=shot_budget, redundancy_price=redundancy_price)
    if max_cycles is None:
        return rules
    if isinstance(max_cycles, bool) or not isinstance(max_cycles, int | np.integer) or max_cycles < 1 + before:
        raise ArgumentError(f"max_cycles must be None or a whole number from {1 + before}, got {quote(max_cycles)}.")
    return rules.model_copy(update={"max_rounds": min(rules.max_rounds, int(max_cycles) - before)})


def scalars(metrics: Mapping[str, NDArray[Any]]) -> dict[str, int | float]:
    """The metrics of a batch of one game as plain numbers."""
    return {name: values[0].item() for name, values in metrics.items()}


class UsnetParallelEnv(ParallelEnv[str, Observation, Any]):  # type: ignore[misc]  # PettingZoo ships no types
    """A game of several agents in Parallel form; the AEC form is made of it by PettingZoo's own conversion.

    Attributes:
        config: the swarm.
        rules: what is played and what it costs.
        possible_agents: all agents, fixed.
        agents: those still in the game.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1, "is_parallelizable": True}

    def __init__(
        self,
        config: SwarmConfig,
        rules: Rules,
        render_mode: str | None,
        observation_spaces: dict[str, spaces.Dict],
        action_spaces: dict[str, spaces.Space[Any]],
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ArgumentError(f"render_mode must be 'rgb_array' or None, got {quote(render_mode)}.")
        self.config = config
        self.rules = rules
        self.render_mode = render_mode
        self.possible_agents = list(observation_spaces)
        self.agents: list[str] = []
        self._observation_spaces = observation_spaces
        self._action_spaces = action_spaces
        far, uavs = config.position_bound(rules.max_rounds + 1), config.uavs
        high = np.tile(np.array([far] * 3 + [1.001] * 3 + [1, 1, 1, uavs - 1], np.float32), uavs)
        low = np.tile(np.array([-far] * 3 + [-1.001] * 3 + [0, 0, 0, -1], np.float32), uavs)
        first, last = np.zeros(1, np.float32), np.full(1, rules.max_rounds, np.float32)
        self.state_space = spaces.Box(np.append(low, first), np.append(high, last), dtype=np.float32)
        self._rng: np.random.Generator | None = None
        self._game: GameState | None = None
        self._sighting: ObservationBatch | None = None  # the present window
        self.decided: Decided | None = None  # the round before it

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observations of an agent; the same object every time."""
        return self._of(self._observation_spaces, agent)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The actions of an agent; the same object every time."""
        return self._of(self._action_spaces, agent)

    def _of(self, values: Mapping[str, Any], agent: str) -> Any:
        if agent not in values:
            raise ArgumentError(f"agent must be one of {', '.join(self.possible_agents)}, got {quote(agent)}.")
        return values[agent]

    @property
    def swarm(self) -> SwarmState:
        """The truth about the swarm now, a copy: for referees and pictures, never for an observer."""
        return self._running().swarm.episode()

    def _running(self) -> GameState:
        if self._game is None:
            raise ArgumentError("reset must be called first, got a game that was never reset.")
        return self._game

    def _generator(self, seed: int | None) -> np.random.Generator:
        """The game's own generator, seeded anew unless ``seed`` is ``None`` and there is one."""
        if seed is not None or self._rng is None:
            if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
                raise ArgumentError(f"seed must be a whole number from 0 or None, got {quote(seed)}.")
            self._rng = seeding.np_random(None if seed is None else int(seed))[0]
        return self._rng

    def _checked(self, actions: Any) -> dict[str, Any]:
        """The actions of a step, one for each living agent."""
        if not self.agents:
            raise ArgumentError("reset must be called first, got a step in a game that is over or never began.")
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            got = sorted(map(str, actions)) if isinstance(actions, Mapping) else actions
            raise ArgumentError(f"actions must map each of {', '.join(self.agents)} to its action, got {quote(got)}.")
        return dict(actions)

    def state(self) -> NDArray[np.float32]:
        """The truth for a centralised critic, ``(10 N + 1,)`` float32.

        For every UAV position (m), velocity (m/step), whether it lives, whether it is a head, whether it is a decoy,
        and the index of its leader (-1: none); then the rounds played.
        """
        game = self._running()
        swarm = self._truth(game)
        columns = [swarm.alive, swarm.head, swarm.decoy, swarm.leader]
        table = np.concatenate(
            [swarm.position, swarm.past_velocity[-1], np.stack(columns, axis=1).astype(np.float32)], axis=1
        )
        return np.append(table.reshape(-1), game.rounds[0]).astype(np.float32)

    def render(self) -> NDArray[np.uint8] | None:
        """The round just decided (before the first: the present window) from above, ``(H, W, 3)`` uint8.

        Returns:
            ``None`` unless ``render_mode="rgb_array"``.
        """
        if self.render_mode is None:
            return None
        from usnet_env.drawing import round_frame  # matplotlib is an extra: only who renders needs it

        game = self._running()
        if self.decided is not None:
            sighting, truth, candidates = self.decided.sighting, self.decided.truth, self.decided.candidates
            number = int(game.rounds[0])
        else:
            sighting, truth, candidates, number = self._window(), self._truth(game), None, int(game.rounds[0]) + 1
        return round_frame(
            position=sighting.position,
            seen=sighting.seen,
            alive=truth.alive,
            head=truth.head,
            leader=truth.leader,
            decoy=truth.decoy,
            candidates=candidates,
            title=f"round {number}",
        )

    def close(self) -> None:
        """Nothing is held open."""

    def __str__(self) -> str:
        """The game's name."""
        return str(self.metadata["name"])

    def _truth(self, state: GameState) -> SwarmState:
        """Who led whom in the window that ``state`` ends with, a copy without a leading axis."""
        return state.swarm.episode()

    def _window(self) -> ObservationBatch:
        """The present window; an empty one where none was flown."""
        return self._sighting if self._sighting is not None else self._empty()

    def _empty(self) -> ObservationBatch:
        """A window in which nobody is seen."""
        instants, uavs = self.config.observation_steps + 1, self.config.uavs
        return ObservationBatch(
            position=np.zeros((instants, uavs, 3), np.float32),
            velocity=np.zeros((instants - 1, uavs, 3), np.float32),
            seen=np.zeros((instants, uavs), bool),
            alive=self._running().swarm.alive[0].copy(),
        )

    def _seen_by(self, sighting: ObservationBatch, legal: NDArray[np.bool_]) -> Observation:
        """The observation that a window can be made of, and who may be named; nothing in it is shared."""
        return {
            "position": sighting.position.copy(),
            "velocity": sighting.velocity.copy(),
            "seen": sighting.seen.astype(np.int8),
            "alive": sighting.alive.astype(np.int8),
            "round": (self._running().rounds + 1).astype(np.float32),
            "legal": legal.astype(np.int8),
        }


def in_turns(game: UsnetParallelEnv) -> AECEnv:
    """The AEC form of a game: agents act in turn, and the last one's action makes the step."""
    return parallel_to_aec_wrapper(game)


def in_turns_and_order(game: UsnetParallelEnv) -> AECEnv:
    """The AEC form in PettingZoo's wrapper that refuses calls in a wrong order."""
    return OrderEnforcingWrapper(in_turns(game))
