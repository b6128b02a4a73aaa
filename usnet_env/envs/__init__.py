"""The Gymnasium environments of the paper's problems P1 and P2 and of the field, single and vectorised."""

from usnet_env.envs.distribution import DISTRIBUTIONS, Distribution
from usnet_env.envs.usnet import MultiClusterEnv, SingleClusterEnv, UsnetEnv
from usnet_env.envs.vector import MultiClusterVectorEnv, SingleClusterVectorEnv, UsnetVectorEnv
from usnet_env.envs.wrappers import MultiDiscreteCandidates
from usnet_env.registration import ENVIRONMENTS, register_environments

__all__ = ["MultiClusterEnv", "SingleClusterEnv", "UsnetEnv"]
__all__ += ["MultiClusterVectorEnv", "SingleClusterVectorEnv", "UsnetVectorEnv"]
__all__ += ["DISTRIBUTIONS", "ENVIRONMENTS", "Distribution", "MultiDiscreteCandidates", "register_environments"]
