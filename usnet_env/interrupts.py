"""Ctrl-C while the command ``usnet`` is being loaded: one sentence instead of a traceback."""

from __future__ import annotations

import os
import sys
from types import TracebackType

_COMMANDS = {"usnet", "-m"}  # the console script, and `python -m usnet_env` while it imports the package


def announce_interrupts() -> None:
    """Print one sentence for an interruption that nothing handles, if this program is the command ``usnet``.

    The command itself handles interruptions. Before it can, Python imports this package, which takes a second.
    """
    if os.path.basename(sys.argv[0] if sys.argv else "").removesuffix(".exe") in _COMMANDS:
        sys.excepthook = _announce


def _announce(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt):
        if sys.stderr is not None:
            print("usnet: interrupted.", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


announce_interrupts()
