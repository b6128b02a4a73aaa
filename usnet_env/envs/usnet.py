"""The two single-agent environments: P1 and P2 of the paper, two sets of arguments over one game."""

from __future__ import annotations

import copy
from typing import Annotated, Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.envs import game
from usnet_env.swarm import SwarmConfig, SwarmState

__all__ = ["MultiClusterEnv", "SingleClusterEnv", "UsnetEnv"]

Observation = dict[str, NDArray[Any]]


class _Face(Config):
    """The arguments that concern neither the swarm nor the rules."""

    reveal_truth: bool = False
    render_mode: str | None = None


class _Followers(Config):
    """The size of a single cluster, under the name that :class:`SingleClusterEnv` gives it."""

    followers: Annotated[int, Field(ge=2, le=90_000)]
    decoys: Annotated[int, Field(ge=0, le=9_000)]


class UsnetEnv(gym.Env[Observation, NDArray[np.int8]]):
    """What both environments share; use :class:`SingleClusterEnv` or :class:`MultiClusterEnv`.

    Attributes:
        config: the swarm and how it is observed.
        rules: what is played and what it costs.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1}  # type: ignore[misc]

    def __init__(self, config: SwarmConfig, rules: game.Rules, reveal_truth: bool, render_mode: str | None) -> None:
        face = _Face(reveal_truth=reveal_truth, render_mode=render_mode)
        if face.render_mode not in (None, *self.metadata["render_modes"]):
            raise ArgumentError(f"render_mode must be 'rgb_array' or None, got {quote(render_mode)}.")
        self.config = config
        self.rules = rules
        self.reveal_truth = face.reveal_truth
        self.render_mode = face.render_mode
        self.observation_space = game.observation_space(config, rules)  # type: ignore[assignment]  # Dict is invariant
        self.action_space = game.action_space(config)
        self._game: game.GameState | None = None
        self._window: Observation = {}  # the present observation
        self._decided: tuple[Observation, SwarmState, NDArray[np.bool_]] | None = None  # the round before it

    @property
    def problem(self) -> str:
        """``"P1"`` or ``"P2"``."""
        return self.rules.problem

    @property
    def swarm(self) -> SwarmState:
        """The truth about the swarm now, a copy: for referees and pictures, never for a detector."""
        return self._running().swarm.episode()

    def _running(self) -> game.GameState:
        if self._game is None:
            raise ArgumentError("reset must be called first, got an environment that was never reset.")
        return self._game

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode and observe its first window.

        Args:
            seed: seeds this env's own generator, 0 included; ``None`` goes on with the present one.
            options: none are known; ignored.

        Returns:
            The observation and ``info``.
        """
        super().reset(seed=seed)
        state = game.begin(self.config, [self.np_random])
        metrics = game.opening(self.rules, state)
        self._decided = None
        return self._observe(state), self._info(metrics)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Destroy the candidates, score the round, and observe the next window.

        Args:
            action: ``(N,)`` of 0 and 1, the candidates.

        Returns:
            Observation, reward, terminated, truncated, ``info``. A terminated episode shows an empty window (``seen``
            is all 0): there is nothing left to find.

        Raises:
            ArgumentError: an action of another shape or with other values, or a step after the end.
        """
        before = self._running()
        if before.terminated[0] or before.truncated[0]:
            raise ArgumentError("reset must be called first, got a step in an episode that is over.")
        candidates = game.candidates_from(action, (self.config.uavs,))
        state, turn = game.play(self.rules, before, candidates[None])
        self._decided = (self._window, before.swarm, candidates)
        observation = self._observe(state)
        return (
            observation,
            float(turn.reward[0]),
            bool(state.terminated[0]),
            bool(state.truncated[0]),
            self._info(turn.metrics),
        )

    def _observe(self, state: game.GameState) -> Observation:
        self._game, observation = game.observe(self.config, state, [self.np_random])
        self._window = {name: values[0] for name, values in observation.items()}
        return copy.deepcopy(self._window)

    def _info(self, metrics: dict[str, NDArray[Any]]) -> dict[str, Any]:
        info: dict[str, Any] = {name: values[0].item() for name, values in metrics.items()}
        if self.reveal_truth:
            truth = game.truth_info(self.swarm)
            info |= {**truth, "heads_left": int(truth["heads_left"])}
        return info

    def action_masks(self) -> NDArray[np.bool_]:
        """``(2 N,)`` booleans for maskable agents: [may be 0, may be 1] of each UAV; no destroyed UAV may be named."""
        alive = self._running().swarm.alive[0]
        return np.stack([np.ones_like(alive), alive], axis=1).reshape(-1)

    def get_state(self) -> dict[str, Any]:
        """Everything that the rest of the episode depends on, as plain arrays and numbers, copied."""
        state = self._running()
        return {
            "config": self.config.model_dump(),
            "rules": self.rules.model_dump(),
            "swarm": state.swarm.arrays(),
            "game": {name: getattr(state, name).copy() for name in game.COUNTERS},
            "observation": copy.deepcopy(self._window),
            "generator": copy.deepcopy(self.np_random.bit_generator.state),
        }

    def set_state(self, state: dict[str, Any]) -> Observation:
        """Go back to a state from :meth:`get_state` of an env with the same arguments.

        Returns:
            The observation of that moment.

        Raises:
            ArgumentError: a state of an env with other arguments, or no state at all.
        """
        here = {"config": self.config.model_dump(), "rules": self.rules.model_dump()}
        if not isinstance(state, dict) or {name: state.get(name) for name in here} != here:
            raise ArgumentError(
                f"state must come from get_state of an environment with the same arguments, got {quote(state)}."
            )
        saved = copy.deepcopy(state)
        self._game = game.GameState(swarm=SwarmState(**saved["swarm"]), **saved["game"])
        self._window = saved["observation"]
        self._decided = None
        if self._np_random is None:
            super().reset(seed=0)
        self.np_random.bit_generator.state = saved["generator"]
        return copy.deepcopy(self._window)

    def render(self) -> NDArray[np.uint8] | None:
        """The round just decided (before the first: the present window) from above, ``(H, W, 3)`` uint8.

        Returns:
            ``None`` unless ``render_mode="rgb_array"``.
        """
        if self.render_mode is None:
            return None
        from usnet_env.drawing import round_frame  # matplotlib is an extra: only who renders needs it

        state = self._running()
        window, swarm, candidates = self._decided or (self._window, state.swarm, None)
        truth = swarm.episode()
        return round_frame(
            position=window["position"],
            seen=window["seen"].astype(bool),
            alive=truth.alive,
            head=truth.head,
            leader=truth.leader,
            decoy=truth.decoy,
            candidates=candidates,
            title=f"round {int(window['round'][0])}",
        )


class SingleClusterEnv(UsnetEnv):
    """P1: find the head of one cluster in one round.

    ## Description
    One head flies by itself, ``followers`` UAVs follow it by one unknown follow strategy, and perhaps ``decoys`` fly
    like heads but lead nobody. The observer sees one window of positions and velocities and names candidates. The
    episode is one round long (paper §II-B, problem P1).

    ## Action Space
    `MultiBinary(N)`, N = followers + 1 + decoys: 1 for every candidate. Integers, booleans and floats are taken if
    they are 0 or 1.

    ## Observation Space
    `Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(T_ob + 1, N, 3)` | float32 | m | where the UAVs were seen at the sampling instants; 0 if unseen |
    | `velocity` | `(T_ob, N, 3)` | float32 | m/step | velocity between two instants; 0 unless both ends were seen |
    | `seen` | `(T_ob + 1, N)` | int8 | | 1 where the UAV was detected |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed |
    | `round` | `(1,)` | float32 | | number of the round, from 1 |

    ## Rewards
    J_s = 1{head hit} − |Ĥ_1|: 0 for the head alone, −1 for one wrong candidate. The empty answer scores −1 (decision
    k: by the formula it would tie with the optimum). In general 1{hit} − 1 − `redundancy_price` · (|Ĥ_1| − 1), which
    is J_s at price 1. More candidates than `shot_budget` destroy nobody and count as the empty answer.

    `info` holds, at every step and all zero at reset:

    | key | meaning |
    | --- | --- |
    | `hits` | candidates of the round that are heads |
    | `redundant` | candidates of the round that are not living heads |
    | `round` | rounds played |
    | `success` | 1 if no head is left |
    | `J` | J_s, at price 1 |
    | `over_budget` | 1 if the round had more candidates than `shot_budget` |
    | `reward_hit` | the part of the reward for the hit: 0 if the head is a candidate, else −1 |
    | `reward_redundancy` | the rest of the reward: the price of redundant candidates |

    ## Starting State
    Roles sit at random indices; the layout is `formation`. The first window starts when everyone has followed for
    `memory` steps.

    ## Episode End
    Terminates after the one round. Never truncates.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `follow` | `"f1"` | follow strategy: `"f1"` to `"f7"`, a registered one, or `"none"` (control: nobody follows) |
    | `mobility` | `"iid"` | how heads and decoys move: `iid`, `gauss_markov`, `smooth_turn`, `waypoint`, … |
    | `formation` | `"uniform"` | `uniform` in 1000 × 1000 × 100 m, or `around` the head |
    | `followers` | 15 | m, at least 2 |
    | `observation_steps` | 100 | T_ob, velocity samples |
    | `memory` | 4 | T_0, steps a follow strategy may look back |
    | `sample_every` | 1 | the observer samples every k-th step |
    | `position_noise` | 0 | standard deviation of observed positions, m |
    | `miss_rate` | 0 | probability of a missed detection |
    | `decoys` | 0 | UAVs that fly like heads and lead nobody |
    | `head_jitter` | `False` | heads and decoys get the followers' noise |
    | `follow_seed` | `None` | fixes f7's network; else a new one each episode |
    | `shot_budget` | `None` | most candidates |
    | `redundancy_price` | 1 | price of a redundant candidate |
    | `reveal_truth` | `False` | `info` also holds `head`, `decoy`, `leader`, `heads_left` |
    | `render_mode` | `None` | `"rgb_array"` |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        follow: str = "f1",
        mobility: str = "iid",
        formation: str = "uniform",
        followers: int = 15,
        observation_steps: int = 100,
        memory: int = 4,
        sample_every: int = 1,
        position_noise: float = 0.0,
        miss_rate: float = 0.0,
        decoys: int = 0,
        head_jitter: bool = False,
        follow_seed: int | None = None,
        shot_budget: int | None = None,
        redundancy_price: float = 1.0,
        reveal_truth: bool = False,
        render_mode: str | None = None,
    ) -> None:
        size = _Followers(followers=followers, decoys=decoys)
        config = SwarmConfig(
            follow=follow,
            mobility=mobility,
            formation=formation,
            clusters=1,
            uavs=size.followers + 1 + size.decoys,
            observation_steps=observation_steps,
            memory=memory,
            sample_every=sample_every,
            position_noise=position_noise,
            miss_rate=miss_rate,
            decoys=decoys,
            head_jitter=head_jitter,
            follow_seed=follow_seed,
        )
        rules = game.Rules(problem="P1", max_rounds=1, shot_budget=shot_budget, redundancy_price=redundancy_price)
        super().__init__(config, rules, reveal_truth, render_mode)


