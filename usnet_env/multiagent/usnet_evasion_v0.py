"""``usnet_evasion_v0``: heads choose how to fly in order to evade detection."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, format_count, list_arguments, quote, takes_arguments
from usnet_env.envs import game
from usnet_env.envs.batch import WINDOW
from usnet_env.multiagent import base
from usnet_env.multiagent.batch import OBSERVER, ByRole, GameBatch, Observations
from usnet_env.multiagent.evasion import Manoeuvres, Plan, compute_prices, find_followers, fly_windows, select_decoys
from usnet_env.swarm import SwarmConfig, SwarmState
from usnet_env.swarm.config import SensorArguments, Steps
from usnet_env.swarm.flock_follow import Flock
from usnet_env.swarm.state import find_each
from usnet_env.window import as_array

HEAD = "head"


class EvasionArguments(base.GameArguments, SensorArguments, Manoeuvres):
    """The arguments of :class:`parallel_env`."""

    memory: Steps = Field(8, description="T_0; at least the lags of the follow strategy + ``most_delay``")


class batch_env(GameBatch):  # named as PettingZoo names the forms of a game
    """``num_envs`` games of :class:`parallel_env` in one batch; the roles are ``observer`` and ``head``."""

    def __init__(self, num_envs: int, **arguments: Any) -> None:
        checked = EvasionArguments(**arguments)
        self.manoeuvres, rules = checked.part(Manoeuvres), checked.make_rules(opening=1)
        config = checked.part(SwarmConfig, mobility=checked.mobilities[0])
        uavs, most_delay, strategy = config.uavs, checked.most_delay, config.follow_strategy
        if strategy is None or strategy.has_references or not strategy.has_followers or strategy.shifts_tracks:
            raise ArgumentError(
                f"follow must be a follow strategy whose heads choose how to fly, got {quote(config.follow)}."
            )
        if most_delay and (isinstance(strategy, Flock) or strategy.lags + most_delay > config.memory):
            raise ArgumentError(
                f"most_delay must be at most memory - {strategy.lags} for follow={quote(config.follow)}, and 0 for a "
                f"flock, which doesn't fly by the past of its head; got {most_delay} with memory={config.memory}."
            )
        window_spaces = game.observation_space(config, rules).spaces
        far = window_spaces["position"].high.flat[0]  # type: ignore[attr-defined]  # a Box
        mask, choices = spaces.MultiBinary(uavs), self.manoeuvres.choices
        head_spaces = {
            "position": spaces.Box(-far, far, (uavs, 3), np.float32),
            "velocity": spaces.Box(-config.speed_bound(), config.speed_bound(), (uavs, 3), np.float32),
            **dict.fromkeys(("alive", "self", "heads", "followers", "named"), mask),
            "round": spaces.Box(0, rules.max_rounds, (1,), np.float32),
            "legal": spaces.MultiBinary(int(choices.sum())),
        }
        roles: dict[str, tuple[int, spaces.Dict, spaces.Space[Any]]] = {
            OBSERVER: (1, spaces.Dict({**window_spaces, "legal": mask}), spaces.MultiBinary(uavs)),
            HEAD: (config.clusters, spaces.Dict(head_spaces), spaces.MultiDiscrete(choices)),
        }
        super().__init__(num_envs, config, rules, roles, checked.render_mode)
        self._flown = np.zeros((num_envs, config.clusters), np.int64)  # the mobility of each head in the window
        self._decoys = np.zeros((num_envs, uavs), bool)  # the followers that are decoys in the window
        self._prices = {role: np.zeros((num_envs, count)) for role, count in self.roles.items()}

    def _begin(self, games: Indices) -> None:
        self.has_window[games], self._flown[games], self._decoys[games] = False, 0, False
        for array in self.window.values():
            array[games] = 0

    def _combine(self, actions: ByRole) -> tuple[Mask, Floats]:
        named = actions[OBSERVER][:, 0]
        return named, named.astype(np.float64)

    def _respond(self, actions: ByRole) -> ByRole:
        """Plan the flight, and return the prices: the observer is told what all heads pay."""
        self._plan = actions[HEAD]
        prices = compute_prices(self.manoeuvres, self.game.swarm, Plan(*np.moveaxis(self._plan, 2, 0)))
        return {OBSERVER: prices.sum(axis=1, keepdims=True), HEAD: prices}

    def _fly_rows(self, swarm: SwarmState, rows: Indices) -> tuple[SwarmState, Observation]:
        plan, rngs = Plan(*np.moveaxis(self._plan[rows], 2, 0)), [self.rngs[b] for b in rows]
        uavs, taken = decoys = select_decoys(swarm, plan)
        self._decoys = self._decoys.copy()
        self._decoys[rows] = False
        game_of, *which = np.nonzero(taken)
        self._decoys[rows[game_of], uavs[game_of, *which]] = True
        after, window, self._flown[rows] = fly_windows(
            self.config, self.manoeuvres, swarm, self._flown[rows], plan, decoys, rngs
        )
        self.has_window[rows] = True
        return after, {name: getattr(window, name)[:, None] for name in WINDOW}

    def _find_leaving(self) -> ByRole:
        swarm = self.game.swarm
        return {HEAD: ~np.take_along_axis(swarm.alive, find_each(swarm.head), axis=1)}

    def _observe(self) -> Observations:
        state, uavs, clusters = self.game, self.config.uavs, self.config.clusters
        swarm, heads, followers = state.swarm, find_each(state.swarm.head), find_followers(state.swarm)
        legal = np.ones((self.num_envs, clusters, int(self.manoeuvres.choices.sum())), np.int8)
        most = np.maximum(followers.sum(axis=2) - 1, 0)  # one follower must remain
        first, decoys = self.manoeuvres.choices[:2].sum(), np.arange(self.manoeuvres.choices[2])
        legal[..., first : first + len(decoys)] = decoys <= most[..., None]
        alike: Observation = {
            "position": swarm.position,
            "velocity": swarm.past_velocity[:, -1],
            "alive": swarm.alive.astype(np.int8),
            "heads": (swarm.head & swarm.alive).astype(np.int8),
            "named": self.candidates.astype(np.int8),
            "round": state.rounds[:, None].astype(np.float32),
        }
        seen = {name: np.repeat(array[:, None], clusters, axis=1) for name, array in alike.items()}
        seen |= {"self": (np.arange(uavs) == heads[..., None]).astype(np.int8), "followers": followers.astype(np.int8)}
        flown = self.has_window & ~state.terminated
        return {OBSERVER: self._show((swarm.alive & flown[:, None])[:, None]), HEAD: {**seen, "legal": legal}}

    def _more_state(self) -> list[NDArray[Any]]:
        return [self._flown, ~self.has_window]

    def reveal(self) -> SwarmState:
        """A copy of the true swarms; followers that are decoys in the present windows are decoys without a head."""
        truth = super().reveal()
        truth.decoy[self._decoys] = True
        truth.root[self._decoys] = np.nonzero(self._decoys)[1]
        return truth

    def parse(self, role: str, action: Any, lead: tuple[int, ...], name: str) -> NDArray[Any]:
        """Convert candidates to booleans, and choices to whole numbers."""
        if role == OBSERVER:
            return game.parse_candidates(action, (*lead, self.config.uavs), name)
        values, sizes = as_array(name, action), self.manoeuvres.choices
        numbers = values.dtype.kind in "biuf" and values.shape == (*lead, 4) and (values % 1 == 0).all()
        if not numbers or not ((values >= 0) & (values < sizes)).all():
            raise ArgumentError(
                f"{name} must hold whole numbers from 0, each below {sizes.tolist()}, got {quote(action)}."
            )
        return values.astype(np.int64)


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

    games: batch_env

    @takes_arguments(EvasionArguments)
    def __init__(self, arguments: EvasionArguments) -> None:
        super().__init__(batch_env(1, **dict(arguments)))

    def describe_action(self, agent: str, action: Any) -> str:
        """Describe the choice of a head in words; empty for the observer."""
        role, j = self._rows[agent]
        if role == OBSERVER:
            return ""
        mobility, jitter, decoys, delay = np.asarray(action).tolist()
        head = find_each(self.games.game.swarm.head)[0, j]
        words = [self.games.manoeuvres.mobilities[mobility]]
        words += ["jitter"] * (jitter > 0) + [format_count(decoys, "decoy")] * (decoys > 0)
        words += [f"followers delayed by {format_count(delay, 'step')}"] * (delay > 0)
        return f"UAV {head}: {', '.join(words)}"


raw_env, env = base.make_aec_forms(parallel_env)
