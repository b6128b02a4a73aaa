"""What the prior draws and the network learns from: windows with their truth."""

from __future__ import annotations

from typing import NamedTuple

from usnet_env.arrays import Indices, Mask, Singles


class Examples(NamedTuple):
    """B labelled windows of n UAVs each, all alive, of one family.

    Args:
        position: ``(B, T + 1, n, 3)`` float32, metres; 0 where a UAV isn't seen.
        velocity: ``(B, T, n, 3)`` float32, metres a step; 0 where a UAV isn't seen at both ends of the step.
        seen: ``(B, T + 1, n)`` bool.
        head: ``(B, n)`` bool, the UAVs that lead at least one other.
        leader: ``(B, n)`` int64, the UAV that each UAV follows directly; its own index: none.
        root: ``(B, n)`` int64, the head at the end of the chain of leaders; its own index: none.
        link: ``(B, n, n)`` float32, whether UAV i's motion depends on UAV j's itself; NaN where that isn't defined, as
            in flocks, whose neighbours change.
        delay: ``(B, n)`` float32, steps after which a UAV repeats its leader; NaN: none, or not defined.
        family: the name of the family in the prior.
    """

    position: Singles
    velocity: Singles
    seen: Mask
    head: Mask
    leader: Indices
    root: Indices
    link: Singles
    delay: Singles
    family: str
