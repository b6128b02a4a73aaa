"""Games with several agents for PettingZoo: observers that vote, and heads that evade detection.

The games are the modules ``usnet_observers_v0`` and ``usnet_evasion_v0``, each with ``env``, ``parallel_env`` and
``raw_env``. If PettingZoo is installed, importing this package registers both games with it.
"""

from importlib.util import find_spec

#: The modules of the games, and what happens in each.
GAMES = {
    "usnet_observers_v0": "PettingZoo: several observers each see a part of one swarm, and vote on the candidates.",
    "usnet_evasion_v0": "PettingZoo: heads choose how to fly in order to evade detection.",
}


def register_games() -> None:
    """Register both games in AEC and Parallel form with PettingZoo; a second call changes nothing."""
    from pettingzoo import aec_registry, parallel_registry, register

    for form, registry, constructor in (("aec", aec_registry, "env"), ("parallel", parallel_registry, "parallel_env")):
        known = {spec.entry_point for spec in registry.values()}
        for game in GAMES:
            if (entry_point := f"usnet_env.multiagent.{game}:{constructor}") not in known:
                register(form, game, entry_point=entry_point)


if find_spec("pettingzoo") is not None:
    register_games()
