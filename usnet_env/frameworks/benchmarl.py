"""The games of several agents as tasks of BenchMARL (extra ``benchmarl``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarl.environments import Task, TaskClass
from torchrl.data import Composite

from usnet_env.frameworks.torchrl import GamesEnv


class GameTask(TaskClass):  # type: ignore[misc]  # BenchMARL is an extra
    """A game in one batch, as :class:`~usnet_env.frameworks.torchrl.GamesEnv`; its configuration is its arguments."""

    def get_env_fun(self, num_envs: int, *_: Any, seed: int | None, **__: Any) -> Callable[[], GamesEnv]:
        """A function that makes the batch."""

        def make() -> GamesEnv:
            env = GamesEnv(self.name.lower(), num_envs, **self.config)
            env.set_seed(seed)
            return env

        return make

    def supports_continuous_actions(self) -> bool:
        """No."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Yes."""
        return True

    def has_render(self, env: GamesEnv) -> bool:
        """No."""
        return False

    def max_steps(self, env: GamesEnv) -> int:
        """The rounds of a game, and the opening of evasion."""
        return env.games.rules.max_rounds + 1

    def group_map(self, env: GamesEnv) -> dict[str, list[str]]:
        """The agents of each role."""
        return {role: [f"{role}_{j}" for j in range(count)] for role, count in env.games.roles.items()}

    def observation_spec(self, env: GamesEnv) -> Composite:
        """The flat observations."""
        return _select(env, "observation")

    def action_mask_spec(self, env: GamesEnv) -> Composite:
        """The masks of the legal actions."""
        return _select(env, "action_mask")

    def state_spec(self, env: GamesEnv) -> Composite:
        """The Markov state."""
        return Composite(state=env.full_observation_spec_unbatched["state"])

    def action_spec(self, env: GamesEnv) -> Composite:
        """One number an agent."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: GamesEnv) -> None:
        """None."""

    @staticmethod
    def env_name() -> str:
        """The name in BenchMARL's logs."""
        return "usnet"


class UsnetTask(Task):  # type: ignore[misc]
    """The games, such as ``UsnetTask.USNET_EVASION_V0.get_task({"clusters": 3, "uavs": 12})``."""

    USNET_OBSERVERS_V0 = None
    USNET_EVASION_V0 = None

    @staticmethod
    def associated_class() -> type[GameTask]:
        """The class of the tasks."""
        return GameTask


def _select(env: GamesEnv, name: str) -> Composite:
    spec = env.full_observation_spec_unbatched
    return Composite({role: Composite({name: spec[role, name]}, shape=spec[role].shape) for role in env.games.roles})
