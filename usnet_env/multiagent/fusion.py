"""From the votes of K observers to one set of candidates: the named rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote, unknown_name

__all__ = ["Fusion", "fusion", "fusions", "register_fusion"]

Votes = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Fusion:
    """A rule that turns votes into candidates.

    Args:
        vote: what an observer sends: ``"candidates"``, a 0 or 1 a UAV, or ``"scores"``, a number from 0 to 1 a UAV.
        rule: ``(votes (K, N), seen (K, N)) -> candidates (N,)`` bool. ``seen`` says which living UAVs each observer
            saw; a vote for another is 0 already.
        description: one line for lists and pages.
    """

    vote: Literal["candidates", "scores"]
    rule: Callable[[Votes, Mask], Mask]
    description: str = ""


def _union(votes: Votes, _seen: Mask) -> Mask:
    return np.asarray((votes > 0.5).any(axis=0))


def _more_than_half(votes: Votes, seen: Mask) -> Mask:
    return np.asarray(votes.sum(axis=0) > 0.5 * seen.sum(axis=0))


_FUSIONS: dict[str, Fusion] = {
    "union": Fusion("candidates", _union, "whoever one observer names"),
    "majority": Fusion("candidates", _more_than_half, "whoever more than half of those who saw it name"),
    "scores": Fusion("scores", _more_than_half, "whose summed scores exceed half of what those who saw it could give"),
}


def fusions() -> Mapping[str, Fusion]:
    """All fusion rules by name (a read-only view)."""
    return MappingProxyType(_FUSIONS)


def fusion(name: str) -> Fusion:
    """The fusion rule registered under ``name``.

    Raises:
        ArgumentError: no such name.
    """
    if name not in _FUSIONS:
        raise unknown_name("fusion", name, _FUSIONS)
    return _FUSIONS[name]


def register_fusion(name: str, rule: Fusion) -> None:
    """Make a fusion rule of one's own available as ``fusion=name``.

    Raises:
        ArgumentError: the name is taken or not a name, or the rule is not a :class:`Fusion`.
    """
    if not isinstance(name, str) or not name.strip():
        raise ArgumentError(f"name must be a non-empty name, got {quote(name)}.")
    if not isinstance(rule, Fusion) or rule.vote not in ("candidates", "scores") or not callable(rule.rule):
        raise ArgumentError(f"rule must be a Fusion with a vote of 'candidates' or 'scores', got {quote(rule)}.")
    if name in _FUSIONS and _FUSIONS[name] != rule:
        raise ArgumentError(f"name must be a new one, got {name!r}, which is registered already.")
    _FUSIONS[name] = rule
