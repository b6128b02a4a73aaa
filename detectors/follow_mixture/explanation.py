"""An explanation of a swarm, however it was found: who leads, who follows whom, and why one should believe it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "Explanation"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

#: What a UAV is in an explanation by a mixture: a head whose gate passed or failed, a follower, or left over. Then it
#: is alone, like a decoy, beside a strategy that leaves nothing but noise; else one of few whom nobody could follow
#: (stray), or perhaps a head (missing).
KINDS = ("passed", "failed", "follower", "stray", "missing", "alone")


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a window says of n UAVs.

    Args:
        heads: ``(M,)`` indices, ascending.
        leader: ``(n,)`` whom each UAV follows, -1 for nobody (heads among them).
        probability: ``(n,)`` of being a head as flocks say it, before calibration; without meaning where there is a
            ``kind``.
        given: ``(n,)`` the same given that somebody leads, as in a game that is not over.
        gain: ``(n,)`` log-likelihood that each follower gains by its head.
        explained: ``(n,)`` share of each follower's surprise that its head explains.
        reasons: one sentence a head: why it passed its gate, or failed.
        strategy: the strategy found, for people.
        value: what the whole explanation gains over nobody following anybody, after prices, in nats.
        kind: ``(n,)`` places in :data:`KINDS` of a mixture; ``None``: flocks said it.
        passed: ``(M,)`` which heads passed their gate.
        left: ``(n,)`` who flies like nobody else, is no head and unlike a follower of any; of what flocks say.
        by_phases: flocks said it by the phases of their flights.
    """

    heads: Indices
    leader: Indices
    probability: Floats
    given: Floats
    gain: Floats
    explained: Floats
    reasons: list[str] = field(default_factory=list)
    strategy: dict[str, Any] = field(default_factory=dict)
    value: float = 0.0
    kind: Indices | None = None
    passed: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))
    left: NDArray[np.bool_] | None = None
    by_phases: bool = False

    def __post_init__(self) -> None:
        if len(self.passed) != len(self.heads):  # how far a posterior is believed rests on it
            raise ValueError("passed must say of every head whether it passed.")
