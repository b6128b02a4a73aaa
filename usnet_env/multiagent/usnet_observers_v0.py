"""``usnet_observers_v0``: K observers each see a part of one swarm, and vote."""

from __future__ import annotations

import copy
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pydantic import Field

from usnet_env.arrays import Floats, Observation
from usnet_env.config import ArgumentError, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.usnet import OBSERVATION
from usnet_env.multiagent import base
from usnet_env.multiagent.sensors import FUSIONS, Observer, SensorConfig, merge_sightings, sense_window
from usnet_env.swarm import ObservationBatch, SwarmConfig
from usnet_env.swarm.config import MobilityArguments


class ObserversArguments(base.GameArguments, MobilityArguments, SensorConfig):
    """The arguments of :class:`parallel_env`."""

    fusion: str = Field("union", description="``union``, ``majority``, ``scores``, or a registered rule")


@list_arguments(observation=OBSERVATION)
class parallel_env(base.UsnetParallelEnv):  # PettingZoo's name for it
    """Several observers, each of which sees a part of the swarm, find its heads together (cooperative).

    ## Description
    The swarm and the rounds are those of `USNET/MultiCluster-v0`. K observers have fixed positions in the arena. Each
    sees the UAVs within its range, with its own sensing noise, and votes. A fusion rule combines the votes into the
    candidates of the round, which are destroyed. Observers may send each other a short message, which arrives with the
    next window. With one observer that sees all UAVs the game equals `USNET/MultiCluster-v0`.

    ## Agents
    `observer_0` to `observer_{K-1}`. All of them stay until the game ends.

    ## Action Space
    The vote: `MultiBinary(N)`, or `Box(0, 1, (N,))` if the fusion rule takes scores. A vote for a UAV that the observer
    did not see in this window, or that is destroyed, does not count. With `message_size` B the action has B more
    values of the same type, the message.

    ## Observation Space
    {observation}
    | `legal` | `(N,)` | int8 | | 1 for the living UAVs that this observer saw: only votes for them count |
    | `place` | `(3,)` | float32 | m | position of this observer |
    | `messages` | `(K, B)` | float32 | | messages of all observers in the previous round; only if `message_size` > 0 |

    A `usnet_env.Window` can be made from the first five.

    ## Rewards
    In each round every observer gets the reward of P2 for the fused candidates, −(1 + `redundancy_price` · redundant /
    N). With price 1 the return is −J_m.

    `info` is that of `USNET/MultiCluster-v0`, the same for all observers.

    ## Starting State
    That of `USNET/MultiCluster-v0` with the same seed. The observers are placed on a grid over the arena
    (`grid`), or at random positions drawn for each game (`uniform`).

    ## Episode End
    The game terminates for all observers when no head is left (the last windows are empty). It is truncated after
    `max_rounds` rounds.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {**base.UsnetParallelEnv.metadata, "name": "usnet_observers_v0"}

    @takes_arguments(ObserversArguments)
    def __init__(self, arguments: ObserversArguments) -> None:
        self.fusion = FUSIONS.find(arguments.fusion)
        self.sensor_config = arguments.part(SensorConfig)
        rules = arguments.make_rules()
        config = arguments.part(SwarmConfig, position_noise=0.0, miss_rate=0.0)  # the observers have their own
        observers, uavs = arguments.observers, arguments.uavs
        self._sensors = self.sensor_config.sensor_configs(config)
        # The swarm flies once, with every step and without noise; then each observer samples this flight.
        every_step = {"sample_every": 1, "observation_steps": config.observation_steps * config.sample_every}
        self._flight = config.model_copy(update=every_step)
        noisiest = max(self._sensors, key=lambda sensor: sensor.position_noise)
        shape = dict(game.observation_space(noisiest, rules).spaces)
        far = noisiest.position_bound(rules.max_rounds + 1)
        shape |= {"legal": spaces.MultiBinary(uavs), "place": spaces.Box(-far, far, (3,), np.float32)}
        size = self.sensor_config.message_size
        if size:
            shape["messages"] = spaces.Box(0, 1, (observers, size), np.float32)
        names = [f"observer_{k}" for k in range(observers)]
        vote: spaces.Space[Any] = spaces.Box(0, 1, (uavs + size,), np.float32)
        if self.fusion.vote == "candidates":
            vote = spaces.MultiBinary(uavs + size)
        actions = {name: copy.deepcopy(vote) for name in names}
        super().__init__(config, rules, arguments.render_mode, {name: spaces.Dict(shape) for name in names}, actions)
        self._observers: list[Observer] = []
        self._sightings: list[ObservationBatch] = []
        self._messages = np.zeros((observers, size), np.float32)

    def _start(self, rng: np.random.Generator) -> base.Start:
        # The observers' noise comes from branches of its own: the flight of the swarm does not depend on the observers.
        placement_rng, *noise_rngs = rng.spawn(1 + self.sensor_config.observers)
        positions = self.sensor_config.draw_positions(placement_rng)
        ranges = self.sensor_config.expand("sensing_range")
        self._observers = [Observer(*parts) for parts in zip(positions, ranges, self._sensors, noise_rngs, strict=True)]
        self._messages = np.zeros_like(self._messages)
        state = game.start_games([self.config], [rng])
        metrics = game.initial_info(self.rules, state)
        self._sense_next_window(state)
        return self._observations(), {agent: base.to_scalars(metrics) for agent in self.agents}

    def step(self, actions: Any) -> base.Step:
        """Combine the votes, destroy the candidates, score the round, and observe the next window."""
        checked = self._check_actions(actions)
        whole = np.stack([self._check_vote(agent, checked[agent]) for agent in self.possible_agents])
        uavs = self.config.uavs
        seen = np.stack([sighting.seen.any(axis=0) for sighting in self._sightings])  # false for destroyed UAVs
        votes = whole[:, :uavs] * seen
        candidates = np.asarray(self.fusion.rule(votes, seen), bool).reshape(uavs)
        state, reward, metrics = self._play_round(candidates, votes.sum(axis=0))
        self._messages = whole[:, uavs:].astype(np.float32)
        self._sense_next_window(state)
        agents = self.agents
        terminated, truncated = bool(state.terminated[0]), bool(state.truncated[0])
        result = (
            self._observations(),
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {agent: base.to_scalars(metrics) for agent in agents},
        )
        if terminated or truncated:
            self.agents = []
        return result

    def _sense_next_window(self, state: game.GameState) -> None:
        """Fly and observe the next window; after the end of the game all windows are empty."""
        self._game, truth = game.observe_windows([self._flight], state, [self._rng])
        if state.terminated[0]:
            self._sightings = [ObservationBatch.unseen(self.config, state.swarm.alive[0])] * len(self._observers)
        else:
            position, velocity = truth["position"][0], truth["velocity"][0]
            alive = truth["alive"][0].astype(bool)
            self._sightings = [sense_window(observer, position, velocity, alive) for observer in self._observers]
        self._sighting = merge_sightings(self._sightings, self.config.sample_every)

    def _observations(self) -> dict[str, Observation]:
        observations = {}
        for agent, observer, sighting in zip(self.possible_agents, self._observers, self._sightings, strict=True):
            observation = self._make_observation(sighting, np.asarray(sighting.seen.any(axis=0)))
            observation["place"] = observer.position.astype(np.float32)
            if self.sensor_config.message_size:
                observation["messages"] = self._messages.copy()
            observations[agent] = observation
        return observations

    def _check_vote(self, agent: str, action: Any) -> Floats:
        """Convert an action to numbers from 0 to 1: one for each UAV, then the message."""
        length = self.config.uavs + self.sensor_config.message_size
        if self.fusion.vote == "candidates":
            return game.parse_candidates(action, (length,), f"action of {agent}").astype(np.float64)
        values = np.asarray(action)
        if values.shape != (length,) or values.dtype.kind not in "biuf" or not ((values >= 0) & (values <= 1)).all():
            raise ArgumentError(f"action of {agent} must hold {length} numbers from 0 to 1, got {quote(action)}.")
        return values.astype(np.float64)

    def list_observers(self) -> Floats:
        """``(K, 4)``, position and sensing range of each observer in metres."""
        return np.array([[*observer.position, observer.sensing_range] for observer in self._observers])


raw_env, env = base.make_aec_forms(parallel_env)
