"""The environment that replays recorded tracks: one window is one episode of one round."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray
from pydantic import Field

from usnet_env.arrays import Observation
from usnet_env.config import ArgumentError, Config, list_arguments, optional_seed, takes_arguments, whole_number
from usnet_env.envs.game import Rules, check_options, parse_candidates, window_spaces
from usnet_env.objectives import find_roots, group_leader_accuracy, hits_and_redundant
from usnet_env.swarm import SwarmState
from usnet_env.tracks.read import read_tracks


class TracksArguments(Config):
    """The arguments of :class:`TracksEnv`."""

    path: str = Field(description="file of tracks, as `usnet_env.tracks.read_tracks` takes it")
    window: Annotated[int, Field(ge=1, le=10**6)] = Field(100, description="T_ob, steps of a window")
    stride: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None, description="steps from the start of a window to the start of the next; `None`: those of a window"
    )
    step: Annotated[float, Field(ge=1e-9, le=1e9)] | None = Field(
        None, description="seconds of a step; `None`: chosen from the tracks"
    )
    columns: dict[str, str] | None = Field(None, description="names of columns by role, as `read_tracks` takes them")


@list_arguments()
class TracksEnv(gym.Env[Observation, NDArray[np.int8]]):
    """Find the leaders in recorded tracks.

    ## Description
    A file of recorded tracks is resampled and cut into windows. An episode is one window and has one round: the agent
    names its candidates for the heads. The truth is the file's column `leader`, the id that each id follows directly in
    most samples of the window. A head leads at least one other id and follows none. Without such a column, or if none
    of its leaders has a track, the truth is unknown: `evaluate` refuses the environment.

    ## Action Space
    `MultiBinary(N)`, N = the ids of the file: 1 for every candidate.

    ## Observation Space
    `Dict` of `position`, `velocity`, `seen`, `alive` and `round`, as in `USNET/MultiCluster-v0`, and `step`, `(1,)`
    float32, the seconds of a step. An id that isn't seen in at least half of the steps of the window is not in it: its
    `alive` is 0.

    ## Rewards
    −(1 + redundant / N), where redundant candidates are no heads: −J_m of the one round. Missed heads cost nothing:
    report `recall_first` and `success` next to J, and `group_leader_first`, the share of the groups, taken as known,
    whose head has the highest score.

    `info` holds `hits`, `redundant`, `round`, `success`, `is_success` and `J` as in `USNET/MultiCluster-v0`,
    `over_budget`, always 0, and `start` and `end`, the times of the window as in the file.

    ## Starting State
    With a seed, a window is drawn uniformly. Otherwise the windows follow one another, the first after the last.

    ## Episode End
    The episode terminates after one round. It is never truncated.

    ## Arguments
    {arguments}

    ## Version History
    * v0: first version
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]  # Gymnasium's is no ClassVar
    problem = "P2"
    rules = Rules(max_rounds=1)

    @takes_arguments(TracksArguments)
    def __init__(self, arguments: TracksArguments) -> None:
        self.config = arguments
        self.tracks = read_tracks(arguments.path, columns=arguments.columns).resample(arguments.step)
        self.windows = list(self.tracks.windows(arguments.window, arguments.stride))
        if not self.windows:
            raise ArgumentError(f"path must hold 2 ids that are seen together in a window, got {arguments.path!r}.")
        uavs = len(self.tracks.ids)
        limit = float(max(np.abs(track_window.window.position).max() for track_window in self.windows)) + 1.0
        step = spaces.Box(0, 2 * float(self.tracks.step or 1.0), (1,), np.float32)
        space = {**window_spaces(arguments.window, uavs, 2, limit, 2 * limit), "step": step}
        self.observation_space = spaces.Dict(space)  # type: ignore[assignment]  # Dict is invariant
        self.action_space = spaces.MultiBinary(uavs)
        self._number = -1
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Show a window: with a seed a drawn one, otherwise the next."""
        check_options(options)
        super().reset(seed=optional_seed("seed", seed))
        count = len(self.windows)
        self._number = (self._number + 1) % count if seed is None else int(self.np_random.integers(count))
        self._over = False
        return self._observe(1), self._info(0, 0, 0, success=False)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Score the candidates ``(N,)``; the tracks stay as they are."""
        if self._over:
            raise ArgumentError("reset must be called first, got a step in an episode that is over.")
        candidates = parse_candidates(action, (len(self.tracks.ids),))
        truth = self.swarm
        hits, redundant = map(int, hits_and_redundant(truth.head, truth.alive, candidates))
        self._over = True
        info = self._info(hits, redundant, 1, success=hits == int(truth.head.sum()))
        return self._observe(2), -info["J"], True, False, info

    @property
    def labelled(self) -> bool:
        """Whether the file says which ids lead, so that answers can be scored."""
        return self.tracks.leader is not None

    @property
    def swarm(self) -> SwarmState:
        """The truth of the present window for an evaluation, N ids; a detector must not use it."""
        track_window, uavs = self.windows[self._number], len(self.tracks.ids)
        alive, direct = np.zeros(uavs, bool), np.full(uavs, -1)
        alive[track_window.rows] = True
        if track_window.leader is not None:
            direct[track_window.rows] = np.where(track_window.leader >= 0, track_window.rows[track_window.leader], -1)
        roots = find_roots(direct)
        follows = (roots >= 0) & (roots != np.arange(uavs))
        head = np.isin(np.arange(uavs), roots[follows])
        last_position, no_velocity = np.zeros((1, uavs, 3), np.float32), np.zeros((0, uavs, 3), np.float32)
        last_position[0, track_window.rows] = track_window.window.position[-1]
        free_uavs, root = np.flatnonzero(alive & ~follows), np.where(alive, roots, -1)
        return SwarmState(
            head=head,
            decoy=alive & ~head & ~follows,
            alive=alive,
            root=root,
            past_position=last_position,
            past_velocity=no_velocity,
            free=free_uavs,
            mobility_state=np.zeros((len(free_uavs), 0)),
            parameters=np.zeros(0, np.float32),
            not_led=np.zeros(uavs, bool),
            source=root,
            clock=np.zeros((), np.int64),
            kinematic_state=np.zeros((uavs, 0), np.float32),
            reference_source=np.zeros(0, np.int64),
            reference_position=last_position[:, :0],
            reference_velocity=no_velocity[:, :0],
        )

    def score_answer(self, scores: NDArray[np.float64]) -> dict[str, float | None]:
        """The share of the groups whose head has the highest of the scores ``(N,)``; ``None`` without groups."""
        truth = self.swarm
        return {"group_leader_first": group_leader_accuracy(truth.root, scores) if truth.head.any() else None}

    def _observe(self, round: int) -> Observation:
        track_window = self.windows[self._number]
        spaces = self.observation_space.items()  # type: ignore[attr-defined]  # a Dict
        observation: Observation = {name: np.zeros(space.shape, space.dtype) for name, space in spaces}
        for name in ("position", "velocity", "seen"):
            observation[name][:, track_window.rows] = getattr(track_window.window, name)
        observation["alive"][track_window.rows] = 1
        observation["round"][:], observation["step"][:] = round, track_window.step
        return observation

    def _info(self, hits: int, redundant: int, round: int, *, success: bool) -> dict[str, Any]:
        return {
            "hits": hits,
            "redundant": redundant,
            "round": round,
            "success": int(success),
            "is_success": success,
            "J": round + redundant / len(self.tracks.ids),
            "over_budget": 0,
            **{name: self.tracks.file_time(getattr(self.windows[self._number], name)) for name in ("start", "end")},
        }


class TracksVectorEnv(SyncVectorEnv):
    """B environments, one after another; see ``gym.make_vec("usnet_env:USNET/Tracks-v0", num_envs=B, path=…)``."""

    def __init__(self, num_envs: int = 1, *, autoreset_mode: Any = AutoresetMode.NEXT_STEP, **arguments: Any) -> None:
        count = whole_number("num_envs", num_envs, 1, 1_000_000)
        super().__init__([partial(TracksEnv, **arguments)] * count, autoreset_mode=autoreset_mode)
