"""The memory that a detector needs which compares all pairs of UAVs."""

from __future__ import annotations

from usnet_env.config import ArgumentError

__all__ = ["MOST_UAVS", "check_pairs"]

MOST_UAVS = 10_000  # a matrix of all pairs then takes 0.75 GiB, and a detector holds several


def check_pairs(uavs: int) -> None:
    """Refuse a window whose matrices of pairs would be too large.

    Args:
        uavs: N.

    Raises:
        ArgumentError: N is above :data:`MOST_UAVS`.
    """
    if uavs > MOST_UAVS:
        size = 8 * uavs**2 / 2**30
        raise ArgumentError(
            f"window must hold at most {MOST_UAVS} UAVs for a detector that compares all pairs, got {uavs}: "
            f"one matrix of pairs takes {size:.1f} GiB."
        )
