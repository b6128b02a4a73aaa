"""The ids under which PettingZoo makes the games."""

from __future__ import annotations

__all__ = ["GAMES", "register_games"]

GAMES = ("usnet_observers_v0", "usnet_evasion_v0")


def register_games() -> None:
    """Register both games in both forms with PettingZoo; a second call changes nothing."""
    from pettingzoo import aec_registry, parallel_registry, register

    for kind, registry, maker in (("aec", aec_registry, "env"), ("parallel", parallel_registry, "parallel_env")):
        known = {spec.entry_point for spec in registry.values()}
        for game in GAMES:
            if (entry_point := f"usnet_env.multiagent.{game}:{maker}") not in known:
                register(kind, game, entry_point=entry_point)
