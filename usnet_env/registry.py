"""Former names of :mod:`usnet_env.parts`."""

from usnet_env.parts import (  # noqa: F401
    REGISTRIES,
    Registry,
    are_equal,
    check_call,
    describe_error,
    named_parameters,
)

OWN_DISTRIBUTION = "usnet"
