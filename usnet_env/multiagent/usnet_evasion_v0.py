"""``usnet_evasion_v0``: the heads know that they are watched, and choose how to fly."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.envs import game
from usnet_env.multiagent.base import (
    AECEnv,
    Decided,
    Observation,
    Step,
    UsnetParallelEnv,
    in_turns,
    in_turns_and_order,
    rules_of,
    scalars,
)
from usnet_env.multiagent.evasion import Manoeuvres, Plan, fly, followers_of, handed, price
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState

__all__ = ["env", "parallel_env", "raw_env"]

OBSERVER = "observer_0"


class parallel_env(UsnetParallelEnv):  # PettingZoo's name for it
    """One observer against M heads that choose how to fly in the next window (adversarial).

    ## Description
    The swarm and the rounds are those of `USNET/MultiCluster-v0`, but before every window each head chooses how to
    fly in it: by which mobility, with or without the followers' noise, how many of its nearest followers play decoys
    (they fly as their head does, by themselves, for this window), and how many steps late its followers follow. Each
    of these costs formation, and so has a price. The observer names candidates, who are destroyed; a destroyed head
    leaves the game. If every head always chooses 0, the swarm flies as in `USNET/MultiCluster-v0` with the same
    seed, bit for bit.

    ## Agents
    `observer_0`, and `head_0` to `head_{M-1}` in the order of the heads' indices (which tell nothing).

    ## Steps
    In a step the observer answers the window it has just seen, and at the same time the heads that survive this
    answer choose for the next window. So the first step, the opening, is the heads' alone: the observer has seen
    nothing (`seen` and `legal` are 0), and what it names does not count, nor is it a round. A game of R rounds has
    R + 1 steps.

    ## Action Space
    Observer: `MultiBinary(N)`, the candidates. A destroyed UAV may be named; it counts as redundant.

    Head: `MultiDiscrete([mobilities, 2, most_decoys + 1, most_delay + 1])`: mobility (0 is the swarm's own), jitter,
    decoys, delay. A head keeps at least one follower; of decoys beyond that as many as possible are made.

    ## Observation Space
    Observer: `Dict` of `position` `(T_ob + 1, N, 3)` m, `velocity` `(T_ob, N, 3)` m/step, `seen` `(T_ob + 1, N)`,
    `alive` `(N,)`, `round` `(1,)` as in `USNET/MultiCluster-v0`, and `legal` `(N,)`: 1 for whom it may sensibly name.

    Head: `Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(N, 3)` | float32 | m | where everybody is now, the destroyed at 0 |
    | `velocity` | `(N, 3)` | float32 | m/step | how everybody flies now |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed |
    | `self` | `(N,)` | int8 | | 1 for this head |
    | `heads` | `(N,)` | int8 | | 1 for living heads |
    | `followers` | `(N,)` | int8 | | 1 for those who follow this head, its decoys included |
    | `named` | `(N,)` | int8 | | 1 for the candidates of the round before |
    | `round` | `(1,)` | float32 | | rounds played |
    | `legal` | `(sum of choices,)` | int8 | | 1 for each value of each choice that it can carry out |

    ## Rewards
    Observer: that of P2, −(1 + `redundancy_price` · redundant / N) a round, 0 in the opening; its return at price 1
    is −J_m. Head: the opposite of the observer's reward, less the price of what it chose for the next window. So
    observer + head + price = 0 in every step, for every head: the swarm is one team against the observer, and each
    head pays for itself. A head that is destroyed in a step still gets that step's reward, and its choice is void.

    The price of a head's choice, in rounds, with s the share of the swarm in its cluster (itself included), f the
    share that follows, and d decoys handed out: `mobility_price` · s for another mobility, `jitter_price` · s for
    jitter, `decoy_price` · d / N, and `delay_price` · delay · f.

    `info` holds for everybody `hits`, `redundant`, `round`, `success`, `J`, `over_budget`,
    `reward_round`, `reward_redundancy`, and `price`: one's own for a head, that of all for the observer.

    ## Starting State
    That of `USNET/MultiCluster-v0` with the same seed; no window has been flown.

    ## Episode End
    A head terminates when it is destroyed. When the last one is, the observer terminates as well. After `max_rounds`
    rounds everybody left is truncated.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `mobilities` | `("iid", "gauss_markov", "smooth_turn")` | on offer; the first is the swarm's own and free |
    | `most_decoys` | 2 | followers that a head may make decoys |
    | `most_delay` | 4 | steps that followers may be late |
    | `mobility_price` | 0.1 | see Rewards |
    | `jitter_price` | 0.05 | see Rewards |
    | `decoy_price` | 1 | see Rewards |
    | `delay_price` | 0.05 | see Rewards |
    | `memory` | 8 | T_0; at least the follow strategy's lags + `most_delay` |
    | `max_cycles` | `None` | most steps, the opening included, if fewer than `max_rounds` + 1 |

    and of `USNET/MultiCluster-v0`: `follow` (not `"none"`), `formation`, `clusters`, `uavs`, `cluster_sizes`,
    `observation_steps`, `sample_every`, `position_noise`, `miss_rate`, `decoys`, `follow_seed`, `max_rounds`,
    `shot_budget`, `redundancy_price`, `render_mode`.

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {**UsnetParallelEnv.metadata, "name": "usnet_evasion_v0"}

    def __init__(
        self,
        mobilities: tuple[str, ...] | list[str] = ("iid", "gauss_markov", "smooth_turn"),
        most_decoys: int = 2,
        most_delay: int = 4,
        mobility_price: float = 0.1,
        jitter_price: float = 0.05,
        decoy_price: float = 1.0,
        delay_price: float = 0.05,
        follow: str = "f1",
        formation: str = "uniform",
        clusters: int = 5,
        uavs: int = 82,
        cluster_sizes: tuple[int, ...] | list[int] | None = None,
        observation_steps: int = 100,
        memory: int = 8,
        sample_every: int = 1,
        position_noise: float = 0.0,
        miss_rate: float = 0.0,
        decoys: int = 0,
        follow_seed: int | None = None,
        max_rounds: int = 20,
        shot_budget: int | None = None,
        redundancy_price: float = 1.0,
        max_cycles: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.manoeuvres = Manoeuvres(
            mobilities=mobilities,  # type: ignore[arg-type]  # a list is taken and made a tuple
            most_decoys=most_decoys,
            most_delay=most_delay,
            mobility_price=mobility_price,
            jitter_price=jitter_price,
            decoy_price=decoy_price,
            delay_price=delay_price,
        )
        rules = rules_of(max_rounds, max_cycles, 1, shot_budget, redundancy_price)
        config = SwarmConfig(
            follow=follow,
            mobility=self.manoeuvres.mobilities[0],
            formation=formation,
            clusters=clusters,
            uavs=uavs,
            cluster_sizes=cluster_sizes,  # type: ignore[arg-type]
            observation_steps=observation_steps,
            memory=memory,
            sample_every=sample_every,
            position_noise=position_noise,
            miss_rate=miss_rate,
            decoys=decoys,
            follow_seed=follow_seed,
        )
        strategy = config.follow_strategy
        if strategy is None:
            raise ArgumentError("follow must be a strategy by which followers follow, got 'none'.")
        if strategy.lags + most_delay > memory:
            raise ArgumentError(
                f"memory must be at least {strategy.lags + most_delay} for follow={quote(follow)} and "
                f"most_delay={most_delay}, got {memory}."
            )
        self.heads = [f"head_{j}" for j in range(clusters)]
        watched = game.observation_space(config, rules).spaces
        far = watched["position"].high.flat[0]  # type: ignore[attr-defined]  # a Box
        mask = spaces.MultiBinary(uavs)
        choices = self.manoeuvres.choices
        aboard = {
            "position": spaces.Box(-far, far, (uavs, 3), np.float32),
            "velocity": spaces.Box(-1.001, 1.001, (uavs, 3), np.float32),
            **dict.fromkeys(("alive", "self", "heads", "followers", "named"), mask),
            "round": spaces.Box(0, rules.max_rounds, (1,), np.float32),
            "legal": spaces.MultiBinary(int(choices.sum())),
        }
        observations = {OBSERVER: spaces.Dict({**watched, "legal": mask})}
        observations |= {name: spaces.Dict(aboard) for name in self.heads}
        actions: dict[str, spaces.Space[Any]] = {OBSERVER: game.action_space(config)}
        actions |= {name: spaces.MultiDiscrete(choices) for name in self.heads}
        super().__init__(config, rules, render_mode, observations, actions)
        self._flown = np.zeros(clusters, np.int64)  # the mobility that each head flew last
        self._decoys = np.empty(0, np.intp)  # the followers that play decoys in the present window

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, int | float]]]:
        """Start a game; the opening comes first.

        Args:
            seed: seeds the game's own generator, 0 included; ``None`` goes on with the present one.
            options: none are known; ignored.

        Returns:
            Observations and infos by agent.
        """
        self._game = game.start_games(self.config, [self._generator(seed)])
        self._flown = np.zeros(self.config.clusters, np.int64)
        self._decoys = np.empty(0, np.intp)
        self._sighting, self.decided = None, None
        self.agents = list(self.possible_agents)
        metrics = game.initial_info(self.rules, self._game)
        infos = {agent: {**scalars(metrics), "price": 0.0} for agent in self.agents}
        return {agent: self._observation(agent) for agent in self.agents}, infos

    def step(self, actions: Any) -> Step:
        """The observer answers the present window, the heads that survive choose for the next one, and it is flown.

        Args:
            actions: an action for each living agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent; of those that are destroyed in this
            step for the last time.

        Raises:
            ArgumentError: no action for an agent or one of another shape or with other values, or a step after the
                end.
        """
        given = self._checked(actions)
        named = game.parse_candidates(given[OBSERVER], (self.config.uavs,))
        plan = Plan.of(np.stack([self._choice(name, given.get(name)) for name in self.heads]))
        before = self._running()
        opening = self._sighting is None
        if opening:
            state, metrics = before, game.initial_info(self.rules, before)
            reward = 0.0
        else:
            state, turn = game.play_round(self.rules, before, named[None])
            metrics, reward = turn.metrics, float(turn.reward[0])
            self.decided = Decided(
                sighting=self._window(),
                truth=self._truth(before),
                candidates=named,
                scores=named.astype(np.float64),
                objective=float(metrics["J"][0]),
                over_budget=bool(metrics["over_budget"][0]),
            )
        self._game = state
        prices = price(self.manoeuvres, state.swarm, plan)
        if state.terminated[0]:
            self._sighting = self._empty()
        else:
            self._fly(plan)
        return self._result(reward, metrics, prices)

    def _fly(self, plan: Plan) -> None:
        state = self._running()
        rngs = [self._generator(None)]
        self._decoys = handed(state.swarm, plan)[0]
        swarm, sighting, self._flown = fly(self.config, self.manoeuvres, state.swarm, self._flown, plan, rngs)
        self._game = game.GameState(swarm, state.rounds, state.redundant, state.terminated, state.truncated)
        self._sighting = ObservationBatch(
            sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0]
        )

    def _result(self, reward: float, metrics: dict[str, NDArray[Any]], prices: NDArray[np.float64]) -> Step:
        state = self._running()
        alive = state.swarm.alive[0, np.flatnonzero(state.swarm.head[0])]
        over, cut = bool(state.terminated[0]), bool(state.truncated[0])
        plain = scalars(metrics)
        rewards, terminations, infos = {}, {}, {}
        for agent in self.agents:
            if agent == OBSERVER:
                rewards[agent], terminations[agent] = reward, over
                infos[agent] = {**plain, "price": float(prices.sum())}
            else:
                row = self.heads.index(agent)
                rewards[agent], terminations[agent] = -reward - float(prices[row]), not alive[row]
                infos[agent] = {**plain, "price": float(prices[row])}
        truncations = {agent: cut and not terminations[agent] for agent in self.agents}
        observations = {agent: self._observation(agent) for agent in self.agents}
        self.agents = [agent for agent in self.agents if not (terminations[agent] or truncations[agent])]
        return observations, rewards, terminations, truncations, infos

    def _truth(self, state: game.GameState) -> SwarmState:
        """Who led whom in the window: who played a decoy in it was one, and followed nobody."""
        truth = super()._truth(state)
        truth.decoy[self._decoys] = True
        truth.leader[self._decoys] = self._decoys
        return truth

    def _choice(self, agent: str, action: Any) -> NDArray[np.int64]:
        """A head's four choices; zeros for a head that has left."""
        many = self.manoeuvres.choices
        if agent not in self.agents:
            return np.zeros(len(many), np.int64)
        try:
            values = np.asarray(action)
        except ValueError:
            values = np.empty(0, object)
        if (
            values.shape != many.shape
            or values.dtype.kind not in "biuf"
            or not ((values >= 0) & (values < many) & (values == np.floor(values))).all()
        ):
            raise ArgumentError(
                f"action of {agent} must hold {len(many)} whole numbers from 0, each below {many.tolist()}, "
                f"got {quote(action)}."
            )
        return values.astype(np.int64)

    def _observation(self, agent: str) -> Observation:
        state = self._running()
        swarm = state.swarm
        if agent == OBSERVER:
            flown = self._sighting is not None and not state.terminated[0]
            return self._seen_by(self._window(), swarm.alive[0] & flown)
        row = self.heads.index(agent)
        head = int(np.flatnonzero(swarm.head[0])[row])
        oneself = np.zeros(self.config.uavs, np.int8)
        oneself[head] = 1
        followers = (swarm.leader[0] == head) & swarm.alive[0] & ~swarm.head[0]
        named = np.zeros(self.config.uavs, bool) if self.decided is None else self.decided.candidates
        return {
            "position": swarm.position[0].copy(),
            "velocity": swarm.past_velocity[0, -1].copy(),
            "alive": swarm.alive[0].astype(np.int8),
            "self": oneself,
            "heads": (swarm.head[0] & swarm.alive[0]).astype(np.int8),
            "followers": followers.astype(np.int8),
            "named": named.astype(np.int8),
            "round": state.rounds.astype(np.float32),
            "legal": self._legal(int(followers_of(swarm)[row])),
        }

    def _legal(self, followers: int) -> NDArray[np.int8]:
        """Which values of which choice a head with so many followers can carry out."""
        masks = [np.ones(many, np.int8) for many in self.manoeuvres.choices]
        masks[2][1 + max(followers - 1, 0) :] = 0
        return np.concatenate(masks)


def raw_env(**arguments: Any) -> AECEnv:
    """The AEC form without the wrapper that enforces the order of calls; arguments as of :class:`parallel_env`."""
    return in_turns(parallel_env(**arguments))


def env(**arguments: Any) -> AECEnv:
    """The AEC form; arguments as of :class:`parallel_env`."""
    return in_turns_and_order(parallel_env(**arguments))
