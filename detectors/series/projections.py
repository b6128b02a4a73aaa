"""Projections of many targets on the features of many UAVs: compiled loops over small matrices.

Features are ``(k, p, R)``: p rows of R samples for each of k UAVs. The explained energy m' G^-1 m, where G are products
of features with each other and m those with a target, is the squared length of L^-1 m with G = L L' (Cholesky).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

import numpy as np

from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.compiling import compiled

RIDGE = 1e-6  # of the mean square of a feature
NOTHING = 1e-12


def orthonormalise(features: Floats) -> Floats:
    """Orthonormal rows of the span of each ``(p, R)`` block, up to a small ridge."""
    gram = features @ features.transpose(0, 2, 1)
    _invert_roots(gram)
    return np.asarray(gram @ features)


def project(features: Floats, columns: dict[str, Indices], target: Singles) -> Iterator[tuple[str, Singles]]:
    """Yield each class, and the products ``(k, p, ..., C)`` of its features, made orthonormal, and targets.

    Features are ``(k, q, R)``, their indices by class ``columns``, and targets ``(R, ..., C)``.
    """
    if not columns:
        return
    features = features[:, : 1 + max(int(used.max()) for used in columns.values())]
    gram, product = features @ features.transpose(0, 2, 1), _multiply(features, target)
    for name, used in columns.items():
        root = gram[:, used[:, None], used]
        some = product if len(used) == product.shape[1] else product[:, used]
        _invert_roots(root)
        flat = some.reshape(*some.shape[:2], prod(some.shape[2:]))
        yield name, (root.astype(np.float32) @ flat).reshape(some.shape)


def explain_exactly(features: Floats, target: Singles, weight: Singles) -> Floats:
    """``(C, k)``: energy that few features ``(k, p, R)`` explain beyond the own pasts.

    ``target`` ``(R, a + z, C)`` are the innovations and the own pasts, times the weights of their rows; ``weight``
    ``(R, C)`` are the squares of these weights.
    """
    axes = features.shape[1]
    row, column = np.tril_indices(axes)
    singles = features.astype(np.float32)
    gram = _multiply(singles[:, row] * singles[:, column], weight)
    return np.asarray(_solve(_multiply(singles, target), gram, axes).T)


def _multiply(features: Floats | Singles, target: Singles) -> Singles:
    """``(k, p, ..., C)``: products, summed over the rows, of features ``(k, p, R)`` and targets ``(R, ..., C)``."""
    flat = features.astype(np.float32, copy=False).reshape(-1, features.shape[2])
    product = flat @ target.reshape(len(target), -1)
    return product.reshape(*features.shape[:2], *target.shape[1:])


@compiled()
def factor(matrix: Floats, added: float) -> None:
    """Replace the lower triangle of a matrix ``(p, p)``, after a ridge was added, by its Cholesky factor."""
    for p in range(len(matrix)):
        matrix[p, p] += added
        for q in range(p + 1):
            value = matrix[p, q]
            for r in range(q):
                value -= matrix[p, r] * matrix[q, r]
            matrix[p, q] = value / matrix[q, q] if q < p else np.sqrt(max(value, added, NOTHING))


@compiled()
def _invert_roots(gram: Floats) -> None:
    """Replace each of the matrices ``(k, p, p)`` by the inverse of its lower Cholesky factor, with a ridge."""
    width = gram.shape[1]
    for matrix in gram:
        factor(matrix, NOTHING + RIDGE * np.trace(matrix) / width)
        for q in range(width):
            for p in range(q):
                matrix[p, q] = 0.0
            for p in range(q, width):
                value = 1.0 if p == q else 0.0
                for r in range(q, p):
                    value -= matrix[p, r] * matrix[r, q]
                matrix[p, q] = value / matrix[p, p]


@compiled()
def solve_lower(lower: Floats, right: Floats) -> None:
    """Replace ``right`` ``(p, m)`` by L^-1 times it, with the factor L ``(p, p)`` in the lower triangle."""
    for p in range(len(lower)):
        for q in range(p):
            for m in range(right.shape[1]):
                right[p, m] -= lower[p, q] * right[q, m]
        for m in range(right.shape[1]):
            right[p, m] /= lower[p, p]


@compiled()
def sum_squares(values: Floats) -> float:
    """The sum of the squares of a matrix."""
    total = 0.0
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            total += values[row, column] ** 2
    return total


@compiled()
def explain_each(gram: Floats, moment: Floats) -> Floats:
    """``(P,)``: m' G^-1 m, summed over the axes, of grams ``(P, p, p)`` and moments ``(P, p, a)``."""
    explained = np.empty(len(gram))
    for pair in range(len(gram)):
        lower, left = gram[pair].copy(), moment[pair].copy()
        factor(lower, 0.0)
        solve_lower(lower, left)
        explained[pair] = sum_squares(left)
    return explained


