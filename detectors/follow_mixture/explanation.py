"""The result of a fit, independent of the method: heads, leaders, probabilities, and the evidence for each head."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "Explanation"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Category of a UAV in a mixture fit: a head that passed or failed its test, a follower, or unassigned. An unassigned
#: UAV is "alone" (a decoy) if the strategy leaves only noise as residual. Otherwise it is "stray" if few UAVs are
#: unassigned and it can't have followers, and "missing" (possibly a head) if not.
KINDS = ("passed", "failed", "follower", "stray", "missing", "alone")


@dataclass(frozen=True, eq=False)
class Explanation:
    """The result of a fit for n UAVs.

    Args:
        heads: ``(M,)`` indices of the heads, ascending.
        leader: ``(n,)`` the head of each UAV, -1 for none (heads included).
        probability: ``(n,)`` the probability of being a head from a flock fit, before calibration; unused if ``kind``
            is given.
        given: ``(n,)`` the same, conditional on the presence of a head, as in an episode that is not over.
        gain: ``(n,)`` the log-likelihood that each follower gains by its head.
        explained: ``(n,)`` the share of each follower's innovation that its head explains.
        reasons: one sentence per head: why it passed or failed its test.
        strategy: a readable description of the fitted strategy.
        value: the penalised log-likelihood gain over the hypothesis that no UAV follows another one, in nats.
        kind: ``(n,)`` indices in :data:`KINDS` for a mixture fit; ``None`` for a flock fit.
        passed: ``(M,)`` which heads passed their test.
        left: ``(n,)`` which UAVs fit into no flock and to no head; for a flock fit.
        by_phases: whether the flock fit used cross-spectral phases.
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
        if len(self.passed) != len(self.heads):  # the calibration depends on it
            raise ValueError("passed must say of every head whether it passed.")
