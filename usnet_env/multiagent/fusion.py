"""Rules that combine the votes of K observers into one set of candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from usnet_env.arrays import Floats, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.parts import Registry


@dataclass(frozen=True)
class Fusion:
    """A rule that combines votes into candidates.

    Args:
        vote: the form of a vote: ``"candidates"``, 0 or 1 for each UAV, or ``"scores"``, a number from 0 to 1 for each.
        rule: ``(votes (K, N) float64, seen (K, N) bool) -> candidates (N,) bool``. ``seen`` marks the living UAVs that
            each observer saw; its votes for all other UAVs have already been set to 0.
        description: one line for lists and documentation.
    """

    vote: Literal["candidates", "scores"]
    rule: Callable[[Floats, Mask], Mask]
    description: str = ""


def _combine_any(votes: Floats, _seen: Mask) -> Mask:
    return np.asarray((votes > 0.5).any(axis=0))


def _combine_majority(votes: Floats, seen: Mask) -> Mask:
    return np.asarray(votes.sum(axis=0) > 0.5 * seen.sum(axis=0))


def _check_fusion(rule: Any, subject: str = "rule") -> Fusion:
    if not isinstance(rule, Fusion) or rule.vote not in ("candidates", "scores") or not callable(rule.rule):
        raise ArgumentError(f"{subject} must be a Fusion with a vote of 'candidates' or 'scores', got {quote(rule)}.")
    return rule


_OWN = {
    "union": Fusion("candidates", _combine_any, "UAVs that at least one observer names"),
    "majority": Fusion("candidates", _combine_majority, "UAVs that more than half of the observers that saw them name"),
    "scores": Fusion("scores", _combine_majority, "UAVs whose mean score over the observers that saw them exceeds 0.5"),
}

#: All fusion rules by name.
FUSIONS = Registry("fusion rule", "fusion", "usnet.fusions", __name__, _check_fusion, _OWN)


def fusions() -> Mapping[str, Fusion]:
    """Return all fusion rules by name, as a read-only view."""
    return FUSIONS


def register_fusion(name: str, rule: Fusion, *, replace: bool = False) -> None:
    """Register a fusion rule, so that ``fusion=name`` selects it.

    Args:
        name: a non-empty name that no other rule has.
        rule: the rule.
        replace: replace another rule of this name, for example to run a notebook cell again. The rules of this package
            can't be replaced.

    Raises:
        ArgumentError: another rule has this name, the name is empty, or the rule is not a :class:`Fusion`.
    """
    FUSIONS.register(name, rule, replace=replace)
