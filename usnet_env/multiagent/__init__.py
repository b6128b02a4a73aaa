"""Games with several agents for PettingZoo: observers that vote, and heads that evade detection.

The games are the modules ``usnet_observers_v0`` and ``usnet_evasion_v0``, each with ``env``, ``parallel_env`` and
``raw_env``. If PettingZoo is installed, importing this package registers both games with it. ``FUSIONS`` and
``PLACEMENTS`` are the registered parts by name, as mappings.
"""

from importlib.util import find_spec

from usnet_env.multiagent.registration import GAMES, register_games
from usnet_env.multiagent.sensors import FUSIONS, PLACEMENTS, Fusion, register_fusion, register_placement

__all__ = ["FUSIONS", "GAMES", "PLACEMENTS", "Fusion", "register_fusion", "register_games", "register_placement"]

if find_spec("pettingzoo") is not None:
    register_games()
