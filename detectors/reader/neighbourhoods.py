"""Cuts a large swarm into neighbourhoods: sets of UAVs that move alike, each small enough to be read as one window.

Two UAVs are alike if the turns of one resemble those of the other, at the same time or some steps later. Links between
the most alike are merged, the strongest first, into communities. Heads may move like none of their followers, or have
more followers than a neighbourhood holds. So each community is joined by the UAVs whose past explains its turns best.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from usnet_env.arrays import Floats, Indices, Mask, Singles

SIZE = 82  # UAVs of a neighbourhood; the network has learned from swarms of this size
_MERGED = 60  # of them that are merged; the others join
_LINKS = 12  # of each UAV
_STRONG = 2.3  # weight of a link that isn't due to chance
_JOINING = 2  # UAVs that join a community because they explain most, and because they turn first
_FEW = 2000  # UAVs of which each may join; of more, those without a community and those of divided ones
_RIVALS = 100  # UAVs that may come first, of each community
_LAST_LAG = 12  # steps
_CALLED, _BESIDE, _CALLED_AT_ONCE = (
    12,
    100,
    50,
)  # followers of a doubtful head, probable heads, and doubtful ones with followers
_WORK = 3e10  # products in a comparison of all pairs; in a larger swarm, steps are averaged before
_CHUNK = 512  # UAVs whose pairs are compared at once


def cut_swarm(velocity: Singles, seen: Mask) -> list[tuple[Indices, Mask]]:
    """Cut a swarm with ``velocity`` ``(T, n, 3)``, valid where ``seen`` ``(T, n)``, into neighbourhoods.

    Of each neighbourhood: its UAVs ``(m,)``, and whose own one it is ``(m,)``; each UAV has one, and is in others if it
    may lead UAVs there. Time grows with n², memory with n.
    """
    uavs = seen.shape[1]
    links, weight = link_alike(velocity, seen)
    strong = weight > _STRONG
    community = _merge_links(links[strong], weight[strong], uavs)
    piece = _merge_links(links, weight, uavs)
    size = np.bincount(community, minlength=uavs)
    ends = community[links[strong]]
    divided = np.isin(community, ends[ends[:, 0] != ends[:, 1]])
    alone = size[community] < 3
    possible = np.flatnonzero(alone | divided | (uavs <= _FEW))
    guests: dict[int, set[int]] = {}
    for uav, group in _find_guests(velocity, seen, community, np.flatnonzero(size > 2), possible):
        if alone[uav]:
            piece[uav] = piece[group]
        guests.setdefault(int(piece[group]), set()).add(uav)
    return _pack_pieces(piece, guests)


def gather_doubtful(probability: Floats, root: Indices) -> list[tuple[Indices, Mask]]:
    """Sets of UAVs that may be heads, with some of their followers, and beside them those that probably are heads.

    ``probability`` ``(N,)`` is that of being a head, ``root`` ``(N,)`` the head that was found. A neighbourhood whose
    head is in another one may take a follower for its head; beside the true head it doesn't. Sets are as those of
    :func:`cut_swarm`, with the doubtful ones and their followers as the core.
    """
    doubtful = np.flatnonzero((probability > 1 / len(root)) & (probability < 1 - 1 / len(root)))
    heads = np.flatnonzero(probability > 0.5)
    groups = [
        np.append(uav, np.flatnonzero((root == uav) & (np.arange(len(root)) != uav))[:_CALLED]) for uav in doubtful
    ]
    sets = list[tuple[Indices, Mask]]()
    for beside in np.array_split(heads, -(-len(heads) // _BESIDE) or 1):
        core = np.empty(0, np.int64)
        for last, group in enumerate(groups, start=1):
            core = np.union1d(core, group)
            if len(core) >= _CALLED_AT_ONCE or last == len(groups):
                uavs = np.union1d(core, beside)
                sets.append((uavs, np.isin(uavs, core)))
                core = core[:0]
    return sets


def find_turns(series: Singles, seen: Mask, block: int = 1) -> Singles:
    """What a UAV's last two values don't explain, in means over ``block`` steps, ``(n, T // block, d)``.

    ``series`` ``(T, n, d)`` counts where ``seen`` ``(T, n)``. The squares of each UAV sum to 1, or to 0 if it never
    turns; single large turns are bounded.
    """
    count, (uavs, width) = len(seen) // block, series.shape[1:]
    there = seen[: count * block].reshape(count, block, uavs, 1)
    some = np.minimum(there.sum(axis=1), 1).astype(np.float32)
    mean = (series[: count * block].reshape(count, block, uavs, width) * there).sum(axis=1) / there.sum(axis=1).clip(1)
    mean = (mean - (mean * some).sum(axis=0) / some.sum(axis=0).clip(1)) * some
    known = np.zeros_like(some)
    known[2:] = some[2:] * some[1:-1] * some[:-2]
    past = np.zeros((2, *mean.shape), np.float32)
    past[0, 1:], past[1, 2:] = mean[:-1], mean[:-2]
    gram = np.einsum("atnd,btnd->nab", past * known, past)
    gram += (1e-2 * np.trace(gram, axis1=1, axis2=2) + 1e-12)[:, None, None] * np.eye(2)
    law = np.linalg.solve(gram, np.einsum("atnd,tnd->na", past, mean * known)[..., None])[..., 0]
    turn = (mean - np.einsum("na,atnd->tnd", law, past)) * known
    length = np.linalg.norm(turn, axis=2, keepdims=True)
    usual = np.sqrt((length**2).sum(axis=0) / known.sum(axis=0).clip(1))
    turn *= np.minimum(1.0, 3.0 * usual / length.clip(1e-12))
    turn /= np.sqrt((turn**2).sum(axis=(0, 2), keepdims=True)).clip(1e-9)
    return np.ascontiguousarray(turn.transpose(1, 0, 2), np.float32)


def link_alike(velocity: Singles, seen: Mask) -> tuple[Indices, Floats]:
    """Link each UAV to those that are most alike: ``(e, 2)`` pairs, ``(e,)`` weights.

    The weight is the largest correlation of the turns at any lag, in units of what chance reaches among all pairs,
    times the square root of the number of neighbours that the two share.
    """
    steps, uavs = seen.shape
    lags, block = min(_LAST_LAG, steps // 3), 1
    while uavs**2 * 3 * (steps // block) * (lags // block + 1) > _WORK:
        block += 1
    turns = find_turns(velocity, seen, block).reshape(uavs, -1)
    width = turns.shape[1]
    shifts = [3 * lag for lag in range(1, lags // block + 1)]
    most = min(_LINKS, uavs - 1)
    nearest, likeness = np.empty((uavs, most), np.int64), np.empty((uavs, most), np.float32)
    for first in range(0, uavs, _CHUNK):
        rows = turns[first : first + _CHUNK]
        alike = rows @ turns.T
        for shift in shifts:
            np.maximum(alike, rows[:, shift:] @ turns[:, : width - shift].T, out=alike)
            np.maximum(alike, rows[:, : width - shift] @ turns[:, shift:].T, out=alike)
        alike[np.arange(len(rows)), np.arange(first, first + len(rows))] = -1.0
        best = np.argpartition(alike, uavs - most, axis=1)[:, uavs - most :]
        nearest[first : first + _CHUNK] = best
        likeness[first : first + _CHUNK] = np.take_along_axis(alike, best, axis=1)
    row, column = np.repeat(np.arange(uavs), most), nearest.ravel()
    ones = np.ones(uavs * (most + 1))
    near = csr_array((ones, (np.append(row, np.arange(uavs)), np.append(column, np.arange(uavs)))), (uavs, uavs))
    shared = np.asarray((near @ near.T)[row, column]).ravel()
    chance = np.sqrt(2.0 * np.log(uavs * (2 * len(shifts) + 1)) / width)
    fade = np.minimum(likeness.ravel() / np.maximum(likeness.min(axis=1)[column], 1e-9), 1.0)
    return np.stack([row, column], axis=1), likeness.ravel() / chance * np.sqrt(shared) * np.sign(fade) * fade**2


def _merge_links(links: Indices, weight: Floats, uavs: int) -> Indices:
    """Merge linked UAVs, the strongest links first, to sets of at most ``_MERGED``; labels ``(n,)`` are indices."""
    parent, size = list(range(uavs)), [1] * uavs

    def find(uav: int) -> int:
        while parent[uav] != uav:
            parent[uav] = uav = parent[parent[uav]]
        return uav

    for one, other in links[np.argsort(-weight, kind="stable")].tolist():
        one, other = find(one), find(other)
        if one != other and size[one] + size[other] <= _MERGED:
            parent[other] = one
            size[one] += size[other]
    return np.array([find(uav) for uav in range(uavs)])


def _find_guests(
    velocity: Singles, seen: Mask, community: Indices, groups: Indices, possible: Indices
) -> list[tuple[int, int]]:
    """Pairs of a possible head and a community that it may lead, those that explain least first."""
    if not (len(groups) and len(possible) and len(seen) > 3):
        return []
    turns = find_turns(velocity, seen)
    target = np.stack([turns[community == group].mean(axis=0) for group in groups])
    turns = turns[possible]
    share = _explain_turns(velocity[:, possible], seen[:, possible], turns, target)
    share[community[possible][:, None] == groups] = -1.0
    pairs = [(uav, group) for group in range(len(groups)) for uav in _choose_first(share[:, group], turns)]
    pairs.sort(key=lambda pair: share[pair])
    return [(int(possible[uav]), int(groups[group])) for uav, group in pairs]


def _explain_turns(velocity: Singles, seen: Mask, turns: Singles, target: Singles) -> Floats:
    """Share of the turns ``target`` ``(g, T, 3)`` that each UAV's past explains best at one lag, ``(p, g)``.

    The past are turns ``(p, T, 3)``, and turns of the products of velocities, by any linear map. What ``target``
    explains of the UAV some steps later is taken off.
    """
    steps = len(seen)
    target = target / np.maximum(np.sqrt((target**2).sum(axis=(1, 2))), 1e-9)[:, None, None]
    products = np.stack([velocity[..., a] * velocity[..., b] for a in range(3) for b in range(a, 3)], axis=-1)
    past = np.concatenate([turns, find_turns(products, seen)], axis=2)  # (p, T, 9)
    gram = past.transpose(0, 2, 1) @ past
    gram += (1e-2 * np.trace(gram, axis1=1, axis2=2) / 9 + 1e-9)[:, None, None] * np.eye(9, dtype=np.float32)
    white = np.linalg.solve(np.linalg.cholesky(gram), past.transpose(0, 2, 1)).astype(np.float32)  # (p, 9, T)
    share, reverse = np.zeros((2, len(turns), len(target)))
    for lag in range(1, min(_LAST_LAG, steps // 3) + 1):
        later = target[:, lag:].transpose(1, 0, 2).reshape(steps - lag, -1)
        sooner = target[:, :-lag].transpose(1, 0, 2).reshape(steps - lag, -1)
        for first in range(0, len(turns), _CHUNK):
            at = slice(first, first + _CHUNK)
            np.maximum(share[at], _squares(white[at, :, :-lag], later), out=share[at])
            np.maximum(reverse[at], _squares(white[at, :3, lag:], sooner), out=reverse[at])
    return share - reverse


def _squares(white: Singles, target: Singles) -> Singles:
    """Sums of squared products ``(p, g)`` of series ``(p, d, t)`` and ``(t, 3 g)``."""
    product = (white.reshape(-1, white.shape[2]) @ target).reshape(*white.shape[:2], -1)
    return np.asarray(np.einsum("pdx,pdx->px", product, product).reshape(len(white), -1, 3).sum(axis=2))


def _choose_first(share: Floats, turns: Singles) -> Indices:
    """The UAVs with the largest shares, and of those with half of it the ones whose turns ``(p, T, 3)`` come first."""
    best = np.argsort(-share, kind="stable")[:_RIVALS]
    good = best[share[best] >= 0.5 * abs(share[best[0]])]
    some = turns[good].reshape(len(good), 3 * turns.shape[1])
    ahead = np.zeros((len(good), len(good)), np.float32)
    for shift in range(3, 3 * min(_LAST_LAG, turns.shape[1] // 3) + 1, 3):
        np.maximum(ahead, some[:, :-shift] @ some[:, shift:].T, out=ahead)  # of i before j
    first = np.argsort((ahead.T - ahead).sum(axis=1), kind="stable")
    return np.union1d(best[:_JOINING], good[first[:_JOINING]])


def _pack_pieces(piece: Indices, guests: dict[int, set[int]]) -> list[tuple[Indices, Mask]]:
    """Fill neighbourhoods with whole pieces and their guests, the largest first."""
    sets = [(set(np.flatnonzero(piece == label).tolist()), guests.get(label, set())) for label in np.unique(piece)]
    bins: list[tuple[set[int], set[int]]] = []
    for own, more in sorted(sets, key=lambda each: -len(each[0] | each[1])):
        for all_own, everyone in bins:
            if len(everyone | own | more) <= SIZE:
                all_own |= own
                everyone |= own | more
                break
        else:
            bins.append((set(own), own | more))
    members = [np.array(sorted(everyone)) for _, everyone in bins]
    return [(uavs, np.isin(uavs, list(own))) for uavs, (own, _) in zip(members, bins, strict=True)]
