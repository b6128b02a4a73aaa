"""``usnet_evasion_v0``: heads choose how to fly in order to evade detection."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Indices, Observation
from usnet_env.config import ArgumentError, format_count, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.multiagent import base
from usnet_env.multiagent.evasion import Manoeuvres, Plan, compute_prices, fly_window, select_decoys
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState
from usnet_env.swarm.config import SensorArguments, Steps
from usnet_env.swarm.flock_follow import Flock

OBSERVER = "observer_0"


class EvasionArguments(base.GameArguments, SensorArguments, Manoeuvres):
    """The arguments of :class:`parallel_env`."""

    memory: Steps = Field(8, description="T_0; at least the lags of the follow strategy + ``most_delay``")


@list_arguments()
class parallel_env(base.UsnetParallelEnv):  # PettingZoo's name for it
    """One observer against M heads that choose how to fly in the next window (adversarial).

    ## Description
    The swarm and the rounds are those of `USNET/MultiCluster-v0`. In addition, each head chooses before every window
    how to fly in it: its mobility, whether it flies with the followers' noise (jitter), how many of its nearest
    followers become decoys (they fly freely by the head's mobility for this window), and how many steps its followers
    are delayed. Each choice has a price. The observer names candidates, which are destroyed; a destroyed head leaves
    the game. If every head always chooses 0, the flight equals that of `USNET/MultiCluster-v0`, bit for bit.

    ## Agents
    `observer_0`, and `head_0` to `head_{M-1}` in the order of the heads' indices, which are random.

    ## Steps
    All agents act at the same time: the observer names candidates for the window that it has just seen, and the heads
    choose for the next window; the choices of heads that are destroyed in this step are ignored. The first step, the
    opening, is not a round: no window has been seen yet (`seen` and `legal` are 0), and only the heads choose.

    ## Action Space
    Observer: `MultiBinary(N)`, the candidates. A destroyed UAV may be named, and counts as redundant.

    Head: `MultiDiscrete([mobilities, 2, most_decoys + 1, most_delay + 1])`: mobility (0 is the swarm's own), jitter,
    decoys, delay. A head keeps at least one follower; if it chooses more decoys than that allows, it gets the largest
    possible number.

    ## Observation Space
    Observer: `position`, `velocity`, `seen`, `alive` and `round` of `USNET/MultiCluster-v0`, and `legal` `(N,)`: 1 for
    the living UAVs, 0 for all UAVs in the opening.

    Head: `Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(N, 3)` | float32 | m | current positions of all UAVs; 0 for destroyed ones |
    | `velocity` | `(N, 3)` | float32 | m/step | current velocities of all UAVs; 0 for destroyed ones |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed |
    | `self` | `(N,)` | int8 | | 1 for this head |
    | `heads` | `(N,)` | int8 | | 1 for living heads |
    | `followers` | `(N,)` | int8 | | 1 for the followers of this head, including its decoys |
    | `named` | `(N,)` | int8 | | 1 for the candidates of the previous round |
    | `round` | `(1,)` | float32 | | number of rounds played |
    | `legal` | `(sum of choices,)` | int8 | | 1 for each legal value of each choice |

    ## Rewards
    Observer: the reward of P2, −(1 + `redundancy_price` · redundant / N) in each round and 0 in the opening. With price
    1 its return is −J_m.

    Head: the negative reward of the observer, minus the price of the head's choice for the next window. A head that is
    destroyed in a step still gets the reward of this step, and pays nothing.

    The price of a choice, in rounds, is the sum of `mobility_price` · s for another mobility, `jitter_price` · s for
    jitter, `decoy_price` · d / N for d decoys, and `delay_price` · delay · f. Here s is the share of the swarm in the
    head's cluster, the head included, and f is the share that follows the head, without decoys.

    `info` is that of `USNET/MultiCluster-v0` and `price`: what a head pays, and for the observer the sum of all heads.

    ## Starting State
    That of `USNET/MultiCluster-v0` with the same seed, before the first window.

    ## Episode End
    A head terminates when it is destroyed. When the last head is destroyed, the observer terminates as well. After
    `max_rounds` rounds all remaining agents are truncated.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {**base.UsnetParallelEnv.metadata, "name": "usnet_evasion_v0"}

    @takes_arguments(EvasionArguments)
    def __init__(self, arguments: EvasionArguments) -> None:
        self.manoeuvres = arguments.part(Manoeuvres)
        rules = arguments.make_rules(opening=1)
        config = arguments.part(SwarmConfig, mobility=arguments.mobilities[0])
        clusters, uavs, most_delay = config.clusters, config.uavs, arguments.most_delay
        strategy = config.follow_strategy
        if strategy is None or strategy.has_references or not strategy.has_followers or strategy.shifts_tracks:
            raise ArgumentError(
                f"follow must be a follow strategy whose heads choose how to fly, got {quote(config.follow)}."
            )
        if most_delay and (isinstance(strategy, Flock) or strategy.lags + most_delay > config.memory):
            raise ArgumentError(
                f"most_delay must be at most memory - {strategy.lags} for follow={quote(config.follow)}, and 0 for a "
                f"flock, which doesn't fly by the past of its head; got {most_delay} with memory={config.memory}."
            )
        self.heads = [f"head_{j}" for j in range(clusters)]
        window_spaces = game.observation_space(config, rules).spaces
        far = window_spaces["position"].high.flat[0]  # type: ignore[attr-defined]  # a Box
        mask = spaces.MultiBinary(uavs)
        choices = self.manoeuvres.choices
        head_spaces = {
            "position": spaces.Box(-far, far, (uavs, 3), np.float32),
            "velocity": spaces.Box(-config.speed_bound, config.speed_bound, (uavs, 3), np.float32),
            **dict.fromkeys(("alive", "self", "heads", "followers", "named"), mask),
            "round": spaces.Box(0, rules.max_rounds, (1,), np.float32),
            "legal": spaces.MultiBinary(int(choices.sum())),
        }
        observations = {OBSERVER: spaces.Dict({**window_spaces, "legal": mask})}
        observations |= {name: spaces.Dict(head_spaces) for name in self.heads}
        actions: dict[str, spaces.Space[Any]] = {OBSERVER: spaces.MultiBinary(uavs)}
        actions |= {name: spaces.MultiDiscrete(choices) for name in self.heads}
        super().__init__(config, rules, arguments.render_mode, observations, actions)

    def _start(self, rng: np.random.Generator) -> base.Start:
        self._game = game.start_games([self.config], [rng])
        self._flown = np.zeros(self.config.clusters, np.int64)  # the mobility of each head in the window before
        self._decoys = np.empty(0, np.intp)  # the followers that are decoys in the current window
        self._sighting = None
        metrics = game.initial_info(self.rules, self._game)
        infos = {agent: {**base.to_scalars(metrics), "price": 0.0} for agent in self.agents}
        return {agent: self._observation(agent) for agent in self.agents}, infos

    def step(self, actions: Any) -> base.Step:
        """Destroy the observer's candidates, apply the choices of the surviving heads, and fly the next window."""
        checked = self._check_actions(actions)
        named = game.parse_candidates(checked[OBSERVER], (self.config.uavs,), f"action of {OBSERVER}")
        plan = Plan(*np.stack([self._check_choice(name, checked.get(name)) for name in self.heads], axis=1))
        if self._sighting is None:  # the opening
            state, reward = game.require_game(self._game), 0.0
            metrics = game.initial_info(self.rules, state)
        else:
            state, reward, metrics = self._play_round(named, named.astype(np.float64))
        self._game = state
        prices = compute_prices(self.manoeuvres, state.swarm, plan)
        if state.terminated[0]:
            self._sighting = ObservationBatch.unseen(self.config, state.swarm.alive[0])
        else:
            self._decoys = select_decoys(state.swarm, plan)[0]
            swarm, flown, self._flown = fly_window(
                self.config, self.manoeuvres, state.swarm, self._flown, plan, [self._rng]
            )
            self._game = replace(state, swarm=swarm)
            self._sighting = ObservationBatch(flown.position[0], flown.velocity[0], flown.seen[0], flown.alive[0])
        return self._make_step(reward, metrics, prices)

    def _make_step(self, reward: float, metrics: dict[str, NDArray[Any]], prices: Floats) -> base.Step:
        state = game.require_game(self._game)
        alive = state.swarm.alive[0, np.flatnonzero(state.swarm.head[0])]
        terminated, truncated = bool(state.terminated[0]), bool(state.truncated[0])
        paid = {OBSERVER: float(prices.sum()), **dict(zip(self.heads, prices.tolist(), strict=True))}
        over = {OBSERVER: terminated, **dict(zip(self.heads, (~alive).tolist(), strict=True))}
        rewards = {agent: reward if agent == OBSERVER else -reward - paid[agent] for agent in self.agents}
        terminations = {agent: over[agent] for agent in self.agents}
        infos = {agent: {**base.to_scalars(metrics), "price": paid[agent]} for agent in self.agents}
        truncations = {agent: truncated and not terminations[agent] for agent in self.agents}
        observations = {agent: self._observation(agent) for agent in self.agents}
        self.agents = [agent for agent in self.agents if not (terminations[agent] or truncations[agent])]
        return observations, rewards, terminations, truncations, infos

    def _reveal_swarm(self, state: game.GameState) -> SwarmState:
        """The true swarm in the window; followers that were decoys in it count as decoys without a head."""
        truth = super()._reveal_swarm(state)
        truth.decoy[self._decoys] = True
        truth.root[self._decoys] = self._decoys
        return truth

    def _check_choice(self, agent: str, action: Any) -> Indices:
        """The four choices of a head; zeros for a head that has left the game."""
        sizes = self.manoeuvres.choices
        if agent not in self.agents:
            return np.zeros(len(sizes), np.int64)
        values = np.asarray(action)
        whole = values.dtype.kind in "biuf" and values.shape == sizes.shape and (values % 1 == 0).all()
        if not whole or not ((values >= 0) & (values < sizes)).all():
            raise ArgumentError(
                f"action of {agent} must hold whole numbers from 0, each below {sizes.tolist()}, got {quote(action)}."
            )
        return values.astype(np.int64)

    def describe_action(self, agent: str, action: Any) -> str:
        """Describe the choice of a head in words; empty for the observer."""
        if agent == OBSERVER:
            return ""
        mobility, jitter, decoys, delay = np.asarray(action).tolist()
        head = np.flatnonzero(game.require_game(self._game).swarm.head[0])[self.heads.index(agent)]
        words = [self.manoeuvres.mobilities[mobility]]
        words += ["jitter"] * (jitter > 0) + [format_count(decoys, "decoy")] * (decoys > 0)
        words += [f"followers delayed by {format_count(delay, 'step')}"] * (delay > 0)
        return f"UAV {head}: {', '.join(words)}"

    def _observation(self, agent: str) -> Observation:
        state = game.require_game(self._game)
        swarm = state.swarm
        if agent == OBSERVER:
            flown = self._sighting is not None and not state.terminated[0]
            return self._make_observation(self._current_window(), swarm.alive[0] & flown)
        head = int(np.flatnonzero(swarm.head[0])[self.heads.index(agent)])
        followers = (swarm.root[0] == head) & swarm.alive[0] & ~swarm.head[0]
        named = np.zeros(self.config.uavs, bool) if self.last_round is None else self.last_round.candidates
        legal = [np.ones(size, np.int8) for size in self.manoeuvres.choices]
        legal[2][1 + max(int(followers.sum()) - 1, 0) :] = 0  # one follower must remain
        return {
            "position": swarm.position[0].copy(),
            "velocity": swarm.past_velocity[0, -1].copy(),
            "alive": swarm.alive[0].astype(np.int8),
            "self": (np.arange(self.config.uavs) == head).astype(np.int8),
            "heads": (swarm.head[0] & swarm.alive[0]).astype(np.int8),
            "followers": followers.astype(np.int8),
            "named": named.astype(np.int8),
            "round": state.rounds.astype(np.float32),
            "legal": np.concatenate(legal),
        }


raw_env, env = base.make_aec_forms(parallel_env)
