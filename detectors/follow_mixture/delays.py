"""Followers that each have a delay of their own, and relays, which follow one UAV and lead others.

Followers with different delays move alike, but not at the same time, so that they form no group. Those with short
delays predict those with long ones, as relays predict their followers. Both are told from heads by the UAVs that they
follow themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.follow_mixture.evidence import RARE, Pairs, Targets, make_targets, pair, screen
from detectors.follow_mixture.motion import lagged
from detectors.series.designs import sum_groups
from detectors.series.features import LEVELS
from detectors.series.votes import find_trees
from usnet_env.arrays import Floats, Indices

_RELAY = 1 / 3  # least share of a UAV's innovations that its leader explains
ASKED = 200  # most single UAVs that are asked; bounds time and memory


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The direct leader and the root of each of n UAVs."""

    leader: Indices  #: ``(n,)`` the UAV that each follows directly, -1 for none
    root: Indices  #: ``(n,)`` the UAV at the end of its leaders, its own index if it follows none
    gain: Floats  #: ``(n,)`` evidence that it follows its leader, in nats
    relays: Floats  #: ``(2, n)`` log-odds: a leading UAV follows another, such a UAV follows it; -inf: not asked


def compare_delays(velocity: Floats, past: Floats, longest: int) -> tuple[Floats, Floats]:
    """Compare all ordered pairs of k tracks: track i follows track j with a law of its own.

    The law has the last L velocities, or a single one of up to ``longest`` steps ago. Two UAVs that turn alike by
    chance predict each other alike. So the evidence counts only as far as it exceeds that of the reverse, and that of a
    leader that explains little.

    ``velocity`` is ``(k, T, a)``, ``past`` ``(k, L, a, T - L)``; ``longest`` is the longest delay in samples, a quarter
    of the steps at most.

    Returns:
        ``(k, k)`` log-odds that i follows j, -inf on the diagonal; ``(k, k)`` the evidence.
    """
    count, lags, every = len(velocity), past.shape[1], np.arange(len(velocity))
    longest = max(lags, min(longest, velocity.shape[1] // 4))

    def ask(candidates: Floats, lags: int, classes: tuple[str, ...]) -> Floats:
        alone = make_targets(velocity, every, lags, _RELAY)
        return np.asarray(screen(alone, candidates, classes, every).max(axis=0))

    evidence = ask(past, lags, LEVELS[0])
    if longest > lags:
        late = lagged(velocity, longest)[:, lags:]  # (k, D, a, R)
        each = ask(late.reshape(-1, 1, *late.shape[2:]), longest, LEVELS[0][:1])
        evidence = np.maximum(evidence, each.reshape(count, count, longest - lags).max(axis=2))
    laws = len(LEVELS[0]) + longest - lags
    price = np.log(1.0 / RARE - 1.0) + np.log(max(count - 1, 1) * laws)
    odds = evidence - np.maximum(evidence.T, 0.0) - price
    np.fill_diagonal(odds, -np.inf)
    return odds, evidence


def sample_single_uavs(targets: Targets) -> Indices:
    """The groups of one UAV; in a large swarm a part of them, which bounds time and memory."""
    single = np.flatnonzero(targets.sizes == 1)
    return single[:: max(-(-len(single) // ASKED), 1)]


def ask_delays(
    targets: Targets, velocity: Floats, past: Floats, leads: Indices, gain: Floats, longest: int
) -> tuple[Pairs, Floats]:
    """Pairs of a group and a UAV that it follows with a delay of its own, and the log-odds of each.

    ``leads`` are the UAVs that lead; of the others, only single ones can be followed. ``gain`` ``(C,)`` is what each
    group gains already; the log-odds are higher. See also :func:`compare_delays`.
    """
    groups = len(targets.sizes)
    asked = np.isin(targets.label, np.append(sample_single_uavs(targets), np.flatnonzero(targets.sizes > 1)))
    asked[leads] = True
    uavs = np.flatnonzero(asked)
    part = targets.label.copy()
    part[leads] += groups * (targets.sizes[part[leads]] > 1) * (1 + np.arange(len(leads)))  # apart from their groups
    names, first, node = np.unique(part[uavs], return_index=True, return_inverse=True)
    size = np.bincount(node)
    mean = sum_groups(velocity[uavs], node) / size[:, None, None]
    before = sum_groups(past[uavs], node) / size[:, None, None, None]
    odds, _ = compare_delays(mean, before, longest)
    row, column = np.nonzero((odds > 0) & (names < groups)[:, None] & (size == 1))
    group, uav = names[row], uavs[first[column]]
    better = (targets.label[uav] != group) & (odds[row, column] > gain[group])
    return pair(group[better], uav[better]), odds[row, column][better]


def find_hierarchy(
    targets: Targets, velocity: Floats, past: Floats, leads: Indices, head: Indices, gained: Floats, longest: int
) -> Hierarchy:
    """Find the direct leaders of the UAVs that lead, ``leads``, and of single UAVs.

    ``head`` ``(C,)`` is the UAV that each group was assigned to, -1 for none, and ``gained`` ``(C,)`` the evidence for
    this. See also :func:`compare_delays`.
    """
    single = np.flatnonzero(np.isin(targets.label, sample_single_uavs(targets)))
    leader, gain = head[targets.label], gained[targets.label]
    asked = np.union1d(leads, single)
    odds, evidence = compare_delays(velocity[asked], past[asked], longest)
    led = np.flatnonzero(np.isin(asked, single) & (leader[asked] >= 0))
    place = np.searchsorted(asked, leader[asked[led]])
    for values in (odds, evidence):
        values[led, place] = np.maximum(values[led, place], gain[asked[led]])
    direct, top = find_trees(odds, evidence, 0.0)
    below, itself = direct >= 0, np.arange(len(asked))
    leading = np.isin(asked, leads)
    for _ in range(len(asked)):
        leading[direct[leading & below]] = True
    may = below[:, None] | (top != itself[:, None])  # no UAV follows one that follows it
    follows = np.where(may, odds, -np.inf).max(axis=1, initial=-np.inf)

    relays = np.full((2, len(leader)), -np.inf)
    leader[asked[np.isin(asked, [*single, *leader]) | np.isin(itself, direct)]] = -1  # also of heads in a group
    leader[asked[below]], gain[asked[below]] = asked[direct[below]], evidence[below, direct[below]]
    relays[0, asked[leading]] = follows[leading]
    np.maximum.at(relays[1], asked[direct[leading & below]], follows[leading & below])
    root = np.where(leader >= 0, leader, np.arange(len(leader)))
    for _ in range(len(asked).bit_length() + 1):
        root = root[root]
    return Hierarchy(leader, root, gain, relays)