class MultiClusterEnv(UsnetEnv):
    """P2: find all heads of a swarm of unknown clusters, in few rounds and with few redundant candidates.

    ## Description
    N UAVs fly in M clusters. Each follower obeys one follow strategy, the same for all and unknown, with respect to
    its cluster's head. Each round the observer sees a window, names candidates, these are destroyed, orphans re-merge
    to the nearest remaining head, and after `memory` steps the next window begins (paper §II, problem P2).

    ## Action Space
    `MultiBinary(N)`: 1 for every candidate. A destroyed UAV may be named; it counts as redundant. Integers, booleans
    and floats are taken if they are 0 or 1.

    ## Observation Space
    `Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(T_ob + 1, N, 3)` | float32 | m | where the UAVs were seen at the sampling instants; 0 if unseen |
    | `velocity` | `(T_ob, N, 3)` | float32 | m/step | velocity between two instants; 0 unless both ends were seen |
    | `seen` | `(T_ob + 1, N)` | int8 | | 1 where the UAV was detected |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed; indices are kept |
    | `round` | `(1,)` | float32 | | number of the round, from 1 |

    ## Rewards
    −(1 + `redundancy_price` · redundant / N) a round, with redundant = |Ĥ_r ∖ H_{r−1}|. At price 1 the return of an
    episode is −J_m, J_m = R + (1/N) Σ_r |Ĥ_r ∖ H_{r−1}|. An empty answer is a round. More candidates than
    `shot_budget` destroy nobody; the round counts and `info["over_budget"]` is 1.

    J_m alone is won by destroying everything (1 + (N − M)/N < 2): look at it beside precision, recall and rounds.

    `info` holds, at every step and all zero at reset:

    | key | meaning |
    | --- | --- |
    | `hits` | candidates of the round that are heads |
    | `redundant` | candidates of the round that are not living heads |
    | `round` | rounds played |
    | `success` | 1 if no head is left |
    | `J` | J_m of the rounds played so far, at price 1 |
    | `over_budget` | 1 if the round had more candidates than `shot_budget` |
    | `reward_round` | the part of the reward for the round, −1 |
    | `reward_redundancy` | the rest of the reward: the price of redundant candidates |

    As long as heads are left, none of these values depends on M: `heads_left` needs `reveal_truth=True`.

    ## Starting State
    Roles sit at random indices; cluster sizes are `cluster_sizes` or random with at least 2 followers each; the layout
    is `formation`. The first window starts when everyone has followed for `memory` steps.

    ## Episode End
    Terminates when no head is left: the environment knows, the observer can't (decision m). The last window is then
    empty. Truncates after `max_rounds` rounds with a head left.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `follow` | `"f1"` | follow strategy: `"f1"` to `"f7"`, a registered one, or `"none"` (control: nobody follows) |
    | `mobility` | `"iid"` | how heads and decoys move: `iid`, `gauss_markov`, `smooth_turn`, `waypoint`, … |
    | `formation` | `"uniform"` | `uniform` in 1000 × 1000 × 100 m, or `around` the heads |
    | `clusters` | 5 | M |
    | `uavs` | 82 | N, decoys included |
    | `cluster_sizes` | `None` | followers of each cluster; they add up to `uavs` − `clusters` − `decoys` |
    | `observation_steps` | 100 | T_ob, velocity samples a window |
    | `memory` | 4 | T_0, steps a follow strategy may look back |
    | `sample_every` | 1 | the observer samples every k-th step |
    | `position_noise` | 0 | standard deviation of observed positions, m |
    | `miss_rate` | 0 | probability of a missed detection |
    | `decoys` | 0 | UAVs that fly like heads and lead nobody |
    | `head_jitter` | `False` | heads and decoys get the followers' noise |
    | `follow_seed` | `None` | fixes f7's network; else a new one each episode |
    | `max_rounds` | 20 | R_m |
    | `shot_budget` | `None` | most candidates a round |
    | `redundancy_price` | 1 | price of a redundant candidate |
    | `reveal_truth` | `False` | `info` also holds `head`, `decoy`, `leader`, `heads_left` |
    | `render_mode` | `None` | `"rgb_array"` |

    ## Version History
    * v0: first version
    """

    def __init__(
        self,
        follow: str = "f1",
        mobility: str = "iid",
        formation: str = "uniform",
        clusters: int = 5,
        uavs: int = 82,
        cluster_sizes: tuple[int, ...] | list[int] | None = None,
        observation_steps: int = 100,
        memory: int = 4,
        sample_every: int = 1,
        position_noise: float = 0.0,
        miss_rate: float = 0.0,
        decoys: int = 0,
        head_jitter: bool = False,
        follow_seed: int | None = None,
        max_rounds: int = 20,
        shot_budget: int | None = None,
        redundancy_price: float = 1.0,
        reveal_truth: bool = False,
        render_mode: str | None = None,
    ) -> None:
        config = SwarmConfig(
            follow=follow,
            mobility=mobility,
            formation=formation,
            clusters=clusters,
            uavs=uavs,
            cluster_sizes=cluster_sizes,  # type: ignore[arg-type]  # a list is taken and made a tuple
            observation_steps=observation_steps,
            memory=memory,
            sample_every=sample_every,
            position_noise=position_noise,
            miss_rate=miss_rate,
            decoys=decoys,
            head_jitter=head_jitter,
            follow_seed=follow_seed,
        )
        rules = game.Rules(
            problem="P2", max_rounds=max_rounds, shot_budget=shot_budget, redundancy_price=redundancy_price
        )
        super().__init__(config, rules, reveal_truth, render_mode)
