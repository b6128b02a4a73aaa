"""Former names of :mod:`usnet_env.parts`."""

from usnet_env import parts
from usnet_env.parts import REGISTRIES, are_equal, check_call, describe_error, named_parameters  # noqa: F401

OWN_DISTRIBUTION = "usnet"


class Registry(parts.Registry):
    def __init__(self, kind, argument, group, home, accept, own=None, **options):
        super().__init__(kind, argument, group, accept, own, **options)
