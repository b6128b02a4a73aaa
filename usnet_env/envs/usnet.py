"""The two single-agent environments: the paper's problems P1 and P2, with the same game behind both."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Self

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Mask, Observation
from usnet_env.config import ArgumentError, list_arguments, optional_seed, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.batch import SwarmGames
from usnet_env.envs.distribution import DistributionArguments, EpisodeSampler
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


class OutputArguments(game.RenderArguments):
    """The arguments about the output of an environment: ``info`` and pictures."""

    observe: Annotated[Sequence[game.Part], Field(min_length=1)] | None = Field(
        None, description="the parts of the observation to return; ``None``: all, which a detector needs"
    )
    reveal_truth: bool = Field(
        False, description="``info`` also holds ``head``, ``decoy``, ``root``, ``leader``, ``heads_left``"
    )


class ClusterArguments(OutputArguments, SensorArguments, MobilityArguments, SwarmArguments):
    """The arguments of environments with one cluster."""

    instead: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("clusters", "uavs", "cluster_sizes"), "there is one cluster; its size is 'followers'"
    )

    followers: Annotated[int, Field(ge=2, le=90_000)] = Field(15, description="m, number of followers, at least 2")


class SingleClusterArguments(DistributionArguments, game.ShotArguments, BystanderArguments, ClusterArguments):
    """The arguments of :class:`SingleClusterEnv`."""


class MultiClusterArguments(DistributionArguments, OutputArguments, game.RoundArguments, SwarmConfig):
    """The arguments of :class:`MultiClusterEnv`."""

    instead: ClassVar[Mapping[str, str]] = {
        "followers": "the sizes are 'clusters', 'uavs' and 'cluster_sizes'",
        "max_episode_steps": "in a batch, 'max_rounds' limits an episode",
    }


def make_cluster(arguments: ClusterArguments, drawn: dict[str, Any], size: int | None) -> SwarmConfig:
    """The swarm of P1, in arrays for ``size`` UAVs."""
    values = dict(arguments) | drawn
    uavs = 1 + sum(values.get(name, 0) for name in ("followers", "decoys", "bystanders", "traffic", "clutter"))
    size, changes = size or uavs, {name: value for name, value in drawn.items() if name != "followers"}
    return arguments.part(SwarmConfig, **changes, clusters=1, uavs=size, absent=size - uavs)


def _make_clusters(arguments: MultiClusterArguments, drawn: dict[str, Any], size: int | None) -> SwarmConfig:
    """The swarm of P2, in arrays for ``size`` UAVs."""
    uavs = drawn.get("uavs", arguments.uavs)
    size = size or uavs
    return arguments.part(SwarmConfig, **drawn | {"uavs": size, "absent": arguments.absent + size - uavs})


def _make_game_property(name: str) -> Any:
    """A property of an environment that its batch holds for each game."""
    return property(
        lambda env: getattr(env._games, name)[env._number],
        lambda env, value: getattr(env._games, name).__setitem__(env._number, value),
    )


class UsnetEnv(gym.Env[Observation, NDArray[np.int8]]):
    """Base class of :class:`SingleClusterEnv` and :class:`MultiClusterEnv`: one game of a batch, mostly of one game.

    Attributes:
        config: the swarm of the present episode and its observer.
        widest_config: a swarm whose bounds hold in all episodes.
        rules: the problem, its limits and its prices.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1}  # type: ignore[misc]  # Gymnasium's is no ClassVar

    config = _make_game_property("configs")
    _np_random, _np_random_seed = _make_game_property("rngs"), _make_game_property("seeds")

    def __init__(self, sampler: EpisodeSampler, rules: game.Rules, output: OutputArguments) -> None:
        self._sampler, self.rules, self.widest_config = sampler, rules, sampler.widest
        self.reveal_truth = output.reveal_truth
        self.render_mode = output.render_mode
        space = game.observation_space(sampler.widest, rules, output.observe or game.PARTS)
        self.observation_space, self.observe = space, tuple(space)  # type: ignore[assignment]  # Dict is invariant
        self.action_space = spaces.MultiBinary(sampler.widest.uavs)
        self._games, self._number = self._make_games(1), 0

    def _make_games(self, num_envs: int) -> SwarmGames:
        """A batch of games with the arguments of this environment."""
        pictures = self.render_mode is not None
        return SwarmGames(num_envs, self.widest_config, self.rules, self._sampler.draw, pictures=pictures)

    def _view_game(self, games: SwarmGames, number: int) -> Self:
        """An environment that stands for one game of a batch."""
        view = copy.copy(self)
        view._games, view._number = games, number
        return view

    @property
    def problem(self) -> str:
        """``"P1"`` or ``"P2"``."""
        return self.rules.problem

    @property
    def swarm(self) -> SwarmState:
        """A copy of the true state of the swarm, for evaluation and rendering; a detector must not use it."""
        return self._games.game.swarm.episode(self._number)

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
        _ = self.np_random  # made here, if there is none
        self._games.start(np.array([self._number]))
        self._games.fly(np.array([self._number]))
        return self._games.observe(self.observe, self._number), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Destroy the candidates, ``(N,)`` of 0 and 1, score the round, and observe the next window.

        After termination the window is empty (``seen`` is all 0), because no head is left.

        Raises:
            ArgumentError: the action has another shape or other values, or the episode has ended.
        """
        games, number = self._games, self._number
        games.require_running(number)
        reward = float(games.play_round(games.parse_action(action), games.all_games == number)[number])
        games.fly(np.array([number]))
        ends = bool(games.game.terminated[number]), bool(games.game.truncated[number])
        return games.observe(self.observe, number), reward, *ends, self._info()

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = {name: values[self._number].item() for name, values in self._games.metrics.items()}
        if self.reveal_truth:
            truth = game.truth_info(self.swarm)
            info |= {**truth, "heads_left": int(truth["heads_left"]), **self._sampler.drawn_values(self.config)}
        return info

    def action_masks(self) -> Mask:
        """``(2 N,)`` bool for maskable agents: for each UAV whether 0 and whether 1 is allowed (1 only if it lives)."""
        return self._games.action_masks(self._number)

    def _settings(self) -> dict[str, Any]:
        """What all states of an environment share: its arguments."""
        configs = {"widest_config": self.widest_config, "distribution": self._sampler.distribution, "rules": self.rules}
        return {name: config.model_dump() for name, config in configs.items()}

    def get_state(self) -> dict[str, Any]:
        """A copy of the complete state of the episode as plain arrays and numbers."""
        state = self._games.game.rows([self._number])
        return {
            "config": self.config.model_dump(),
            "swarm": state.swarm.arrays(),
            "game": {name: getattr(state, name) for name in game.COUNTERS},
            "observation": self._games.observe(game.PARTS, self._number),
            "generator": copy.deepcopy(self.np_random.bit_generator.state),
            **self._settings(),
        }

    def set_state(self, state: dict[str, Any]) -> Observation:
        """Restore a state from :meth:`get_state` of an environment with the same arguments, and show its observation.

        Raises:
            ArgumentError: the state is of an environment with other arguments.
        """
        settings = self._settings()
        if not isinstance(state, Mapping) or {name: state.get(name) for name in settings} != settings:
            raise ArgumentError(f"state must come from get_state with the same arguments, got {quote(state)}.")
        saved = copy.deepcopy(state)
        restored = game.GameState(swarm=SwarmState(**saved["swarm"]), **saved["game"])
        self._games.load_game(self._number, SwarmConfig(**saved["config"]), restored, saved["observation"])
        self.np_random.bit_generator.state = saved["generator"]
        return self._games.observe(self.observe, self._number)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last round, or before the first one the present window, as seen from above, ``(H, W, 3)`` uint8.

        The axes fit the first window with a margin, and change only if a later window does not fit. Crosses mark UAVs
        that were destroyed in earlier rounds. Without ``render_mode="rgb_array"``, it warns and returns ``None``.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        return self._games.draw(self._number) if game.has_mode(self.render_mode) else None


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
    candidates, and a head that is not named costs nothing: report `recall_first` and `success`, too. With none, the
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
        super().__init__(EpisodeSampler(arguments, partial(make_cluster, arguments)), rules, arguments)


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
        super().__init__(EpisodeSampler(arguments, partial(_make_clusters, arguments)), rules, arguments)
