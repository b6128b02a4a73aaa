"""``usnet_observers_v0``: K observers each see a part of one swarm, and vote."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.batch import WINDOW
from usnet_env.envs.usnet import OBSERVATION
from usnet_env.multiagent import base
from usnet_env.multiagent.batch import OBSERVER, ByRole, GameBatch, Observations
from usnet_env.multiagent.sensors import SensorConfig, combine_votes, fly_observers
from usnet_env.swarm import SwarmConfig, SwarmState
from usnet_env.swarm.config import MobilityArguments
from usnet_env.swarm.sensing import sense
from usnet_env.swarm.simulator import fly_round
from usnet_env.window import as_array


class ObserversArguments(base.GameArguments, MobilityArguments, SensorConfig):
    """The arguments of :class:`parallel_env`."""

    fusion: Literal["union", "majority", "scores"] = Field("union", description="``union``, ``majority``, ``scores``")


class batch_env(GameBatch):  # named as PettingZoo names the forms of a game
    """``num_envs`` games of :class:`parallel_env` in one batch, with its arguments; the role is ``observer``."""

    def __init__(self, num_envs: int, **arguments: Any) -> None:
        checked = ObserversArguments(**arguments)
        self.fusion, self.sensor_config = checked.fusion, checked.part(SensorConfig)
        rules = checked.make_rules()
        config = checked.part(SwarmConfig, position_noise=0.0, miss_rate=0.0)  # the observers have their own
        count, uavs, self._size = checked.observers, checked.uavs, checked.message_size
        self._speed = checked.observer_speed
        self._sensors = self.sensor_config.sensor_configs(config)
        self._ranges = np.tile(self.sensor_config.expand("sensing_range"), num_envs)
        self._draws = checked.placement == "uniform" or any(s.position_noise or s.miss_rate for s in self._sensors)
        # The swarm flies once, with every step and without noise; then each observer samples this flight.
        every_step = {"sample_every": 1, "observation_steps": config.observation_steps * config.sample_every}
        self._flight = config.model_copy(update=every_step)
        noisiest = max(self._sensors, key=lambda sensor: sensor.position_noise)
        shape = dict(game.observation_space(noisiest, rules).spaces)
        far = noisiest.position_bound(rules.max_rounds + 1)
        shape |= {"legal": spaces.MultiBinary(uavs), "place": spaces.Box(-far, far, (3,), np.float32)}
        acts: spaces.Space[Any] = spaces.MultiBinary(uavs + self._size)
        least = -1.0 if self._speed and self.fusion != "scores" else 0.0  # of a vote or a message
        self._low = np.repeat(np.array([least, -1.0], np.float32), [uavs + self._size, 3 * (self._speed > 0)])
        if self._speed or self.fusion == "scores":
            acts = spaces.Box(self._low, np.ones_like(self._low))
        if self._size:
            shape["messages"] = spaces.Box(least, 1, (count, self._size), np.float32)
        roles = {OBSERVER: (count, spaces.Dict(shape), acts)}
        super().__init__(num_envs, config, rules, roles, checked.render_mode)
        self._noise: list[list[np.random.Generator]] = [[] for _ in range(num_envs)]  # of each observer of each game
        self.places = np.zeros((num_envs, count, 3))  #: of the observers at the end of the window, in metres
        self._velocities = np.zeros((num_envs, count, 3))  # of the observers in the next window, metres per step
        self._messages = np.zeros((num_envs, count, self._size), np.float32)
        #: Which UAVs each observer sees; none that is destroyed.
        self._seen: Mask = np.zeros((num_envs, count, uavs), bool)

    def _begin(self, games: Indices) -> None:
        self._messages[games] = 0.0
        self._velocities[games] = 0.0
        for b in games.tolist():
            # The observers' noise comes from branches of its own: the flight doesn't depend on the observers.
            rng = self.rngs[b]
            placement_rng, *self._noise[b] = rng.spawn(1 + self.sensor_config.observers) if self._draws else [rng]
            self.places[b] = self.sensor_config.draw_positions(placement_rng)
        self.fly(games)

    def _combine(self, actions: ByRole) -> tuple[Mask, Floats]:
        """Combine the votes for UAVs that the observers see."""
        seen = self._seen
        votes = actions[OBSERVER][..., : self.config.uavs] * seen
        return combine_votes(self.fusion, votes, seen), votes.sum(axis=1)

    def _respond(self, actions: ByRole) -> ByRole:
        _, message, steer = np.split(actions[OBSERVER], [self.config.uavs, self.config.uavs + self._size], axis=-1)
        self._messages = message.astype(np.float32)
        if self._speed:
            self._velocities = self._speed * steer / np.maximum(np.linalg.norm(steer, axis=-1, keepdims=True), 1.0)
        return {}

    def _fly_rows(self, swarm: SwarmState, rows: Indices) -> tuple[SwarmState, Observation]:
        games, count = rows.tolist(), len(self._sensors)
        rngs, configs = [self.rngs[b] for b in games], self._sensors * len(games)
        after, position, velocity, first = fly_round([self._flight] * len(games), swarm, rngs)
        noise = [rng for b in games for rng in self._noise[b]]
        instants = self.config.memory + np.arange(self.config.observation_steps + 1) * self.config.sample_every
        way = fly_observers(self.places[rows], self._velocities[rows], instants[: None if self._speed else 1])
        self.places[rows] = way[:, :, -1]
        near = way.reshape(-1, *way.shape[2:]), self._ranges[: count * len(games)]
        window = sense(configs, position, velocity, swarm.alive, noise, swarm.free, *near, first)
        split = {name: getattr(window, name) for name in WINDOW}
        return after, {name: array.reshape(len(rows), count, *array.shape[1:]) for name, array in split.items()}

    def _observe(self) -> Observations:
        self._seen = np.einsum("bkti->bki", self.window["seen"])  # seen at any time: faster than any(axis=2)
        shown = self._show(self._seen)
        shown["place"] = self.places.astype(np.float32)
        if self._size:
            shown["messages"] = np.repeat(self._messages[:, None], self.roles[OBSERVER], axis=1)
        return {OBSERVER: shown}

    def _more_state(self) -> list[NDArray[Any]]:
        return [self.places, self._messages]

    def parse(self, role: str, action: Any, lead: tuple[int, ...], name: str) -> Floats:
        """Check an action: a vote from 0 to 1 for each UAV, then the message, then the flight."""
        shape, low = (*lead, len(self._low)), self._low
        if isinstance(self.action_spaces[role], spaces.MultiBinary):
            return game.parse_candidates(action, shape, name).astype(np.float64)
        values = as_array(name, action)
        if values.shape != shape or values.dtype.kind not in "biuf" or not ((values >= low) & (values <= 1)).all():
            bounds = f"numbers from {low[0]:g} to 1" + (", the last three from -1" if self._speed else "")
            raise ArgumentError(f"{name} must have shape {shape} and hold {bounds}, got {quote(action)}.")
        values = values.astype(np.float64)
        if self.fusion != "scores":
            values[..., : self.config.uavs] = values[..., : self.config.uavs] > 0
        return values


@list_arguments(observation=OBSERVATION)
class parallel_env(base.UsnetParallelEnv):  # PettingZoo's name for it
    """Several observers, each of which sees a part of the swarm, find its heads together (cooperative).

    ## Description
    The swarm and the rounds are those of `USNET/MultiCluster-v0`. K observers stand in the arena, or fly in it
    if they have an `observer_speed`. Each sees the UAVs that are within its range at an instant, with its own sensing
    noise, and votes. A fusion rule combines the votes into the candidates of the round, which are destroyed. Observers
    may send each other a short message, which arrives with the next window. With one observer that sees all UAVs the
    game equals `USNET/MultiCluster-v0`.

    ## Agents
    `observer_0` to `observer_{K-1}`. All of them stay until the game ends.

    ## Action Space
    The vote: `MultiBinary(N)`, or `Box(0, 1, (N,))` if the fusion rule takes scores. A vote for a UAV that the observer
    did not see in this window, or that is destroyed, does not count. With `message_size` B the action has B more
    values of the same type, the message.

    With an `observer_speed` the action is one `Box`, `(N + B + 3,)`: the votes, the message and the flight. The flight,
    from −1 to 1, is the velocity until the end of the next window in units of `observer_speed`; a longer vector than 1
    is shortened, and at the border of the arena the observer flies along it. Votes and the message go from 0 to 1 if
    the fusion rule takes scores; else from −1 to 1, and a number above 0 is a vote.

    ## Observation Space
    {observation}
    | `legal` | `(N,)` | int8 | | 1 for the living UAVs that this observer saw: only votes for them count |
    | `place` | `(3,)` | float32 | m | position of this observer at the end of the window |
    | `messages` | `(K, B)` | float32 | | messages of all observers in the previous round; only if `message_size` > 0 |

    A `usnet_env.Window` can be made from the first five.

    ## Rewards
    In each round every observer gets the reward of P2 for the fused candidates, −(1 + `redundancy_price` · redundant /
    N). With price 1 the return is −J_m.

    `info` is that of `USNET/MultiCluster-v0`, the same for all observers.

    ## Starting State
    That of `USNET/MultiCluster-v0` with the same seed. The observers are placed on a grid over the arena
    (`grid`), or at random positions drawn for each game (`uniform`), and stand there in the first window.

    ## Episode End
    The game terminates for all observers when no head is left (the last windows are empty). It is truncated after
    `max_rounds` rounds.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {**base.UsnetParallelEnv.metadata, "name": "usnet_observers_v0"}

    games: batch_env

    @takes_arguments(ObserversArguments)
    def __init__(self, arguments: ObserversArguments) -> None:
        super().__init__(batch_env(1, **dict(arguments)))

    def list_observers(self) -> Floats | None:
        """``(K, 4)``, position and sensing range of each observer in metres; ``None`` if they fly."""
        if self.games.sensor_config.observer_speed:
            return None
        return np.column_stack([self.games.places[0], self.games.sensor_config.expand("sensing_range")])


raw_env, env = base.make_aec_forms(parallel_env)
