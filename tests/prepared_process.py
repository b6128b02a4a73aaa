"""A process of which the tests' worker processes are copies imports this: the libraries, and all that one game loads."""

import matplotlib.figure  # noqa: F401
import sklearn.cluster  # noqa: F401
import torch
import torch._dynamo  # noqa: F401  # the first optimiser of a process would import it

import detectors.checks
import usnet_env
import usnet_env.cli  # noqa: F401

usnet_env.evaluate(
    "USNET/MultiCluster-v0", "none", episodes=1, env_kwargs={"clusters": 1, "uavs": 4, "observation_steps": 4}
)
