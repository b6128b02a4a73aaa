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
_COMMUNITY_SIZE = 60  # of them that are merged; the others join
_LINKS = 12  # of each UAV
_STRONG_WEIGHT = 2.3  # weight of a link that isn't due to chance
_GUESTS = 2  # UAVs that join a community because they explain most, and because they turn first
_ALL_RANKED = 2000  # UAVs of which each may join; of more, those without a community and those of divided ones
_RIVALS = 100  # UAVs that may come first, of each community
_LAST_LAG = 12  # steps
# Followers of a doubtful head, probable heads, and doubtful heads with followers that are read at once.
_MOST_FOLLOWERS, _MOST_HEADS, _MOST_CORE = 12, 100, 50
_MOST_PRODUCTS = 3e10  # products in a comparison of all pairs; in a larger swarm, steps are averaged before
_CHUNK = 512  # UAVs whose pairs are compared at once


def cut_swarm(velocity: Singles, seen: Mask) -> list[tuple[Indices, Mask]]:
    """Cut a swarm with ``velocity`` ``(T, n, 3)``, valid where ``seen`` ``(T, n)``, into neighbourhoods.

    Of each neighbourhood: its UAVs ``(m,)``, and whose own one it is ``(m,)``; each UAV has one, and is in others if it
    may lead UAVs there. Time grows with n², memory with n.
    """
    uavs = seen.shape[1]
    links, weight = link_similar(velocity, seen)
    is_strong = weight > _STRONG_WEIGHT
    community = _merge_links(links[is_strong], weight[is_strong], uavs)
    piece = _merge_links(links, weight, uavs)
    size = np.bincount(community, minlength=uavs)
    ends = community[links[is_strong]]
    is_divided = np.isin(community, ends[ends[:, 0] != ends[:, 1]])
    is_single = size[community] < 3
    candidates = np.flatnonzero(is_single | is_divided | (uavs <= _ALL_RANKED))
    guests: dict[int, set[int]] = {}
    for uav, group in _find_guests(velocity, seen, community, np.flatnonzero(size > 2), candidates):
        if is_single[uav]:
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
    follows = root != np.arange(len(root))
    groups = [np.append(uav, np.flatnonzero((root == uav) & follows)[:_MOST_FOLLOWERS]) for uav in doubtful]
    sets = list[tuple[Indices, Mask]]()
    for some_heads in np.array_split(heads, -(-len(heads) // _MOST_HEADS) or 1):
        core = np.empty(0, np.int64)
        for number, group in enumerate(groups, start=1):
            core = np.union1d(core, group)
            if len(core) >= _MOST_CORE or number == len(groups):
                uavs = np.union1d(core, some_heads)
                sets.append((uavs, np.isin(uavs, core)))
                core = core[:0]
    return sets


def find_turns(series: Singles, seen: Mask, block: int = 1) -> Singles:
    """What a UAV's last two values don't explain, in means over ``block`` steps, ``(n, T // block, d)``.

    ``series`` ``(T, n, d)`` counts where ``seen`` ``(T, n)``. The squares of each UAV sum to 1, or to 0 if it never
    turns; single large turns are bounded.
    """
    count, (uavs, width) = len(seen) // block, series.shape[1:]
    weight = seen[: count * block].reshape(count, block, uavs, 1)
    is_seen = np.minimum(weight.sum(axis=1), 1).astype(np.float32)
    total = (series[: count * block].reshape(count, block, uavs, width) * weight).sum(axis=1)
    mean = total / weight.sum(axis=1).clip(1)
    mean = (mean - (mean * is_seen).sum(axis=0) / is_seen.sum(axis=0).clip(1)) * is_seen
    is_known = np.zeros_like(is_seen)
    is_known[2:] = is_seen[2:] * is_seen[1:-1] * is_seen[:-2]
    past = np.zeros((2, *mean.shape), np.float32)
    past[0, 1:], past[1, 2:] = mean[:-1], mean[:-2]
    gram = np.einsum("atnd,btnd->nab", past * is_known, past)
    gram += (1e-2 * np.trace(gram, axis1=1, axis2=2) + 1e-12)[:, None, None] * np.eye(2)
    coefficients = np.linalg.solve(gram, np.einsum("atnd,tnd->na", past, mean * is_known)[..., None])[..., 0]
    turn = (mean - np.einsum("na,atnd->tnd", coefficients, past)) * is_known
    length = np.linalg.norm(turn, axis=2, keepdims=True)
    rms = np.sqrt((length**2).sum(axis=0) / is_known.sum(axis=0).clip(1))
    turn *= np.minimum(1.0, 3.0 * rms / length.clip(1e-12))
    turn /= np.sqrt((turn**2).sum(axis=(0, 2), keepdims=True)).clip(1e-9)
    return np.ascontiguousarray(turn.transpose(1, 0, 2), np.float32)


def link_similar(velocity: Singles, seen: Mask) -> tuple[Indices, Floats]:
    """Link each UAV to those that are most alike: ``(e, 2)`` pairs, ``(e,)`` weights.

    The weight is the largest correlation of the turns at any lag, in units of what chance reaches among all pairs,
    times the square root of the number of neighbours that the two share.
    """
    steps, uavs = seen.shape
    lags, block = min(_LAST_LAG, steps // 3), 1
    while uavs**2 * 3 * (steps // block) * (lags // block + 1) > _MOST_PRODUCTS:
        block += 1
    turns = find_turns(velocity, seen, block).reshape(uavs, -1)
    width = turns.shape[1]
    shifts = [3 * lag for lag in range(1, lags // block + 1)]
    links = min(_LINKS, uavs - 1)
    nearest, strength = np.empty((uavs, links), np.int64), np.empty((uavs, links), np.float32)
    for first in range(0, uavs, _CHUNK):
        rows = turns[first : first + _CHUNK]
        similarity = rows @ turns.T
        for shift in shifts:
            np.maximum(similarity, rows[:, shift:] @ turns[:, : width - shift].T, out=similarity)
            np.maximum(similarity, rows[:, : width - shift] @ turns[:, shift:].T, out=similarity)
        similarity[np.arange(len(rows)), np.arange(first, first + len(rows))] = -1.0
        columns = np.argpartition(similarity, uavs - links, axis=1)[:, uavs - links :]
        nearest[first : first + _CHUNK] = columns
        strength[first : first + _CHUNK] = np.take_along_axis(similarity, columns, axis=1)
    row, column = np.repeat(np.arange(uavs), links), nearest.ravel()
    ones = np.ones(uavs * (links + 1))
    adjacency = csr_array((ones, (np.append(row, np.arange(uavs)), np.append(column, np.arange(uavs)))), (uavs, uavs))
    shared = np.sqrt(np.asarray((adjacency @ adjacency.T)[row, column]).ravel())
    chance = np.sqrt(2.0 * np.log(uavs * (2 * len(shifts) + 1)) / width)
    fade = np.minimum(strength.ravel() / np.maximum(strength.min(axis=1)[column], 1e-9), 1.0)
    return np.stack([row, column], axis=1), strength.ravel() / chance * shared * np.sign(fade) * fade**2


def _merge_links(links: Indices, weight: Floats, uavs: int) -> Indices:
    """Merge linked UAVs, strongest links first, to sets of at most ``_COMMUNITY_SIZE``; labels ``(n,)`` are indices."""
    parent, size = list(range(uavs)), [1] * uavs

    def find(uav: int) -> int:
        while parent[uav] != uav:
            parent[uav] = uav = parent[parent[uav]]
        return uav

    links = links[np.argsort(-weight, kind="stable")]
    _, strongest = np.unique(np.sort(links, axis=1) @ (uavs, 1), return_index=True)  # a pair has up to two links
    for first, second in links[np.sort(strongest)].tolist():
        first, second = find(first), find(second)
        if first != second and size[first] + size[second] <= _COMMUNITY_SIZE:
            parent[second] = first
            size[first] += size[second]
    return np.array([find(uav) for uav in range(uavs)])


def _find_guests(
    velocity: Singles, seen: Mask, community: Indices, groups: Indices, candidates: Indices
) -> list[tuple[int, int]]:
    """Pairs of a possible head and a community that it may lead, those that explain least first."""
    if not (len(groups) and len(candidates) and len(seen) > 3):
        return []
    turns = find_turns(velocity, seen)
    target = np.stack([turns[community == group].mean(axis=0) for group in groups])
    turns = turns[candidates]
    share = _explain_turns(velocity[:, candidates], seen[:, candidates], turns, target)
    share[community[candidates][:, None] == groups] = -1.0
    pairs = [(uav, group) for group in range(len(groups)) for uav in _choose_first(share[:, group], turns)]
    pairs.sort(key=lambda pair: share[pair])
    return [(int(candidates[uav]), int(groups[group])) for uav, group in pairs]


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
        later = target[:, lag:].transpose(1, 2, 0).reshape(steps - lag, -1)
        earlier = target[:, :-lag].transpose(1, 2, 0).reshape(steps - lag, -1)
        for first in range(0, len(turns), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            np.maximum(share[chunk], _sum_squares(white[chunk, :, :-lag], later), out=share[chunk])
            np.maximum(reverse[chunk], _sum_squares(white[chunk, :3, lag:], earlier), out=reverse[chunk])
    return share - reverse


def _sum_squares(white: Singles, target: Singles) -> Singles:
    """Sums of squared products ``(p, g)`` of series ``(p, d, t)`` and ``(t, 3 g)``."""
    product = white.reshape(-1, white.shape[2]) @ target
    np.square(product, out=product)
    return np.asarray(product.reshape(len(white), -1, target.shape[1] // 3).sum(axis=1))


def _choose_first(share: Floats, turns: Singles) -> Indices:
    """The UAVs with the largest shares, and of those with half of it the ones whose turns ``(p, T, 3)`` come first."""
    best = np.argsort(-share, kind="stable")[:_RIVALS]
    rivals = best[share[best] >= 0.5 * abs(share[best[0]])]
    rival_turns = turns[rivals].reshape(len(rivals), 3 * turns.shape[1])
    precedence = np.zeros((len(rivals), len(rivals)), np.float32)
    for shift in range(3, 3 * min(_LAST_LAG, turns.shape[1] // 3) + 1, 3):
        np.maximum(precedence, rival_turns[:, :-shift] @ rival_turns[:, shift:].T, out=precedence)  # of i before j
    first = np.argsort((precedence.T - precedence).sum(axis=1), kind="stable")
    return np.union1d(best[:_GUESTS], rivals[first[:_GUESTS]])


def _pack_pieces(piece: Indices, guests: dict[int, set[int]]) -> list[tuple[Indices, Mask]]:
    """Fill neighbourhoods with whole pieces and their guests, the largest first."""
    pieces = [(set(np.flatnonzero(piece == label).tolist()), guests.get(label, set())) for label in np.unique(piece)]
    bins: list[tuple[set[int], set[int]]] = []
    for piece_uavs, guest_uavs in sorted(pieces, key=lambda each: -len(each[0] | each[1])):
        for core, members in bins:
            if len(members | piece_uavs | guest_uavs) <= SIZE:
                core |= piece_uavs
                members |= piece_uavs | guest_uavs
                break
        else:
            bins.append((set(piece_uavs), piece_uavs | guest_uavs))
    return [(uavs := np.array(sorted(members)), np.isin(uavs, list(core))) for core, members in bins]
