"""Games with several agents for PettingZoo: observers that vote, and heads that evade detection.

The games are the modules ``usnet_observers_v0`` and ``usnet_evasion_v0``, each with ``env``, ``parallel_env`` and
``raw_env``. If PettingZoo is installed, importing this package registers both games with it.
"""

from importlib.util import find_spec

from usnet_env.multiagent.registration import GAMES, register_games

__all__ = ["GAMES", "register_games"]

if find_spec("pettingzoo") is not None:
    register_games()
