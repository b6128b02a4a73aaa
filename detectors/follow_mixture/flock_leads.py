"""Heads of flocks behind noise: to whose flight a flock's flight is the response, frequency by frequency.

Where flight is smooth and seen with noise, a head's past tells hardly more of a flock's next move than the flock's own
past does. But a delay shows in the phases of the low frequencies, which noise hardly touches. In Fourier coordinates a
UAV's flight x, of power P, and a flock's mean flight y that responds to it are jointly normal, independent from
frequency to frequency, and all flocks share the response g:

    var x = P + N,   cov(y, x) = G P,   var y = |G|² P + Q,   G(w) = sum over lags l of g_l exp(-i w l),

with N the observer's noise and Q what is left of it, and of the members' jitter, in the mean. The other hypothesis is
what flocks are found by: a member flies with its flock at the same time, and who is none flies independently of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from detectors.follow_mixture.explanation import Explanation
from detectors.follow_mixture.flocks import Flocks
from detectors.follow_mixture.gate import Gate, judged
from detectors.follow_mixture.mixture import head_price
from detectors.follow_mixture.noise import FlightSpectra

__all__ = [
    "PHASES_TELL",
    "Leads",
    "Responses",
    "explained_by_leads",
    "joint_density",
    "leads_of_flocks",
    "responses",
]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

PHASES_TELL = 0.015  # variance of position noise, relative to the squared speed, from which on moments tell less
_LAGS = 4
_ROUNDS = 6
_STEPS = 15  # of an optimiser that starts near
_WORST = -30.0  # nats by which one flock may speak against a response
_LEAST = 1e-12
_CLEAR = 20.0  # nats that a head that stands out may count
_STANDS_OUT = 12.0  # of them on average where the response is true
_RISE = 8.0  # nats a flock by which it is likelier than the best with time reversed
_ABSURD = -30.0  # nats of the median flock's best, below which a response is none: both hypotheses are wrong
_TEMPER = 0.2  # powers are estimated, and flocks no exact sums
_FAILED = 0.2  # what is left of a head's probability where reversed time explains as much


@dataclass(frozen=True, eq=False)
class Responses:
    """What C flocks of two and more and n UAVs show of each other at K frequencies, summed over the axes.

    Args:
        omega: ``(K,)`` angular frequencies per sample.
        power: ``(K,)`` P, of a UAV's flight.
        noise: ``(K,)`` N, of the observer in it.
        own: ``(C, n, K)`` Q, of the mean flight of a flock without UAV j.
        stimulus: ``(n, K)`` periodogram of each UAV.
        response: ``(C, n, K)`` periodogram of the flock without UAV j.
        cross: ``(C, n, K)`` cross-periodogram of both, y times the conjugate of x.
        null: ``(C, n)`` log-likelihood that j is what it was taken for, a fellow or a stranger.
        edge: variance of what a delay by one sample brings in at one end of the window and loses at the other: the
            difference of two velocities far apart.
    """

    omega: Floats
    power: Floats
    noise: Floats
    own: Floats
    stimulus: Floats
    response: Floats
    cross: Complex
    null: Floats
    edge: float

    def given(self, weights: Floats) -> Complex:
        """``(K,)`` G, by the weights ``(L,)`` of the lags."""
        lags = np.arange(1, len(weights) + 1)
        return np.asarray(weights @ np.exp(-1j * lags[:, None] * self.omega))

    def gain(self, weights: Floats, flock: Indices, head: Indices) -> Floats:
        """``(m,)`` log-likelihood that m flocks gain by responding to m UAVs."""
        given = self.given(weights)
        edge = self.edge * float((np.cumsum(weights[::-1]) ** 2).sum())
        whole = np.abs(given) ** 2 * self.power + self.own[flock, head] + edge
        density = joint_density(
            self.stimulus[head],
            self.response[flock, head],
            self.cross[flock, head],
            self.power + self.noise,
            whole,
            given * self.power,
        )
        return np.asarray(density.sum(axis=-1) - self.null[flock, head])

    def all_gains(self, weights: Floats) -> Floats:
        """``(C, n)`` of every flock by every UAV."""
        flock, head = np.ogrid[: len(self.null), : self.null.shape[1]]
        return self.gain(weights, flock, head)

    def explained(self, weights: Floats, flock: Indices, head: Indices) -> Floats:
        """``(m,)`` share of m flocks' flights that m UAVs explain, noise and all."""
        seen = self.given(weights) * self.power / (self.power + self.noise)
        cross = 2.0 * (np.conj(seen) * self.cross[flock, head]).real
        left = self.response[flock, head] - cross + np.abs(seen) ** 2 * self.stimulus[head]
        return np.clip(1.0 - left.sum(axis=-1) / self.response[flock, head].sum(axis=-1), 0.0, 1.0)

    def reversed(self) -> Responses:
        """The same with time running backwards: whoever led follows."""
        return replace(self, cross=self.cross.conj())


