"""The two single-agent environments: the paper's problems P1 and P2, with the same game behind both."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Mask, Observation
from usnet_env.config import ArgumentError, list_arguments, optional_seed, quote, takes_arguments
from usnet_env.drawing import EpisodeFrames
from usnet_env.envs import game
from usnet_env.envs.distribution import DrawnArguments, Draws
from usnet_env.swarm import SwarmConfig, SwarmState
from usnet_env.swarm.config import BystanderArguments, MobilityArguments, SensorArguments, SwarmArguments

# Parts of the docstrings of all environments.
OBSERVATION = """`Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(T_ob + 1, N, 3)` | float32 | m | observed positions at the sampling instants; 0 if not detected |
    | `velocity` | `(T_ob, N, 3)` | float32 | m/step | velocity between two instants; 0 unless detected at both |
    | `seen` | `(T_ob + 1, N)` | int8 | | 1 if the UAV was detected |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed; indices never change |
    | `round` | `(1,)` | float32 | | number of the round, from 1 |"""
INFO = """`info` holds, at every step and all zero at reset:

    | key | meaning |
    | --- | --- |
    | `hits` | candidates of the round that are heads |
    | `redundant` | candidates of the round that are not living heads |
    | `round` | rounds played |
    | `success` | 1 if no head is left |
    | `is_success` | the same as a boolean, under the name that Stable-Baselines3 reads at the end of an episode |
    | `J` | J_s or, for the rounds played so far, J_m, at price 1 |
    | `over_budget` | 1 if the round had more candidates than `shot_budget` |"""
INFO_P2 = f"""{INFO}
    | `reward_round` | the part of the reward for the round, −1 |
    | `reward_redundancy` | the rest of the reward: the price of redundant candidates |"""

LastRound = tuple[Observation, SwarmState, Mask, str]


class OutputArguments(game.RenderArguments):
    """The arguments about the output of an environment: ``info`` and pictures."""

    observe: Annotated[Sequence[game.Part], Field(min_length=1)] | None = Field(
        None, description="the parts of the observation to return; ``None``: all, which a detector needs"
    )
    reveal_truth: bool = Field(
        False, description="``info`` also holds ``head``, ``decoy``, ``root``, ``leader``, ``heads_left``"
    )


class SingleClusterArguments(
    DrawnArguments,
    OutputArguments,
    game.ShotArguments,
    SensorArguments,
    BystanderArguments,
    MobilityArguments,
    SwarmArguments,
):
    """The arguments of :class:`SingleClusterEnv`."""

    instead: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("clusters", "uavs", "cluster_sizes"), "there is one cluster; its size is 'followers'"
    )

    followers: Annotated[int, Field(ge=2, le=90_000)] = Field(15, description="m, number of followers, at least 2")


class MultiClusterArguments(DrawnArguments, OutputArguments, game.RoundArguments, SwarmConfig):
    """The arguments of :class:`MultiClusterEnv`."""

    instead: ClassVar[Mapping[str, str]] = {
        "followers": "the sizes are 'clusters', 'uavs' and 'cluster_sizes'",
        "max_episode_steps": "in a batch, 'max_rounds' limits an episode",
    }


def _make_cluster(arguments: SingleClusterArguments, drawn: dict[str, Any], most: int | None) -> SwarmConfig:
    """The swarm of P1, in arrays for ``most`` UAVs."""
    given = dict(arguments) | drawn
    uavs = 1 + sum(given[name] for name in ("followers", "decoys", "bystanders", "traffic", "clutter"))
    most, values = most or uavs, {name: value for name, value in drawn.items() if name != "followers"}
    return arguments.part(SwarmConfig, **values, clusters=1, uavs=most, absent=most - uavs)


def _make_clusters(arguments: MultiClusterArguments, drawn: dict[str, Any], most: int | None) -> SwarmConfig:
    """The swarm of P2, in arrays for ``most`` UAVs."""
    uavs = drawn.get("uavs", arguments.uavs)
    most = most or uavs
    return arguments.part(SwarmConfig, **drawn | {"uavs": most, "absent": arguments.absent + most - uavs})


class UsnetEnv(gym.Env[Observation, NDArray[np.int8]]):
    """Base class of :class:`SingleClusterEnv` and :class:`MultiClusterEnv`.

    Attributes:
        config: the swarm of the present episode and its observer.
        widest_config: a swarm whose bounds hold in all episodes.
        rules: the problem, its limits and its prices.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1}  # type: ignore[misc]  # Gymnasium's is no ClassVar

    def __init__(self, draws: Draws, rules: game.Rules, output: OutputArguments) -> None:
        self._draws = draws
        self.config = self.widest_config = config = draws.widest
        self.rules = rules
        self.reveal_truth = output.reveal_truth
        self.render_mode = output.render_mode
        seen = game.observation_space(config, rules, output.observe or game.PARTS)
        self.observation_space, self.observe = seen, tuple(seen)  # type: ignore[assignment]  # Dict is invariant
        self.action_space = spaces.MultiBinary(config.uavs)
        self._game: game.GameState | None = None
        self._window: Observation = {}  # the present observation
        # The round before it: window, swarm, candidates, and title of its frame.
        self._last_round: LastRound | None = None
        self._frames = EpisodeFrames()

    @property
    def problem(self) -> str:
        """``"P1"`` or ``"P2"``."""
        return self.rules.problem

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true state of the swarm, for evaluation and rendering; a detector must not use it."""
        return game.require_game(self._game).swarm.episode()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode and observe its first window.

        Args:
            seed: seed of the environment's own generator; ``None`` keeps the present generator.
            options: none; a game is changed by the arguments of the environment.

        Raises:
            ArgumentError: the seed is not a whole number from 0, or there are options.
        """
        game.check_options(options)
        super().reset(seed=optional_seed("seed", seed))
        self.config = self._draws.draw(self.np_random)
        state = game.start_games([self.config], [self.np_random])
        metrics = game.initial_info(self.rules, state)
        self._last_round, self._frames = None, EpisodeFrames()
        return self._observe(state), self._info(metrics)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Destroy the candidates, ``(N,)`` of 0 and 1, score the round, and observe the next window.

        After termination the window is empty (``seen`` is all 0), because no head is left.

        Raises:
            ArgumentError: the action has another shape or other values, or the episode has ended.
        """
        before = game.require_game(self._game)
        game.require_game(None if before.terminated[0] or before.truncated[0] else before)
        candidates = game.parse_candidates(action, (self.config.uavs,))
        state, rewards, metrics = game.play_round(self.rules, before, candidates[None])
        title = game.title_round({name: value[0].item() for name, value in metrics.items()})
        self._last_round = (self._window, before.swarm, candidates, title)
        observation, over = self._observe(state), (bool(state.terminated[0]), bool(state.truncated[0]))
        return observation, float(rewards[0]), *over, self._info(metrics)

    def _observe(self, state: game.GameState) -> Observation:
        self._game, observation = game.observe_windows([self.config], state, [self.np_random])
        return self._show({name: values[0] for name, values in observation.items()})

    def _show(self, window: Observation) -> Observation:
        """Keep the present window, and return a copy."""
        self._window = window
        if self.render_mode is not None:
            self._frames.watch(window["position"], window["seen"].astype(bool))
        return {name: window[name].copy() for name in self.observe}

    def show_round(self, window: Observation, last_round: LastRound | None) -> None:
        """Keep the present window and the round before it, for pictures; without a last round a game begins."""
        self._last_round = last_round
        if last_round is None:
            self._frames = EpisodeFrames()
        self._show(window)

    def place(
        self, config: SwarmConfig, state: game.GameState, window: Observation, rng: np.random.Generator, seed: int
    ) -> None:
        """Become a game that is played elsewhere, with its generator."""
        self.config = config
        self._game, self._window, self._np_random, self._np_random_seed = state, window, rng, seed

    def _info(self, metrics: dict[str, NDArray[Any]]) -> dict[str, Any]:
        info: dict[str, Any] = {name: values[0].item() for name, values in metrics.items()}
        if self.reveal_truth:
            truth = game.truth_info(self.swarm)
            info |= {**truth, "heads_left": int(truth["heads_left"]), **self._draws.reveal(self.config)}
        return info

    def action_masks(self) -> Mask:
        """``(2 N,)`` bool for maskable agents: for each UAV whether 0 and whether 1 is allowed (1 only if it lives)."""
        alive = game.require_game(self._game).swarm.alive[0]
        return np.stack([np.ones_like(alive), alive], axis=1).reshape(-1)

    def _settings(self) -> dict[str, Any]:
        """What all states of an environment share: its arguments."""
        shared = {"widest_config": self.widest_config, "distribution": self._draws.distribution, "rules": self.rules}
        return {name: part.model_dump() for name, part in shared.items()}

    def get_state(self) -> dict[str, Any]:
        """A copy of the complete state of the episode as plain arrays and numbers."""
        state = game.require_game(self._game)
        return {
            "config": self.config.model_dump(),
            "swarm": state.swarm.arrays(),
            "game": {name: getattr(state, name).copy() for name in game.COUNTERS},
            "observation": copy.deepcopy(self._window),
            "generator": copy.deepcopy(self.np_random.bit_generator.state),
            **self._settings(),
        }

    def set_state(self, state: dict[str, Any]) -> Observation:
        """Restore a state from :meth:`get_state` of an environment with the same arguments, and show its observation.

        Raises:
            ArgumentError: the state is of an environment with other arguments.
        """
        here = self._settings()
        if {name: state.get(name) for name in here} != here:
            raise ArgumentError(f"state must come from get_state with the same arguments, got {quote(state)}.")
        saved = copy.deepcopy(state)
        self.config = SwarmConfig(**saved["config"])
        self._game = game.GameState(swarm=SwarmState(**saved["swarm"]), **saved["game"])
        self._last_round, self._frames = None, EpisodeFrames()
        if self._np_random is None:
            super().reset(seed=0)
        self.np_random.bit_generator.state = saved["generator"]
        return self._show(saved["observation"])

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last round, or before the first one the present window, as seen from above, ``(H, W, 3)`` uint8.

        The axes fit the first window with a margin, and change only if a later window does not fit. Crosses mark UAVs
        that were destroyed in earlier rounds. Without ``render_mode="rgb_array"``, it warns and returns ``None``.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        if not game.has_mode(self.render_mode):
            return None
        state = game.require_game(self._game)
        window, swarm, candidates, title = self._last_round or (self._window, state.swarm, None, game.UNANSWERED)
        roles, seen = swarm.episode().roles(), window["seen"].astype(bool)
        scene = {"position": window["position"], "intruders": window.get("intruders"), **roles}
        return self._frames.render(seen=seen, candidates=candidates, title=title, **scene)


@list_arguments(observation=OBSERVATION, info=INFO)
class SingleClusterEnv(UsnetEnv):
    """P1: find the head of one cluster in one round.

    ## Description
    One head moves independently, and `followers` UAVs follow it by an unknown follow strategy. Optional `decoys` move
    like heads but have no followers. The agent receives one window of positions and velocities and names its
    candidates for the head. The episode has one round (paper §II-B, problem P1).

    ## Action Space
    `MultiBinary(N)`, N = followers + 1 + decoys: 1 for every candidate. Integers, booleans and floats are accepted if
    they are 0 or 1.

    ## Observation Space
    {observation}

    ## Rewards
    J_s = |Ĥ_1 ∩ H_0| − |Ĥ_1|, where Ĥ_1 are the candidates and H_0 is the head: 0 for the head alone, −1 for one wrong
    candidate. An empty set scores −1 (decision k; the formula would give it 0, the optimum). The reward is −1 for an
    answer that names no head, plus `redundancy_price` times the rest of J_s; at price 1 it is J_s. A set of more than
    `shot_budget` candidates destroys no UAV and counts as an empty set.

    Some [field models](../field.md) have several heads or none. With several, J_s is minus the number of redundant
    candidates, and a head that is not named costs nothing: report `recall_first` and `success` beside J. With none, the
    empty set is the right answer and scores 0.

    {info}
    | `reward_hit` | the part of the reward for the hit: 0 if a head is a candidate or the answer is right, else −1 |
    | `reward_redundancy` | the rest of the reward: the price of redundant candidates |

    ## Starting State
    Roles have random indices; `formation` gives the initial positions. The first window starts after all followers
    have followed for `memory` steps.

    ## Episode End
    The episode terminates after one round. It is never truncated.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """

    @takes_arguments(SingleClusterArguments)
    def __init__(self, arguments: SingleClusterArguments) -> None:
        rules = arguments.part(game.Rules, problem="P1", max_rounds=1)
        super().__init__(Draws(arguments, partial(_make_cluster, arguments)), rules, arguments)


@list_arguments(observation=OBSERVATION, info=INFO_P2)
class MultiClusterEnv(UsnetEnv):
    """P2: find all heads of a swarm with unknown clusters, in few rounds and with few redundant candidates.

    ## Description
    N UAVs form M clusters. All followers use the same unknown follow strategy with respect to the head of their
    cluster. In each round the agent receives a window and names its candidates, which are destroyed. Followers of a
    destroyed head join the nearest remaining head (re-merge), and after `memory` steps the next window begins
    (paper §II, problem P2).

    ## Action Space
    `MultiBinary(N)`: 1 for every candidate. A candidate that is already destroyed counts as redundant. Integers,
    booleans and floats are accepted if they are 0 or 1.

    ## Observation Space
    {observation}

    ## Rewards
    −(1 + `redundancy_price` · redundant / N) per round, with redundant = |Ĥ_r ∖ H_{r−1}|, where Ĥ_r are the
    candidates of round r and H_{r−1} the heads left before it. At price 1 the return of an episode is −J_m,
    J_m = R + (1/N) Σ_r |Ĥ_r ∖ H_{r−1}|. An empty set counts as a round. A set of more than `shot_budget` candidates
    destroys no UAV; the round counts and `info["over_budget"]` is 1.

    To destroy all UAVs in round 1 gives J_m = 1 + (N − M)/N < 2, which beats every answer that needs two rounds
    (decision l). So report J_m together with precision, recall and rounds.

    {info}

    As long as heads are left, none of these values depends on M: `heads_left` needs `reveal_truth=True`.

    ## Starting State
    Roles have random indices. Cluster sizes are `cluster_sizes`, or random with at least 2 followers each; `formation`
    gives the initial positions. The first window starts after all followers have followed for `memory` steps.

    ## Episode End
    The episode terminates when no head is left; only the environment can know this (decision m). The last window is
    then empty. The episode is truncated after `max_rounds` rounds if a head is left (decision n).

    ## Arguments
    {arguments}

    The ids `USNET/Field-…` draw [another kind of swarm](../field.md#the-environment) in every episode. In some no UAV
    leads: H_0 is empty, the right answer is the empty set, and the game ends after one round.

    ## Version History
    * v0: first version
    """

    @takes_arguments(MultiClusterArguments)
    def __init__(self, arguments: MultiClusterArguments) -> None:
        rules = arguments.part(game.Rules, problem="P2")
        super().__init__(Draws(arguments, partial(_make_clusters, arguments)), rules, arguments)