@compiled()
def multiply_pairs(
    features: Floats, weight: Floats, innovation: Floats, own: Floats, place: Indices, target: Indices
) -> tuple[Floats, Floats, Floats]:
    """Features times targets ``(P, p, a)``, and features ``(P, p, p)`` less what own rows explain; squares ``(P, p)``.

    For P pairs of features ``(k, p, R)`` and weighted targets, ``innovation`` ``(G, a, R)``: ``weight`` ``(G, R)`` is
    that of the rows of each target, ``own`` ``(G, z, R)`` are orthonormal rows, which the features are compared beyond;
    ``place`` and ``target`` ``(P,)`` are indices of features and targets.
    """
    pairs, width = len(place), features.shape[1]
    moment, gram = np.empty((pairs, width, innovation.shape[1])), np.empty((pairs, width, width))
    square = np.empty((pairs, width))
    weighted, known = np.empty(features.shape[1:]), np.empty((width, own.shape[1]))
    for pair in range(pairs):
        row = target[pair]
        for p in range(width):
            for r in range(len(weight[row])):
                weighted[p, r] = features[place[pair], p, r] * weight[row, r]
        np.dot(weighted, innovation[row].T, moment[pair])
        np.dot(weighted, own[row].T, known)
        np.dot(weighted, weighted.T, gram[pair])
        for p in range(width):
            square[pair, p] = gram[pair, p, p]
            for q in range(width):
                for z in range(known.shape[1]):
                    gram[pair, p, q] -= known[p, z] * known[q, z]
    return moment, gram, square


@compiled()
def _solve(product: Singles, gram: Singles, axes: int) -> Floats:
    """``(k, C)``: m' G^-1 m, summed over the axes, with G less what the own past explains, by Cholesky's method.

    ``product`` ``(k, p, a + z, C)``: features times innovations, own pasts; ``gram``: lower triangles ``(k, …, C)``.
    """
    uavs, features, width, count = product.shape
    explained = np.zeros((uavs, count))
    lower, left = np.empty((features, features, count)), np.empty((features, count))
    for k in range(uavs):
        for p in range(features):
            for q in range(p + 1):
                value = lower[p, q]
                for c in range(count):
                    value[c] = gram[k, p * (p + 1) // 2 + q, c]
                for z in range(axes, width):
                    for c in range(count):
                        value[c] -= product[k, p, z, c] * product[k, q, z, c]
                for r in range(q):
                    for c in range(count):
                        value[c] -= lower[p, r, c] * lower[q, r, c]
                for c in range(count):
                    if p > q:
                        value[c] /= lower[q, q, c]
                        continue
                    trace = np.float32(0.0)
                    for i in range(features):
                        trace += gram[k, i * (i + 3) // 2, c]
                    value[c] = np.sqrt(max(value[c], 0.0) + RIDGE * trace / features + NOTHING)
        for axis in range(axes):
            for p in range(features):
                for c in range(count):
                    rest = product[k, p, axis, c]
                    for r in range(p):
                        rest -= lower[p, r, c] * left[r, c]
                    left[p, c] = rest / lower[p, p, c]
                    explained[k, c] += left[p, c] ** 2
    return explained
