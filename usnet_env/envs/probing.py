"""The environment in which the observer acts: it steers intruders, watches who reacts, and names the head in time."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from gymnasium import spaces
from pydantic import Field

from usnet_env.arrays import Mask, Observation, Singles
from usnet_env.config import ArgumentError, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.batch import WINDOW
from usnet_env.envs.distribution import DistributionArguments, EpisodeSampler
from usnet_env.envs.usnet import INFO, OBSERVATION, OutputArguments, UsnetEnv
from usnet_env.swarm import SwarmConfig
from usnet_env.swarm.config import Count, MobilityArguments, Price, SensorArguments, SwarmArguments
from usnet_env.swarm.flight import fly_steps
from usnet_env.swarm.kinematics import Avoidance
from usnet_env.swarm.sensing import sense

Positive = Annotated[float, Field(gt=0, le=1000)]


class ProbingArguments(OutputArguments, game.ShotArguments, SensorArguments, MobilityArguments, SwarmArguments):
    """The arguments of :class:`ProbingEnv`."""

    instead: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("clusters", "uavs", "cluster_sizes"), "there is one cluster; its size is 'followers'"
    )

    followers: Annotated[int, Field(ge=2, le=90_000)] = Field(15, description="m, number of followers, at least 2")
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
    move_price: Price = Field(0.1, description="price of flying all intruders at top speed until then")


@list_arguments(observation=OBSERVATION, info=INFO)
class ProbingEnv(UsnetEnv):
    """P1 for an observer that acts: find the head of one cluster by flying at UAVs and watching who reacts.

    ## Description
    One head, its followers and optional decoys fly as in `USNET/SingleCluster-v0`. The agent also steers `intruders`,
    which are no UAVs of the swarm. A UAV nearer to one than `reach` turns away from it. If the head turns, its followers
    turn after it; if a follower or a decoy turns, it turns alone. So the agent can find out whom others follow where
    the flight alone doesn't show it. It sees the window so far after every `look_every` samples, and may name its
    candidates at any time.

    ## Action Space
    `Dict` of

    | key | space | meaning |
    | --- | --- | --- |
    | `velocity` | `Box(-1, 1, (K, 3))` | velocity of each intruder until the next action, in units of `top_speed`; a longer vector than 1 is shortened |
    | `candidates` | `MultiBinary(N)` | 1 for every candidate; as soon as there is one, the episode ends; N = followers + 1 + decoys |

    ## Observation Space
    {observation}
    | `intruders` | `(T_ob + 1, K, 3)` | float32 | m | true positions of the intruders; in the future the present ones |
    | `elapsed` | `(1,)` | float32 | | number of velocity samples so far |

    The other arrays are 0 in the future, that is after `elapsed`.

    ## Rewards
    −`time_price` / T_ob for each sample that is waited for; −`move_price` / T_ob times the mean speed of the
    intruders in units of `top_speed`; and for the candidates the reward of `USNET/SingleCluster-v0`: J_s at
    `redundancy_price` 1, 0 for the head alone. Naming nobody when the window is full scores −1.

    {info}
    | `reward_hit`, `reward_redundancy` | the parts of the reward for the candidates, as in `USNET/SingleCluster-v0` |
    | `reward_time`, `reward_moves` | the other parts of the reward |

    ## Starting State
    Roles have random indices; `formation` gives the initial positions. The window starts after all followers have
    followed for `memory` steps. The intruders start in random directions from the middle of the swarm, so far away that
    no UAV is within their `reach`. The first observation holds one instant.

    ## Episode End
    The episode terminates with the first action that names a candidate, and with any action when the window is full.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """  # noqa: E501  # a table's row is one line

    @takes_arguments(ProbingArguments)
    def __init__(self, arguments: ProbingArguments) -> None:
        self.arguments = arguments
        config = arguments.part(SwarmConfig, clusters=1, uavs=arguments.followers + 1 + arguments.decoys)
        sampler = EpisodeSampler(DistributionArguments(), lambda drawn, most: config)  # all episodes are alike
        super().__init__(sampler, arguments.part(game.Rules, problem="P1", max_rounds=1), arguments)
        steps, track = config.observation_steps, (config.observation_steps + 1, arguments.intruders, 3)
        far = 3 * config.position_bound(1) + arguments.reach + arguments.top_speed * steps * config.sample_every
        window: Any = self.observation_space
        more = {"intruders": (-far, far, track), "elapsed": (0, steps, (1,))}
        boxes = {name: spaces.Box(*bounds, np.float32) for name, bounds in more.items()}
        seen = spaces.Dict({**window.spaces, **boxes})
        self.observation_space, self.observe = seen, tuple(seen)  # type: ignore[assignment]  # Dict is invariant
        moves = spaces.Box(-1, 1, track[1:], np.float32)
        self.action_space = spaces.Dict({"velocity": moves, "candidates": spaces.MultiBinary(config.uavs)})  # type: ignore[assignment]
        # The true flight so far ``position`` (S + 1, N, 3), ``velocity`` (S, N, 3) and ``intruders`` (T_ob + 1, K, 3),
        # the samples ``elapsed``, and the seed of the ``sensor``.
        self._flight: dict[str, Any] = {}
        self._costs = {"reward_time": 0.0, "reward_moves": 0.0}  # of the last step
        self._shown: Observation = {}  # the present observation

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly until the next look, or score the candidates if there are any or the window is full.

        Raises:
            ArgumentError: the action has another form or values out of range, or the episode has ended.
        """
        self._games.require_running()
        velocity, candidates = self._parse(action)
        elapsed, steps = self._flight["elapsed"], self.config.observation_steps
        named = bool(candidates.any()) or elapsed == steps
        share = 0.0 if named else min(self.arguments.look_every, steps - elapsed) / steps
        speed = np.linalg.norm(velocity, axis=1).mean()
        self._costs["reward_time"] = 0.0 - self.arguments.time_price * share
        self._costs["reward_moves"] = 0.0 - float(self.arguments.move_price * share * speed)
        reward = sum(self._costs.values())
        if named:
            reward = float(self._games.play_round(candidates, np.ones(1, bool))[0])
        else:
            self._fly_on(np.float32(self.arguments.top_speed) * velocity)
        return self._observe(self.observe), reward, named, False, self._info()

    def _parse(self, action: Any) -> tuple[Singles, Mask]:
        """Check an action: the velocities ``(K, 3)``, of length 1 at most, and the candidates ``(N,)``."""
        if not isinstance(action, Mapping) or set(action) != {"velocity", "candidates"}:
            raise ArgumentError(f"action must have the keys velocity and candidates, got {quote(action)}.")
        velocity, shape = np.asarray(action["velocity"]), (self.arguments.intruders, 3)
        if velocity.shape != shape or velocity.dtype.kind not in "iuf" or not (np.abs(velocity) <= 1).all():
            raise ArgumentError(f"velocity must have shape {shape} and numbers from -1 to 1, got {quote(velocity)}.")
        length = np.linalg.norm(velocity, axis=1, keepdims=True)
        candidates = game.parse_candidates(action["candidates"], (self.config.uavs,), "candidates")
        return (velocity / np.maximum(length, 1)).astype(np.float32), candidates

    def _fly(self) -> None:
        """Begin the window: fly the unobserved steps, and place the intruders around the swarm."""
        config, games, steps = self.config, self._games, self.config.observation_steps
        swarm, *_ = fly_steps([config], games.game.swarm, games.rngs, config.memory)
        games.game = replace(games.game, swarm=swarm)
        position = swarm.position[0]
        middle = position.mean(axis=0)
        away = self.np_random.standard_normal((self.arguments.intruders, 3))
        away *= (np.linalg.norm(position - middle, axis=1).max() + self.arguments.reach) / np.linalg.norm(
            away, axis=1, keepdims=True
        )
        samples = steps * config.sample_every
        self._flight = {
            "position": position.repeat(samples + 1, axis=0).reshape(-1, samples + 1, 3).swapaxes(0, 1).copy(),
            "velocity": np.zeros((samples, config.uavs, 3), np.float32),
            "intruders": (middle + away).astype(np.float32)[None].repeat(steps + 1, axis=0),
            "elapsed": 0,
            "sensor": int(self.np_random.integers(2**63)),
        }
        self._costs = dict.fromkeys(self._costs, 0.0)
        self._look()

    def _fly_on(self, velocity: Singles) -> None:
        """Fly until the next look with intruders at ``(K, 3)`` metres per step."""
        flight, arguments, every = self._flight, self.arguments, self.config.sample_every
        games, begin = self._games, flight["elapsed"]
        samples = min(arguments.look_every, self.config.observation_steps - begin)
        position, model = flight["intruders"][begin], self.config.kinematics_model
        avoidance = Avoidance(model, position[None], velocity[None], arguments.reach, arguments.push, self.config.uavs)
        config, first = self.config.model_copy(update={"kinematics": avoidance}), begin * every
        swarm, flown, speed = fly_steps([config], games.game.swarm, games.rngs, samples * every)
        flown, speed = flown[0, config.memory :, : config.uavs], speed[0, config.memory :, : config.uavs]
        flight["position"][first : first + samples * every + 1] = flown
        flight["position"][first + samples * every + 1 :] = flown[-1]
        flight["velocity"][first : first + samples * every] = speed
        passed = np.minimum(np.arange(len(flight["intruders"]) - begin), samples)[:, None, None]
        flight["intruders"][begin:] = position + np.float32(every) * passed.astype(np.float32) * velocity
        flight["elapsed"] = begin + samples
        games.game = replace(games.game, swarm=swarm)
        self._look()

    def _look(self) -> None:
        """Observe the window so far anew with the same random numbers of the sensor, so that the past stays."""
        flight, games, elapsed = self._flight, self._games, self._flight["elapsed"]
        flown, swarm = (flight["position"][None].copy(), flight["velocity"][None]), games.game.swarm
        seen = sense([self.config], *flown, swarm.alive, [np.random.default_rng(flight["sensor"])], swarm.free)
        games.window = {name: getattr(seen, name).copy() for name in WINDOW}
        for name, part in games.window.items():
            part[:, elapsed + (name != "velocity") :] = 0
        games.watch(games.all_games)
        self._scene = {"intruders": flight["intruders"].copy()}
        self._shown = games.observe(game.PARTS, 0) | self._scene | {"elapsed": np.full(1, elapsed, np.float32)}

    def _observe(self, names: Sequence[str]) -> Observation:
        return {name: self._shown[name].copy() for name in names}

    def _info(self) -> dict[str, Any]:
        return self._costs | super()._info()

    def _settings(self) -> dict[str, Any]:
        return {"arguments": self.arguments.model_dump()}

    def get_state(self) -> dict[str, Any]:
        """A copy of the complete state of the episode as plain arrays and numbers."""
        return super().get_state() | {"observation": copy.deepcopy(self._shown), "flight": copy.deepcopy(self._flight)}

    def set_state(self, state: dict[str, Any]) -> Observation:
        """Restore a state from :meth:`get_state` of an environment with the same arguments, and show its observation.

        Raises:
            ArgumentError: the state is of an environment with other arguments.
        """
        super().set_state(state)
        self._shown, self._flight = copy.deepcopy((state["observation"], state["flight"]))
        self._scene = {"intruders": self._shown["intruders"]}
        return self._observe(self.observe)
