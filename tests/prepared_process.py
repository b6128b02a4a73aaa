"""Import the libraries, and load all that one game loads, in the process that the tests' worker processes copy."""

from contextlib import suppress
from importlib import import_module

import usnet_env

# torch._dynamo: the first optimiser of a process would import it.
for library in ("matplotlib.figure", "sklearn.cluster", "torch", "torch._dynamo", "detectors.checks", "usnet_env.cli"):
    with suppress(ImportError):  # of an extra that is not installed
        import_module(library)

usnet_env.evaluate(
    "USNET/MultiCluster-v0", "none", episodes=1, env_kwargs={"clusters": 1, "uavs": 4, "observation_steps": 4}
)