def joint_density(
    stimulus: Floats, response: Floats, cross: Complex, first: Floats, second: Floats, both: Any
) -> Floats:
    """Log-density, up to a constant, of two circular complex normal signals on three axes.

    Args:
        stimulus: squared modulus of the one, summed over the axes.
        response: of the other.
        cross: the other times the conjugate of the one.
        first: variance of the one.
        second: of the other.
        both: covariance of the other with the one, real or complex.
    """
    determinant = np.maximum(first * second - np.abs(both) ** 2, _LEAST)
    square = stimulus * second + response * first - 2.0 * (np.conj(both) * cross).real
    return np.asarray(-3.0 * np.log(determinant) - square / determinant)


def responses(velocity: Floats, spectra: FlightSpectra, flocks: Flocks) -> Responses:
    """Periodograms of flocks and of all UAVs.

    Flight has the swarm's median power and memory: what one window says of one UAV's own is less certain.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, nothing missing.
        spectra: of the same flights.
        flocks: of the same UAVs.
    """
    uavs, steps = velocity.shape[:2]
    flight = np.fft.rfft(velocity, axis=1, norm="ortho")[:, 1 : (steps + 1) // 2]
    omega = 2.0 * np.pi * np.arange(1, flight.shape[1] + 1) / steps
    power = spectra.typical(omega)
    noise = spectra.noise * 2.0 * (1.0 - np.cos(omega))
    jitter = flocks.jitter * float(np.median(spectra.power))
    shared = (1.0 - flocks.jitter) * power
    stimulus = (np.abs(flight) ** 2).sum(axis=2)
    found = flocks.several
    shape = (len(found), uavs, len(omega))
    own, response, cross = np.empty(shape), np.empty(shape), np.empty(shape, np.complex128)
    null = np.empty(shape[:2])
    for place, flock in enumerate(found):
        member = flocks.label == flock
        count = member.sum() - member
        mean = (flight[member].sum(axis=0) - np.where(member[:, None, None], flight, 0.0)) / count[:, None, None]
        response[place] = (np.abs(mean) ** 2).sum(axis=2)
        cross[place] = (mean * flight.conj()).sum(axis=2)
        own[place] = (noise + jitter) / count[:, None]
        fellow = member[:, None]
        null[place] = joint_density(
            stimulus,
            response[place],
            cross[place],
            np.where(fellow, shared + jitter, power) + noise,
            np.where(fellow, shared, power) + own[place],
            np.where(fellow, shared, 0.0),
        ).sum(axis=1)
    return Responses(
        omega, power, noise, own, stimulus, response, cross, null, 2.0 * float(np.median(spectra.power)) / steps
    )


@dataclass(frozen=True, eq=False)
class Leads:
    """Heads of flocks by response.

    Args:
        seen: what it was found in.
        weights: ``(L,)`` g, which all flocks share.
        gain: ``(C, n)`` log-likelihood that each flock gains by responding to each UAV.
        chance: ``(C, n)`` the same of the best response with time reversed.
    """

    seen: Responses
    weights: Floats
    gain: Floats
    chance: Floats

    @property
    def head(self) -> Indices:
        """``(C,)`` of each flock."""
        return np.asarray(self.gain.argmax(axis=1))

    @property
    def believed(self) -> bool:
        """Whether heads stand out, and the response is likely, and likelier than where time runs backwards."""
        best = self.gain.max(axis=1)
        rise = best.mean() - self.chance.max(axis=1).mean()
        clear = np.minimum(lead(self.gain), _CLEAR).mean()
        return bool(clear > _STANDS_OUT and rise > _RISE and np.median(best) > _ABSURD)


def lead(gain: Floats) -> Floats:
    """``(C,)`` by how much the best UAV of each flock stands out, of gains ``(C, n)``."""
    ranked = np.partition(gain, -2, axis=1)
    return np.asarray(ranked[:, -1] - ranked[:, -2])


def leads_of_flocks(velocity: Floats, spectra: FlightSpectra, flocks: Flocks) -> Leads | None:
    """The heads to whose flights flocks respond.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, nothing missing.
        spectra: of the same flights.
        flocks: of the same UAVs.

    Returns:
        ``None`` where there are no flocks, or nobody stands out.
    """
    if not len(flocks.several) or len(flocks.label) < 3:
        return None
    seen = responses(velocity, spectra, flocks)
    weights, gain = fit_response(seen)
    _, chance = fit_response(seen.reversed())
    found = Leads(seen, weights, gain, chance)
    return found if found.believed else None


def fit_response(seen: Responses) -> tuple[Floats, Floats]:
    """The response ``(L,)`` that explains the flocks best, and their gains ``(C, n)``.

    From each pure delay, and from one against it: heads by the response, the response by the heads, in turn.
    """
    starts = np.concatenate([np.eye(_LAGS), -np.eye(_LAGS)[:1]])
    found = [climbed(seen, start) for start in starts]
    return max(found, key=lambda fit: float(np.maximum(fit[1].max(axis=1), 0.0).sum()))


def climbed(seen: Responses, weights: Floats) -> tuple[Floats, Floats]:
    """A response and its gains, from a start."""
    gain, flock = seen.all_gains(weights), np.arange(len(seen.null))
    head = gain.argmax(axis=1)
    for _ in range(_ROUNDS):
        fit = minimize(
            lambda g, head=head: -np.maximum(seen.gain(g, flock, head), _WORST).sum(),
            weights,
            method="BFGS",
            options={"maxiter": _STEPS},
        )
        weights = fit.x
        gain, before = seen.all_gains(weights), head
        head = gain.argmax(axis=1)
        if np.array_equal(head, before):
            break
    return weights, gain


def explained_by_leads(leads: Leads, flocks: Flocks) -> Explanation:
    """The explanation that responses give: every flock of two and more has a head."""
    heads = np.unique(leads.head)
    gate = lead_gate(leads, flocks)
    flock_of = np.full(flocks.count, -1)
    flock_of[flocks.several] = np.arange(len(flocks.several))
    place = flock_of[flocks.label]
    leader = np.where(place >= 0, leads.head[place], -1)
    leader[heads] = -1
    weight = np.exp(_TEMPER * (leads.gain - leads.gain.max(axis=1, keepdims=True)))
    given = 1.0 - np.prod(1.0 - weight / weight.sum(axis=1, keepdims=True), axis=0)
    probability = given.copy()
    probability[heads] *= np.where(gate.passed, 1.0, _FAILED)
    follows = leader >= 0
    sizes = np.bincount(flocks.label)[flocks.several]
    share = leads.seen.explained(leads.weights, np.arange(len(leads.head)), leads.head)
    return Explanation(
        heads=heads,
        leader=leader,
        probability=probability,
        given=given,
        gain=np.where(follows, (lead(leads.gain) / sizes)[place], 0.0),
        explained=np.where(follows, share[place], 0.0),
        reasons=gate.reasons(),
        strategy={
            "class": f"response over {len(leads.weights)} lags",
            "shared": True,
            "weights": leads.weights,
            "flocks": flocks.label,
        },
        value=float(gate.added.sum()),
        passed=gate.passed,
        by_phases=True,
    )


def lead_gate(leads: Leads, flocks: Flocks) -> Gate:
    """Judge every head: by how much its flocks respond to it alone, against what flocks do with time reversed."""
    _, led = np.unique(leads.head, return_inverse=True)
    count = np.bincount(led, weights=np.bincount(flocks.label)[flocks.several]).astype(np.int64)
    added = np.asarray(np.bincount(led, weights=lead(leads.gain)), np.float64) - head_price(len(flocks.label))
    chance = np.asarray(np.bincount(led), np.float64) * float(np.median(lead(leads.chance)))
    return judged(count, added, chance[None])
