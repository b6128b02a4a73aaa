"""The base class of both games: agents, spaces, checks of actions, the state for a critic, and pictures."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Mask, Observation, Singles
from usnet_env.config import ArgumentError, MissingExtraError, how_to_install, optional_seed, quote
from usnet_env.drawing import EpisodeFrames
from usnet_env.envs import game
from usnet_env.envs.game import GameState, Rules
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState
from usnet_env.swarm.config import Count, SizeArguments, SwarmArguments

try:
    from pettingzoo import AECEnv, ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec_wrapper
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper
except ImportError:
    raise MissingExtraError(f"Games with several agents need PettingZoo; {how_to_install('multiagent')}.") from None

Infos = dict[str, dict[str, int | float]]
#: Observations and infos by agent.
Start = tuple[dict[str, Observation], Infos]
#: Observations, rewards, terminations, truncations and infos by agent.
Step = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]


@dataclass(frozen=True, eq=False)
class RoundRecord:
    """One finished round, without leading axes."""

    sighting: ObservationBatch  # in the observers' game, the merged sightings of all observers
    truth: SwarmState  # before the candidates were destroyed
    candidates: Mask
    scores: Floats  # the candidates are chosen by them
    metrics: dict[str, int | float]  # those of ``info``


class GameArguments(game.RenderArguments, game.RoundArguments, SizeArguments, SwarmArguments):
    """The arguments that both games take."""

    max_cycles: Count | None = Field(None, description="most steps; `usnet_evasion_v0` has one more than rounds")

    def make_rules(self, opening: int = 0) -> Rules:
        """The rules of P2; ``opening`` is the number of steps before the first round."""
        limit = self.max_rounds if self.max_cycles is None else min(self.max_rounds, self.max_cycles - opening)
        return self.part(Rules, max_rounds=limit)


def to_scalars(metrics: Mapping[str, NDArray[Any]]) -> dict[str, int | float]:
    """The metrics of a batch of one game as plain numbers."""
    return {name: values[0].item() for name, values in metrics.items()}


class UsnetParallelEnv(ParallelEnv[str, Observation, Any]):  # type: ignore[misc]  # PettingZoo ships no types
    """Base class of the games, in PettingZoo's Parallel form.

    Attributes:
        config: the configuration of the swarm.
        rules: the rules of the game.
        last_round: the round of the last step; ``None`` before the first round.
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
        self.config = config
        self.rules = rules
        self.render_mode = render_mode
        self.possible_agents = list(observation_spaces)
        self.agents: list[str] = []
        self._observation_spaces = observation_spaces
        self._action_spaces = action_spaces
        far, fast, uavs = config.position_bound(rules.max_rounds + 1), config.speed_bound, config.uavs
        high = np.tile(np.array([far] * 3 + [fast] * 3 + [1, 1, 1, uavs - 1], np.float32), uavs)
        low = np.tile(np.array([-far] * 3 + [-fast] * 3 + [0, 0, 0, -1], np.float32), uavs)
        first, last = np.zeros(1, np.float32), np.full(1, rules.max_rounds, np.float32)
        self.state_space = spaces.Box(np.append(low, first), np.append(high, last), dtype=np.float32)
        self._rng = seeding.np_random()[0]
        self._game: GameState | None = None
        self._sighting: ObservationBatch | None = None  # the current window
        self.last_round: RoundRecord | None = None
        self._frames = EpisodeFrames()

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observation space of an agent."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The action space of an agent."""
        return self._action_spaces[agent]

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true swarm, for evaluation and pictures; observers never receive it."""
        return game.require_game(self._game).swarm.episode()

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Start:
        """Start a game with a seed of its generator (``None`` keeps the present one); ``options`` have no effect.

        Raises:
            ArgumentError: the seed is not a whole number from 0.
        """
        if (seed := optional_seed("seed", seed)) is not None:
            self._rng = seeding.np_random(seed)[0]
        self.agents, self.last_round = list(self.possible_agents), None
        return self._start(self._rng)

    @abstractmethod
    def _start(self, rng: np.random.Generator) -> Start:
        """Start a game, whose agents all live: the answer of :meth:`reset`."""

    @abstractmethod
    def step(self, actions: Any) -> Step:
        """Play a round with an action of each living agent, and fly the next window.

        Raises:
            ArgumentError: an action is missing, or has a wrong shape or wrong values, or the game has ended.
        """

    def _check_actions(self, actions: Any) -> dict[str, Any]:
        """The actions, one for each living agent."""
        game.require_game(self._game if self.agents else None)
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            names = ", ".join(self.agents)
            raise ArgumentError(f"actions must map each of {names} to its action, got {quote(actions)}.")
        return dict(actions)

    def _play_round(self, candidates: Mask, scores: Floats) -> tuple[GameState, float, dict[str, NDArray[Any]]]:
        """Play a round, and keep it as :attr:`last_round`: the game after it, the reward, and the metrics."""
        before = game.require_game(self._game)
        state, rewards, metrics = game.play_round(self.rules, before, candidates[None])
        truth = self._reveal_swarm(before)
        self.last_round = RoundRecord(self._current_window(), truth, candidates, scores, to_scalars(metrics))
        return state, float(rewards[0]), metrics

    def state(self) -> Singles:
        """The true state for a centralised critic, ``(10 N + 1,)`` float32.

        For each UAV: position (m), velocity (m/step), 1 if it is alive, 1 if it is a head, 1 if it is a decoy, and the
        index of its root (-1 if it has none). The last value is the number of rounds played.
        """
        state = game.require_game(self._game)
        swarm = self._reveal_swarm(state)
        columns = [swarm.position, swarm.past_velocity[-1], swarm.alive, swarm.head, swarm.decoy, swarm.root]
        return np.append(np.column_stack(columns), state.rounds[0]).astype(np.float32)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last round, or the current window before the first round, ``(H, W, 3)`` uint8."""
        if not game.has_mode(self.render_mode):
            return None
        if self.last_round is not None:
            last, title = self.last_round, game.title_round(self.last_round.metrics)
            sighting, truth, candidates = last.sighting, last.truth, last.candidates
        else:
            self._frames = EpisodeFrames()
            truth = self._reveal_swarm(game.require_game(self._game))
            sighting, candidates, title = self._current_window(), None, game.UNANSWERED
        self._frames.watch(sighting.position, sighting.seen)
        return self._frames.render(
            position=sighting.position, seen=sighting.seen, candidates=candidates, title=title, **truth.roles()
        )

    def describe_action(self, agent: str, action: Any) -> str:
        """Describe what an agent chose, for replays; empty for an action that candidates and scores show."""
        return ""

    def list_observers(self) -> Floats | None:
        """``(K, 4)``, position and sensing range of each observer in metres; ``None`` if the observer has no place."""
        return None

    def _reveal_swarm(self, state: GameState) -> SwarmState:
        """A copy of the true swarm, without a leading axis, as it was in the window that ``state`` ends with."""
        return state.swarm.episode()

    def _current_window(self) -> ObservationBatch:
        """The current window; an empty one before the first window."""
        return self._sighting or ObservationBatch.unseen(self.config, game.require_game(self._game).swarm.alive[0])

    def _make_observation(self, sighting: ObservationBatch, legal: Mask) -> Observation:
        """An observation with copies of the arrays of a window and the mask ``legal``."""
        shown = game.show_window(sighting, game.require_game(self._game).rounds)
        return {**copy.deepcopy(shown), "legal": legal.astype(np.int8)}


def make_aec_forms(form: type[UsnetParallelEnv]) -> tuple[Callable[..., AECEnv], Callable[..., AECEnv]]:
    """Make the functions ``raw_env`` and ``env`` of a game, which create its AEC form and take its arguments."""

    def raw_env(**arguments: Any) -> AECEnv:
        """Create the AEC form without the wrapper that enforces the order of calls."""
        return parallel_to_aec_wrapper(form(**arguments))

    def env(**arguments: Any) -> AECEnv:
        """Create the AEC form."""
        return OrderEnforcingWrapper(raw_env(**arguments))

    return raw_env, env
