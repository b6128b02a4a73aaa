"""Former names of :mod:`usnet_env.parts`."""

from usnet_env.parts import format_label, parse_label  # noqa: F401
