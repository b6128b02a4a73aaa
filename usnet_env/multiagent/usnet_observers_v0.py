"""``usnet_observers_v0``: K observers see parts of one swarm, and vote."""

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
from usnet_env.multiagent.fusion import fusion as fusion_rule
from usnet_env.multiagent.sight import Eye, Sight, observe_from, team_sight
from usnet_env.swarm import ObservationBatch, SwarmConfig

__all__ = ["env", "parallel_env", "raw_env"]


class parallel_env(UsnetParallelEnv):  # PettingZoo's name for it
    """Several observers, each with a part of the picture, find all heads of a swarm together (cooperative).

    ## Description
    The swarm and the rounds are those of `USNET/MultiCluster-v0`. K observers stand in the arena; each sees the UAVs
    within its range, with sensing noise of its own, and votes. A fusion rule turns the votes into the round's
    candidates, which are destroyed. Observers may send each other a short message, which arrives with the next
    window. With one observer who sees everything the game is `USNET/MultiCluster-v0`.

    ## Agents
    `observer_0` to `observer_{K-1}`. All stay until the game ends.

    ## Action Space
    The vote: `MultiBinary(N)`, or `Box(0, 1, (N,))` where `fusion` sums scores. A vote for a UAV that the observer
    did not see in this window, or that is destroyed, does not count. With `message_size` B the action has B more
    entries of the same kind, the message.

    ## Observation Space
    `Dict` of

    | key | shape | dtype | unit | meaning |
    | --- | --- | --- | --- | --- |
    | `position` | `(T_ob + 1, N, 3)` | float32 | m | where UAVs in range were seen; 0 if unseen |
    | `velocity` | `(T_ob, N, 3)` | float32 | m/step | velocity between two instants; 0 unless both ends were seen |
    | `seen` | `(T_ob + 1, N)` | int8 | | 1 where the UAV was in range and detected |
    | `alive` | `(N,)` | int8 | | 1 unless destroyed |
    | `round` | `(1,)` | float32 | | number of the round, from 1 |
    | `legal` | `(N,)` | int8 | | 1 for living UAVs that this observer saw: its votes for them count |
    | `place` | `(3,)` | float32 | m | where this observer stands |
    | `messages` | `(K, B)` | float32 | | what each observer sent in the round before; only if `message_size` > 0 |

    The first five make a `usnet_env.Window`.

    ## Rewards
    All observers get the reward of P2 for the fused candidates, −(1 + `redundancy_price` · redundant / N) a round;
    the return at price 1 is −J_m.

    `info` is the same for all: `hits`, `redundant`, `round`, `success`, `J`, `over_budget`,
    `reward_round`, `reward_redundancy`.

    ## Starting State
    That of `USNET/MultiCluster-v0` with the same seed. Observers stand on a `grid` over the arena, or `uniform`ly.

    ## Episode End
    Terminates for all when no head is left (the windows are then empty); truncates after `max_rounds`.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `observers` | 4 | K |
    | `sensing_range` | 500 | m; one number, or one for each observer |
    | `position_noise` | 0 | standard deviation of observed positions, m; one number, or one for each |
    | `miss_rate` | 0 | probability of a missed detection in range; one number, or one for each |
    | `placement` | `"grid"` | `grid` or `uniform` |
    | `message_size` | 0 | B, numbers sent in a round |
    | `fusion` | `"union"` | `union`, `majority`, `scores`, or a registered rule |
    | `max_cycles` | `None` | most steps, if fewer than `max_rounds` |

    and of `USNET/MultiCluster-v0`: `follow`, `mobility`, `formation`, `clusters`, `uavs`, `cluster_sizes`,
    `observation_steps`, `memory`, `sample_every`, `decoys`, `head_jitter`, `follow_seed`, `max_rounds`,
    `shot_budget`, `redundancy_price`, `render_mode`.

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {**UsnetParallelEnv.metadata, "name": "usnet_observers_v0"}

    def __init__(
        self,
        observers: int = 4,
        sensing_range: float | tuple[float, ...] | list[float] = 500.0,
        position_noise: float | tuple[float, ...] | list[float] = 0.0,
        miss_rate: float | tuple[float, ...] | list[float] = 0.0,
        placement: str = "grid",
        message_size: int = 0,
        fusion: str = "union",
        follow: str = "f1",
        mobility: str = "iid",
        formation: str = "uniform",
        clusters: int = 5,
        uavs: int = 82,
        cluster_sizes: tuple[int, ...] | list[int] | None = None,
        observation_steps: int = 100,
        memory: int = 4,
        sample_every: int = 1,
        decoys: int = 0,
        head_jitter: bool = False,
        follow_seed: int | None = None,
        max_rounds: int = 20,
        shot_budget: int | None = None,
        redundancy_price: float = 1.0,
        max_cycles: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.fusion = fusion_rule(fusion)
        self.sight = Sight(
            observers=observers,
            sensing_range=sensing_range,  # type: ignore[arg-type]  # a list is taken and made a tuple
            position_noise=position_noise,  # type: ignore[arg-type]
            miss_rate=miss_rate,  # type: ignore[arg-type]
            placement=placement,
            message_size=message_size,
        )
        rules = rules_of(max_rounds, max_cycles, 0, shot_budget, redundancy_price)
        config = SwarmConfig(
            follow=follow,
            mobility=mobility,
            formation=formation,
            clusters=clusters,
            uavs=uavs,
            cluster_sizes=cluster_sizes,  # type: ignore[arg-type]
            observation_steps=observation_steps,
            memory=memory,
            sample_every=sample_every,
            decoys=decoys,
            head_jitter=head_jitter,
            follow_seed=follow_seed,
        )
        self._sensors = self.sight.sensors(config)
        # One flight for all observers: every step of it, without noise; each then samples it by itself.
        every_step = {"sample_every": 1, "observation_steps": config.observation_steps * config.sample_every}
        self._flight = config.model_copy(update=every_step)
        noisiest = max(self._sensors, key=lambda sensor: sensor.position_noise)
        shape = dict(game.observation_space(noisiest, rules).spaces)
        far = noisiest.position_bound(rules.max_rounds)
        shape |= {"legal": spaces.MultiBinary(uavs), "place": spaces.Box(-far, far, (3,), np.float32)}
        size = self.sight.message_size
        if size:
            shape["messages"] = spaces.Box(0, 1, (observers, size), np.float32)
        names = [f"observer_{k}" for k in range(observers)]
        super().__init__(
            config,
            rules,
            render_mode,
            {name: spaces.Dict(shape) for name in names},
            {
                name: spaces.MultiBinary(uavs + size)
                if self.fusion.vote == "candidates"
                else spaces.Box(0, 1, (uavs + size,), np.float32)
                for name in names
            },
        )
        self._eyes: list[Eye] = []
        self._sightings: list[ObservationBatch] = []
        self._messages = np.zeros((observers, size), np.float32)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, int | float]]]:
        """Start a game and observe its first window.

        Args:
            seed: seeds the game's own generator, 0 included; ``None`` goes on with the present one. The observers'
                noise comes from branches of it, so that the swarm flies the same whoever looks.
            options: none are known; ignored.

        Returns:
            Observations and infos by agent.
        """
        rng = self._generator(seed)
        places, *noises = rng.spawn(1 + self.sight.observers)
        where = self.sight.places(places)
        reaches = self.sight.each("sensing_range")
        self._eyes = [Eye(*parts) for parts in zip(where, reaches, self._sensors, noises, strict=True)]
        self._messages = np.zeros_like(self._messages)
        self.decided = None
        self.agents = list(self.possible_agents)
        state = game.start_games(self.config, [rng])
        metrics = game.initial_info(self.rules, state)
        self._look(state)
        return self._observations(), {agent: scalars(metrics) for agent in self.agents}

    def step(self, actions: Any) -> Step:
        """Fuse the votes, destroy the candidates, score the round, and observe the next window.

        Args:
            actions: a vote for each living agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            ArgumentError: no action for an agent or one of another shape or with other values, or a step after the
                end.
        """
        given = self._checked(actions)
        whole = np.stack([self._vote(agent, given[agent]) for agent in self.possible_agents])
        before = self._running()
        uavs = self.config.uavs
        seen = np.stack([sighting.seen.any(axis=0) for sighting in self._sightings])  # the living only
        votes = whole[:, :uavs] * seen
        candidates = self._fused(votes, seen)
        state, turn = game.play_round(self.rules, before, candidates[None])
        self.decided = Decided(
            sighting=self._window(),
            truth=self._truth(before),
            candidates=candidates,
            scores=votes.sum(axis=0),
            objective=float(turn.metrics["J"][0]),
            over_budget=bool(turn.metrics["over_budget"][0]),
        )
        self._messages = whole[:, uavs:].astype(np.float32)
        self._look(state)
        now = self.agents
        terminated, truncated = bool(state.terminated[0]), bool(state.truncated[0])
        result = (
            self._observations(),
            dict.fromkeys(now, float(turn.reward[0])),
            dict.fromkeys(now, terminated),
            dict.fromkeys(now, truncated),
            {agent: scalars(turn.metrics) for agent in now},
        )
        if terminated or truncated:
            self.agents = []
        return result

    def _look(self, state: game.GameState) -> None:
        """Fly the next window and let every observer see its part; nobody sees anything of a game that is over."""
        self._game, truth = game.observe_windows(self._flight, state, [self._generator(None)])
        if state.terminated[0]:
            self._sightings = [self._empty() for _ in self._eyes]
        else:
            position, velocity = truth["position"][0], truth["velocity"][0]
            alive = truth["alive"][0].astype(bool)
            self._sightings = [observe_from(eye, position, velocity, alive) for eye in self._eyes]
        self._sighting = team_sight(self._sightings)

    def _observations(self) -> dict[str, Observation]:
        every = {}
        for agent, eye, sighting in zip(self.possible_agents, self._eyes, self._sightings, strict=True):
            observation = self._seen_by(sighting, np.asarray(sighting.seen.any(axis=0)))
            observation["place"] = eye.place.astype(np.float32)
            if self.sight.message_size:
                observation["messages"] = self._messages.copy()
            every[agent] = observation
        return every

    def _vote(self, agent: str, action: Any) -> NDArray[np.float64]:
        """The action as numbers from 0 to 1, one a UAV, then the message."""
        length = self.config.uavs + self.sight.message_size
        if self.fusion.vote == "candidates":
            return game.parse_candidates(action, (length,)).astype(np.float64)
        try:
            values = np.asarray(action)
        except ValueError:
            values = np.empty(0, object)
        if values.shape != (length,) or values.dtype.kind not in "biuf" or not ((values >= 0) & (values <= 1)).all():
            raise ArgumentError(f"action of {agent} must hold {length} numbers from 0 to 1, got {quote(action)}.")
        return values.astype(np.float64)

    def _fused(self, votes: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The candidates; a rule of a stranger is checked."""
        candidates = np.asarray(self.fusion.rule(votes, seen))
        if candidates.shape != (self.config.uavs,) or candidates.dtype != bool:
            raise ArgumentError(f"fusion rule must return {self.config.uavs} booleans, got {quote(candidates)}.")
        return candidates


def raw_env(**arguments: Any) -> AECEnv:
    """The AEC form without the wrapper that enforces the order of calls; arguments as of :class:`parallel_env`."""
    return in_turns(parallel_env(**arguments))


def env(**arguments: Any) -> AECEnv:
    """The AEC form; arguments as of :class:`parallel_env`."""
    return in_turns_and_order(parallel_env(**arguments))
