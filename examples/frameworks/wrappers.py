"""A wrapper of the games of several agents for frameworks that need other spaces; copy it."""

from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from usnet_env.envs.wrappers import box_masks


class ParallelBoxMasks(BaseParallelWrapper):
    """Describe the masks that the agents of a ``parallel_env`` observe as ``Box``."""

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self._observations = {agent: box_masks(env.observation_space(agent)) for agent in env.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """The observation space of an agent; the same object every time."""
        return self._observations[agent]
