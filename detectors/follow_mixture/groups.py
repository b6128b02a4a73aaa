"""Groups of UAVs that move simultaneously, such as the followers of one head.

The velocity of a UAV is a signal that its group shares, plus its own jitter and observation noise. In Fourier
coordinates all three are independent between frequencies. Differences of noisy positions have noise with the spectrum
2 sigma² (1 - cos w), which is small at low frequencies. With the shared signal integrated out, a group of m UAVs with
summed coordinates S, each with noise N and signal power P times N, has the log-likelihood

    sum over frequencies and axes of  1/2 |S|² P / (1 + m P) - 1/2 log(1 + m P)

relative to independent members, with S in units of the square root of N. Groups merge as long as a merger gains more
than log n, the description length of one of n partners; so no other rule for their number is needed. A UAV that moves
like no other UAV at the same time stays single: a head, whose followers copy it later, or a decoy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.follow_mixture.motion import FlightSpectra
from detectors.series.designs import sum_groups
from usnet_env.arrays import Floats, Indices
from usnet_env.compiling import compiled

_JITTERS = (0.01, 0.03, 0.1, 0.3, 0.6)  # share of the power that is a UAV's own jitter
_ORDERED_BY = 3  # the share that orders the mergers: the largest, by which most groups merge
_GRAIN = 1e-3  # motion below this share of the mean speed is rounding of the positions
_BANDS = 8  # of frequencies; the spectra count as constant within one
_AT_ONCE = 300  # UAVs that are compared pair by pair; a larger swarm is grouped in turns
_DRAWN = 2  # members of each group that are compared with the other groups of a larger swarm


@dataclass(frozen=True, eq=False)
class _Bands:
    """Spectra in F bands of frequency, for one share of jitter."""

    noise: Floats  #: ``(F,)`` power of jitter and observation noise in each band
    ratio: Floats  #: ``(F,)`` P, the power of the shared signal relative to it
    count: Floats  #: ``(F,)`` number of real coordinates in each band, over all axes

    def worth(self, energy: Floats, size: Floats) -> Floats:
        """Log-likelihood of groups with energies |S|² ``(F, ...)`` and ``(...)`` members, over independent UAVs."""
        more = (1,) * np.ndim(size)
        ratio, noise, count = (some.reshape(*some.shape, *more) for some in (self.ratio, self.noise, self.count))
        spread = 1.0 + size * ratio
        return np.asarray((0.5 * energy * ratio / (spread * noise) - 0.5 * count * np.log(spread)).sum(axis=0))


def find_groups(velocity: Floats, spectra: FlightSpectra, rng: np.random.Generator) -> Indices:
    """Find the groups of a window.

    Swarms of more than 300 UAVs are grouped in turns: random UAVs that are not compared yet form groups, and every
    other UAV that is not compared yet joins the group that gains most by it, if one gains.

    The result for ``velocity`` ``(n, T, a)`` are ``(n,)`` labels from 0, in the order of the groups' first members.
    """
    power = float(np.median(spectra.power))
    still = np.zeros(len(velocity), bool)
    if spectra.noise == 0:  # a strategy may answer one head's turns more than another's; jitter is a share of it
        about = (velocity - velocity.mean(axis=1, keepdims=True)).reshape(len(velocity), -1)
        own = np.vecdot(about, about) / about.shape[1]
        still = own <= _GRAIN**2  # flies straight: moves like every other UAV that does, or like none
        velocity = velocity * np.sqrt(power / np.where(still, 1.0, own))[:, None, None]
    coordinates, band, count, wave, flight = _spectral_bands(velocity, spectra)
    models = [
        _Bands(noise := spectra.noise * wave + share * power, (1.0 - share) * flight / noise, count)
        for share in _JITTERS
    ]
    uavs = len(velocity)
    price = float(np.log(uavs))
    label = np.arange(uavs)
    waiting = np.flatnonzero(~still)
    waiting = waiting if len(waiting) <= _AT_ONCE else rng.permutation(waiting)
    while len(waiting):
        turn, waiting = np.sort(waiting[:_AT_ONCE]), waiting[_AT_ONCE:]
        gram = np.stack([coordinates[turn][:, part] @ coordinates[turn][:, part].T for part in band])
        found, model = _merge_best(gram, models, price)
        label[turn] = turn[found]
        if len(waiting):
            waiting = _join(coordinates, band, model, label, turn, waiting, price)
    _, first, place = np.unique(label, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[place], np.int64)


def _spectral_bands(velocity: Floats, spectra: FlightSpectra) -> tuple[Floats, list[Indices], Floats, Floats, Floats]:
    """Fourier coordinates ``(n, a K)``, and the columns, their number, 2 (1 - cos w) and the spectrum of each band."""
    uavs, steps, axes = velocity.shape
    transformed = np.fft.rfft(velocity, axis=1, norm="ortho")[:, 1:]
    omega = 2.0 * np.pi * np.arange(1, transformed.shape[1] + 1) / steps
    real, imaginary = np.sqrt(2.0) * transformed.real, np.sqrt(2.0) * transformed.imag
    if steps % 2 == 0:  # the highest frequency of an even number of samples is real
        real[:, -1] /= np.sqrt(2.0)
        imaginary = imaginary[:, :-1]
    coordinates = np.concatenate([real, imaginary], axis=1)
    omega = np.concatenate([omega, omega[: imaginary.shape[1]]])
    order = np.argsort(omega, kind="stable")
    parts = np.array_split(order, min(_BANDS, len(order)))
    columns = [(axes * part[:, None] + np.arange(axes)).ravel() for part in parts]
    wave = 2.0 * (1.0 - np.cos(omega))
    typical = spectra.typical(omega)
    return (
        coordinates.reshape(uavs, -1),
        columns,
        np.array([float(len(some)) for some in columns]),
        np.array([wave[part].mean() for part in parts]),
        np.array([np.exp(np.log(typical[part]).mean()) for part in parts]),
    )


def _merge_best(gram: Floats, models: list[_Bands], price: float) -> tuple[Indices, _Bands]:
    """The most likely labels over the shares of jitter, and the bands of that share.

    Mergers are ordered by one share; after each of them the likelihood of the labels is known for all shares.
    """
    energy = np.einsum("fii->fi", gram)
    first = models[_ORDERED_BY]
    groups, energies, sizes = _merge(gram.copy(), first.ratio, first.noise, first.count, price)
    every = _Bands(
        *np.array([[model.noise, model.ratio, model.count] for model in models]).transpose(1, 2, 0)
    )  # (F, J) each
    alone = (energy.sum(axis=1)[:, None] / every.noise + energy.shape[1] * every.count * np.log(every.noise)).sum(
        axis=0
    )
    begin = every.worth(energy[:, None], np.ones(energy.shape[1])).sum(axis=1) - 0.5 * alone
    one, other, union = every.worth(energies[:, None], sizes.astype(np.float64)).swapaxes(0, 1)
    value = np.cumsum(np.column_stack([begin, union - one - other - price]), axis=1)  # after each merger
    best, last = np.unravel_index(value.argmax(), value.shape)
    label = np.arange(energy.shape[1])
    for one, other in groups[:last][::-1].tolist():
        label[other] = label[one]
    return label, models[best]


@compiled()
def _merge(gram: Floats, ratio: Floats, noise: Floats, count: Floats, least: float) -> tuple[Indices, Floats, Indices]:
    """Merge the best pair of groups until no merger gains at ``least`` so much.

    ``gram`` ``(F, n, n)`` are products of the coordinates of all pairs of UAVs, by band; it is overwritten.

    Returns:
        For each of S mergers: the two groups ``(S, 2)``, named by a member; the energies ``(F, 3, S)`` and the sizes
        ``(3, S)`` of the two and of their union.
    """
    bands, uavs, _ = gram.shape
    # Worth of a group of m members: sum over bands of slope[m] |S|² less price[m].
    slope, price = np.empty((uavs + 1, bands)), np.empty(uavs + 1)
    for m in range(uavs + 1):
        price[m] = 0.0
        for f in range(bands):
            slope[m, f] = 0.5 * ratio[f] / ((1.0 + m * ratio[f]) * noise[f])
            price[m] += 0.5 * count[f] * np.log(1.0 + m * ratio[f])
    size = np.ones(uavs, np.int64)
    worth = np.empty(uavs)
    for i in range(uavs):
        worth[i] = -price[1]
        for f in range(bands):
            worth[i] += slope[1, f] * gram[f, i, i]
    rise = np.full((uavs, uavs), -np.inf)
    best = np.zeros(uavs, np.int64)
    groups, sizes = np.empty((uavs, 2), np.int64), np.empty((3, uavs), np.int64)
    energies = np.empty((bands, 3, uavs))
    for i in range(uavs):
        for j in range(uavs):
            if i != j:
                value = -price[2] - worth[i] - worth[j]
                for f in range(bands):
                    value += slope[2, f] * (gram[f, i, i] + gram[f, j, j] + 2.0 * gram[f, i, j])
                rise[i, j] = value
                if value > rise[i, best[i]]:
                    best[i] = j
    done = 0
    while done < uavs - 1:
        one = 0
        for i in range(uavs):
            if size[i] > 0 and rise[i, best[i]] > rise[one, best[one]]:
                one = i
        other = best[one]
        if not rise[one, other] > least:
            break
        groups[done, 0], groups[done, 1] = one, other
        sizes[0, done], sizes[1, done], sizes[2, done] = size[one], size[other], size[one] + size[other]
        for f in range(bands):
            energies[f, 0, done], energies[f, 1, done] = gram[f, one, one], gram[f, other, other]
            for k in range(uavs):
                gram[f, one, k] += gram[f, other, k]
            for k in range(uavs):
                gram[f, k, one] += gram[f, k, other]
            energies[f, 2, done] = gram[f, one, one]
        size[one] += size[other]
        size[other] = 0
        worth[one] = -price[size[one]]
        for f in range(bands):
            worth[one] += slope[size[one], f] * gram[f, one, one]
        for k in range(uavs):
            rise[k, other] = -np.inf
            rise[other, k] = -np.inf
            if k != one and size[k] > 0:
                m = size[one] + size[k]
                value = -price[m] - worth[one] - worth[k]
                for f in range(bands):
                    value += slope[m, f] * (gram[f, one, one] + gram[f, k, k] + 2.0 * gram[f, one, k])
                rise[one, k] = value
                rise[k, one] = value
        for k in range(uavs):
            if size[k] > 0:
                if k == one or best[k] == one or best[k] == other:
                    best[k] = rise[k].argmax()
                elif rise[k, one] > rise[k, best[k]]:
                    best[k] = one
        done += 1
    return groups[:done], energies[:, :, :done], sizes[:, :done]


def _join(
    coordinates: Floats,
    band: list[Indices],
    model: _Bands,
    label: Indices,
    turn: Indices,
    waiting: Indices,
    price: float,
) -> Indices:
    """Let UAVs join the groups of a turn: writes to ``label``, and returns those that joined none."""
    names, group = np.unique(label[turn], return_inverse=True)
    size = np.bincount(group).astype(np.float64)
    total, left = sum_groups(coordinates[turn], group), coordinates[waiting]
    energy, single = (np.stack([(some[:, part] ** 2).sum(axis=1) for part in band]) for some in (total, left))
    # The worth of a union is linear in its energy |left|² + |total|² + 2 left total, band by band.
    slope = 0.5 * model.ratio[:, None] / ((1.0 + (1.0 + size) * model.ratio[:, None]) * model.noise[:, None])
    column = np.repeat(np.arange(len(band)), [len(part) for part in band])[np.argsort(np.concatenate(band))]
    rise = left @ (2.0 * total * slope[column].T).T
    rise += single.T @ slope - model.worth(single, np.ones(len(left)))[:, None]
    rise += model.worth(energy, 1.0 + size) - model.worth(energy, size)
    best = rise.argmax(axis=1)
    joins = rise[np.arange(len(left)), best] > price
    label[waiting[joins]] = names[best[joins]]
    return np.asarray(waiting[~joins])


def limit_candidates(label: Indices, rng: np.random.Generator) -> Indices:
    """``(n,)``: the only group that each UAV may lead, or -1: all may. Of a large swarm, a few of each group may."""
    if len(label) <= _AT_ONCE:
        return np.full(len(label), -1)
    order = np.lexsort((rng.random(len(label)), label))
    rank = np.arange(len(label)) - np.searchsorted(label[order], label[order])
    drawn = np.isin(np.arange(len(label)), order[rank < _DRAWN])
    return np.where(drawn, -1, label)
