"""The environment in which the observer acts: it steers intruders, watches who reacts, and names the head in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Indices, Mask, Observation, Singles
from usnet_env.config import ArgumentError, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.batch import WINDOW, SwarmGames
from usnet_env.envs.distribution import DistributionArguments, EpisodeSampler
from usnet_env.envs.usnet import INFO, OBSERVATION, ClusterArguments, UsnetEnv, make_cluster
from usnet_env.envs.vector import UsnetVectorEnv
from usnet_env.swarm import SwarmConfig
from usnet_env.swarm.config import Count, Price
from usnet_env.swarm.flight import fly_steps
from usnet_env.swarm.kinematics import Avoidance
from usnet_env.swarm.sensing import sense
from usnet_env.window import as_array

COSTS = "reward_time", "reward_moves"
MARGIN = 1.0  # by which the score of a name exceeds all others in a flat action
Positive = Annotated[float, Field(gt=0, le=1000)]


class ProbingArguments(ClusterArguments):
    """The arguments of :class:`ProbingEnv`."""

    formation: str = Field(
        "gathered", description="initial positions: ``gathered`` in a ball of 60 m, ``around`` heads, or ``uniform``"
    )
    observation_steps: Count = Field(60, description="T_ob, number of velocity samples until the window is full")
    look_every: Count = Field(4, description="k, samples from one action to the next")
    intruders: Annotated[int, Field(ge=1, le=100)] = Field(1, description="K, number of intruders")
    top_speed: Positive = Field(4.0, description="of an intruder, metres per step; a UAV flies 1 m per step")
    reach: Positive = Field(20.0, description="distance from which a UAV avoids an intruder, m")
    push: Price = Field(3.0, description="weight of the avoidance at distance 0; what a UAV wants has weight 1")
    time_price: Price = Field(0.2, description="price of watching until the window is full")
    move_price: Price = Field(0.1, description="price of flying one intruder at top speed until then")
    actions: Literal["dict", "flat"] = Field("dict", description="the form of an action: ``dict`` or ``flat``")


class ProbingGames(SwarmGames):
    """``num_envs`` games of :class:`ProbingEnv` in one batch.

    A window grows look by look. A look observes all of it anew with the same random numbers of the sensor, so that its
    past stays.

    Attributes:
        arguments: those of the environment.
        flight: the true flight so far ``position`` ``(B, S + 1, N, 3)``, ``velocity`` ``(B, S, N, 3)`` and
            ``intruders`` ``(B, T_ob + 1, K, 3)``, the samples ``elapsed`` ``(B,)``, and the seeds ``sensor`` ``(B,)``.
    """

    def __init__(self, num_envs: int, config: SwarmConfig, rules: game.Rules, arguments: ProbingArguments) -> None:
        super().__init__(num_envs, config, rules, pictures=arguments.render_mode is not None)
        self.arguments, samples = arguments, config.observation_steps * config.sample_every
        self.flight: dict[str, NDArray[Any]] = {
            "position": np.zeros((num_envs, samples + 1, config.uavs, 3), np.float32),
            "velocity": np.zeros((num_envs, samples, config.uavs, 3), np.float32),
            "intruders": np.zeros((num_envs, config.observation_steps + 1, arguments.intruders, 3), np.float32),
            "elapsed": np.zeros(num_envs, np.int64),
            "sensor": np.zeros(num_envs, np.int64),
        }
        self._steer = np.zeros((num_envs, arguments.intruders, 3), np.float32)
        self._flies = np.zeros(num_envs, bool)  # the games whose window grows in the next flight

    def start(self, games: Indices) -> None:
        """Start some games: fly the unobserved steps, place the intruders around the swarm, and look."""
        super().start(games)
        self.metrics = dict.fromkeys(COSTS, np.zeros(self.num_envs)) | self.metrics
        self._fly_rows_on(self.config, games, self.config.memory)
        position, reach = self.game.swarm.position[games], self.arguments.reach
        for b, uavs in zip(games.tolist(), position, strict=True):
            middle, away = uavs.mean(axis=0), self.rngs[b].standard_normal(self._steer.shape[1:])
            far = np.linalg.norm(uavs - middle, axis=1).max() + reach
            away *= far / np.linalg.norm(away, axis=1, keepdims=True)
            self.flight["intruders"][b] = middle + away
            self.flight["sensor"][b] = self.rngs[b].integers(2**63)
        self.flight["position"][games] = position[:, None]
        self.flight["velocity"][games] = 0
        self.flight["elapsed"][games] = 0
        self._look(games)

    def parse_action(self, action: Any, lead: tuple[int, ...] = ()) -> tuple[Singles, Indices, Indices]:
        """Check an action.

        Returns:
            The velocities ``(*lead, K, 3)`` of length 1 at most; the name ``(*lead,)``, N for none yet; and the name
            once the window is full.
        """
        shape, names = (*lead, self.arguments.intruders, 3), self.config.uavs + 1
        if self.arguments.actions == "flat":
            flat = _parse_numbers("action", action, (*lead, 3 * self.arguments.intruders + names))
            steer, scores = flat[..., :-names].reshape(shape), flat[..., -names:]
            second, first = np.moveaxis(np.partition(scores, -2, axis=-1)[..., -2:], -1, 0)
            best = scores.argmax(axis=-1)
            name = np.where(first - second > MARGIN, best, names - 1)
        else:
            if not isinstance(action, Mapping) or set(action) != {"steer", "name"}:
                raise ArgumentError(f"action must have the keys steer and name, got {quote(action)}.")
            steer, name = _parse_numbers("steer", action["steer"], shape), as_array("name", action["name"])
            if name.shape != lead or name.dtype.kind not in "iu" or not ((name >= 0) & (name < names)).all():
                raise ArgumentError(f"name must hold whole numbers from 0 to {names - 1}, got {quote(action['name'])}.")
            best = name
        return steer / np.maximum(np.linalg.norm(steer, axis=-1, keepdims=True), 1), name, best

    def play_round(self, action: Any, playing: Mask) -> Floats:
        """Score the names of the games that have one or a full window, and charge the others for the next look."""
        steer, name, best = action
        elapsed, steps, arguments = self.flight["elapsed"], self.config.observation_steps, self.arguments
        full = elapsed == steps
        named = playing & (full | (name < self.config.uavs))
        reward = np.zeros(self.num_envs)
        if named.any():
            reward = super().play_round(np.where(full, best, name)[:, None] == np.arange(self.config.uavs), named)
        self._flies = playing & ~named
        self._steer = np.broadcast_to(np.float32(arguments.top_speed) * steer, self._steer.shape)
        share = np.where(self._flies, np.minimum(arguments.look_every, steps - elapsed) / steps, 0.0)
        speed = np.linalg.norm(steer, axis=-1).sum(axis=-1, dtype=np.float64)
        costs = 0.0 - arguments.time_price * share, 0.0 - arguments.move_price * share * speed
        self.metrics = self.metrics | dict(zip(COSTS, costs, strict=True))
        return np.asarray(reward + sum(costs))

    def fly(self, games: Indices) -> None:
        """Fly some games until the next look; of those that are over or have just begun, the window stays."""
        flying = games[self._flies[games]]
        samples = np.minimum(self.arguments.look_every, self.config.observation_steps - self.flight["elapsed"][flying])
        for count in np.unique(samples).tolist():
            self._fly_on(flying[samples == count], count)
        self._flies[flying] = False

    def _fly_on(self, games: Indices, samples: int) -> None:
        """Fly some games for so many samples, with the intruders, and look."""
        flight, arguments, every = self.flight, self.arguments, self.config.sample_every
        begin, steer, steps = flight["elapsed"][games], self._steer[games], samples * every
        place, model = flight["intruders"][games, begin], self.config.kinematics_model
        avoidance = Avoidance(model, place, steer, arguments.reach, arguments.push, self.config.uavs)
        config = self.config.model_copy(update={"kinematics": avoidance})
        flown, speed = self._fly_rows_on(config, games, steps)
        passed = np.minimum(np.arange(self.config.observation_steps + 1), samples).astype(np.float32)[:, None, None]
        for row, (b, t) in enumerate(zip(games.tolist(), begin.tolist(), strict=True)):
            position, velocity, first = flight["position"][b], flight["velocity"][b], t * every
            position[first : first + steps + 1] = flown[row]
            position[first + steps + 1 :] = flown[row, -1]
            velocity[first : first + steps] = speed[row]
            intruders = flight["intruders"][b, t:]
            intruders[:] = place[row] + np.float32(every) * passed[: len(intruders)] * steer[row]
        flight["elapsed"][games] += samples
        self._look(games)

    def _fly_rows_on(self, config: SwarmConfig, games: Indices, steps: int) -> tuple[Singles, Singles]:
        """Fly some games: positions ``(n, steps + 1, N, 3)`` and velocities ``(n, steps, N, 3)``."""
        chosen, all_games, state = games.tolist(), len(games) == self.num_envs, self.game
        swarm = state.swarm if all_games else state.swarm.rows(games)
        after, *tracks = fly_steps([config] * len(chosen), swarm, [self.rngs[b] for b in chosen], steps)
        self._game = replace(state, swarm=after if all_games else state.swarm.with_rows(games, after))
        position, velocity = (track[:, config.memory :, : config.uavs] for track in tracks)
        return position, velocity

    def _look(self, games: Indices) -> None:
        """Observe the windows of some games so far; what comes later is 0."""
        flight, swarm = self.flight, self.game.swarm
        flown = flight["position"][games], flight["velocity"][games]  # copies
        sensors = [np.random.default_rng(seed) for seed in flight["sensor"][games].tolist()]
        seen = sense([self.config] * len(games), *flown, swarm.alive[games], sensors, swarm.free[games])
        later = np.arange(self.config.observation_steps + 1) > flight["elapsed"][games, None]
        for name in WINDOW:
            part = getattr(seen, name)
            part[later[:, 1:] if name == "velocity" else later] = 0
            self.window[name][games] = part
        self.watch(games)

    def observe(self, names: Sequence[str], games: Any = slice(None)) -> Observation:
        """Parts of the present observation of some games, or of one without the leading axis, as copies."""
        more = {"intruders": self.flight["intruders"][games], "elapsed": self.flight["elapsed"][games, None]}
        parts = super().observe([name for name in names if name not in more], games)
        parts |= {name: part.astype(np.float32) for name, part in more.items() if name in names}
        return {name: parts[name] for name in names}

    def draw(self, b: int = 0, **scene: Any) -> NDArray[np.uint8]:
        """Draw the window of a game with the tracks of its intruders, ``(H, W, 3)``."""
        return super().draw(b, intruders=self.flight["intruders"][b], **scene)


def _parse_numbers(name: str, value: Any, shape: tuple[int, ...]) -> Singles:
    """Check numbers from -1 to 1 of a shape; errors call them ``name``."""
    numbers = as_array(name, value)
    if numbers.shape != shape or numbers.dtype.kind not in "iuf" or not (np.abs(numbers) <= 1).all():
        raise ArgumentError(f"{name} must have shape {shape} and numbers from -1 to 1, got {quote(value)}.")
    return numbers.astype(np.float32)


@list_arguments(observation=OBSERVATION, info=INFO)
class ProbingEnv(UsnetEnv):
    """P1 for an observer that acts: find the head of one cluster by flying at UAVs and watching who reacts.

    ## Description
    One head, its followers and optional decoys fly as in `USNET/SingleCluster-v0`. The agent also steers `intruders`,
    which are no UAVs of the swarm. A UAV nearer to one than `reach` turns away from it. If the head turns, its followers
    turn after it; if a follower or a decoy turns, it turns alone. So the agent can find out which UAV others follow where
    the flight alone doesn't show it. It sees the window so far after every `look_every` samples, and may name the
    head at any time.

    ## Action Space
    `Dict` of

    | key | space | meaning |
    | --- | --- | --- |
    | `steer` | `Box(-1, 1, (K, 3))` | velocity of each intruder until the next action, in units of `top_speed`; a longer vector than 1 is shortened |
    | `name` | `Discrete(N + 1)` | the UAV that is named, which ends the episode; N: none yet; N = followers + 1 + decoys |

    With `actions="flat"` it is `Box(-1, 1, (3 K + N + 1,))`: the velocities, then a score of each value of `name`. The value
    with the greatest score counts if it exceeds all others by more than 1, or if the window is full; if not, no UAV is named
    yet. So an agent that knows nothing mostly waits.

    ## Observation Space
    {observation}
    | `intruders` | `(T_ob + 1, K, 3)` | float32 | m | true positions of the intruders; in the future the present ones |
    | `elapsed` | `(1,)` | float32 | | number of velocity samples so far |

    The other arrays are 0 in the future, that is after `elapsed`.

    ## Rewards
    −`time_price` / T_ob for each sample that is waited for; −`move_price` / T_ob times the sum of the speeds of all
    intruders in units of `top_speed`; and for the name the reward of `USNET/SingleCluster-v0`: 0 for the head, −1 for
    another UAV or for none when the window is full. An intruder that stays at a position costs nothing there, and pushes
    the UAVs that come near.

    {info}
    | `reward_hit`, `reward_redundancy` | the parts of the reward for the name, as in `USNET/SingleCluster-v0` |
    | `reward_time`, `reward_moves` | the other parts of the reward |

    ## Starting State
    Roles have random indices; `formation` gives the initial positions. The window starts after all followers have
    followed for `memory` steps. The intruders start in random directions from the middle of the swarm, so far away that
    no UAV is within their `reach`. The first observation holds one instant.

    ## Episode End
    The episode terminates with the first action that names a UAV, and with any action when the window is full.

    ## Arguments
    {arguments}

    ## Version History
    * v1: one name in place of candidates, and `steer` in place of `velocity`; each intruder's way has its price; a batch
    * v0: first version
    """  # noqa: E501  # a table's row is one line

    _games: ProbingGames

    @takes_arguments(ProbingArguments)
    def __init__(self, arguments: ProbingArguments) -> None:
        self.arguments = arguments
        sampler = EpisodeSampler(DistributionArguments(), partial(make_cluster, arguments))  # all episodes are alike
        config = sampler.widest
        super().__init__(sampler, game.Rules(problem="P1", max_rounds=1), arguments)
        steps, count, names = config.observation_steps, arguments.intruders, config.uavs + 1
        far = 3 * config.position_bound(1) + arguments.reach + arguments.top_speed * steps * config.sample_every
        window: Any = self.observation_space
        more = {"intruders": (-far, far, (steps + 1, count, 3)), "elapsed": (0, steps, (1,))}
        boxes = {name: spaces.Box(*bounds, np.float32) for name, bounds in more.items()}
        seen = spaces.Dict({**window.spaces, **boxes})
        self.observation_space, self.observe = seen, tuple(seen)  # type: ignore[assignment]  # Dict is invariant
        steer = spaces.Box(-1, 1, (count, 3), np.float32)
        flat = spaces.Box(-1, 1, (3 * count + names,), np.float32)
        both = spaces.Dict({"steer": steer, "name": spaces.Discrete(names)})
        self.action_space = flat if arguments.actions == "flat" else both  # type: ignore[assignment]

    def _make_games(self, num_envs: int) -> ProbingGames:
        return ProbingGames(num_envs, self.widest_config, self.rules, self.arguments)

    def _settings(self) -> dict[str, Any]:
        return {"arguments": self.arguments.model_dump()}

    def get_state(self) -> dict[str, Any]:
        """A copy of the complete state of the episode as plain arrays and numbers."""
        flight = {name: part[self._number].copy() for name, part in self._games.flight.items()}
        return super().get_state() | {"flight": flight}

    def set_state(self, state: dict[str, Any]) -> Observation:
        """Restore a state; see :meth:`UsnetEnv.set_state`."""
        if not self._games.metrics:  # those of the name are there from the first reset on
            self.reset()
        super().set_state(state)
        for name, part in self._games.flight.items():
            part[self._number] = state["flight"][name]
        return self._games.observe(self.observe, self._number)


class ProbingVectorEnv(UsnetVectorEnv):
    """B games of :class:`ProbingEnv`; see ``gym.make_vec("usnet_env:USNET/Probing-v1", num_envs=B)``."""

    single_env = ProbingEnv
