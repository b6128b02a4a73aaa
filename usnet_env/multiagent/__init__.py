"""Games with several agents for PettingZoo: observers that vote, and heads that evade detection.

The games are the modules :mod:`usnet_env.multiagent.usnet_observers_v0` and
:mod:`usnet_env.multiagent.usnet_evasion_v0`, each with ``env``, ``parallel_env`` and ``raw_env``. PettingZoo is an
optional dependency (``pip install 'usnet[multiagent]'``). If it is installed, importing this package registers both
games with it.
"""

from importlib.util import find_spec

from usnet_env.multiagent.fusion import Fusion, fusions, register_fusion
from usnet_env.multiagent.registration import GAMES, register_games

__all__ = ["GAMES", "Fusion", "fusions", "register_fusion", "register_games"]

if find_spec("pettingzoo") is not None:
    register_games()
