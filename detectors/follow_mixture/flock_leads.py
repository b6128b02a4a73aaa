"""Heads of flocks in smooth, noisy motion: cross-spectral estimation of a shared transfer function.

In smooth motion with observation noise, a head's past predicts a flock hardly better than the flock's own past does.
But a delay shows in the phases at low frequencies, where the noise is small. In Fourier coordinates the velocity x of a
head, with power P, and the mean velocity y of a flock that follows it are jointly normal and independent between
frequencies. All flocks share the impulse response g:

    var x = P + N,   cov(y, x) = G P,   var y = |G|² P + Q,   G(w) = sum over lags l of g_l exp(-i w l),

with N the observation noise, and Q what the mean over the members leaves of this noise and of their jitter. Under the
alternative hypothesis a member moves simultaneously with its flock, and another UAV moves independently of it.
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

PHASES_TELL = 0.015  # least variance of position noise, relative to the squared speed, for the cross-spectral fit
_LAGS = 4
_ROUNDS = 6
_STEPS = 15  # steps of the optimiser from a good start
_WORST = -30.0  # lower bound of the log-likelihood gain of one flock, in nats
_LEAST = 1e-12
_CLEAR = 20.0  # upper bound of the lead of the best UAV over the second, in nats
_STANDS_OUT = 12.0  # least mean lead for a true response
_RISE = 8.0  # least gain per flock over the best response in reversed time, in nats
_ABSURD = -30.0  # least median gain of the flocks, in nats; below it both hypotheses are wrong
_TEMPER = 0.2  # tempering, since powers are estimated and flocks are no exact sums
_FAILED = 0.2  # factor on the probability of a head that reversed time explains as well


@dataclass(frozen=True, eq=False)
class Responses:
    """Auto- and cross-periodograms of C flocks (of two or more UAVs) and n UAVs at K frequencies, summed over axes.

    Args:
        omega: ``(K,)`` angular frequencies per sample.
        power: ``(K,)`` P, the spectrum of a UAV's velocity.
        noise: ``(K,)`` N, the spectrum of the observation noise in it.
        own: ``(C, n, K)`` Q, the noise spectrum of the mean velocity of a flock without UAV j.
        stimulus: ``(n, K)`` periodogram of each UAV.
        response: ``(C, n, K)`` periodogram of the flock without UAV j.
        cross: ``(C, n, K)`` cross-periodogram of both, y times the conjugate of x.
        null: ``(C, n)`` log-likelihood of the alternative: j is a member of the flock, or independent of it.
        edge: variance of the error of a circular delay by one sample: the difference of the velocities at the two ends
            of the window.
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
        """``(K,)``: the transfer function G for the weights ``(L,)`` of the lags."""
        lags = np.arange(1, len(weights) + 1)
        return np.asarray(weights @ np.exp(-1j * lags[:, None] * self.omega))

    def gain(self, weights: Floats, flock: Indices, head: Indices) -> Floats:
        """``(m,)``: log-likelihood that m flocks gain by following m UAVs."""
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
        """``(C, n)``: the gain of each flock by each UAV."""
        flock, head = np.ogrid[: len(self.null), : self.null.shape[1]]
        return self.gain(weights, flock, head)

    def explained(self, weights: Floats, flock: Indices, head: Indices) -> Floats:
        """``(m,)``: share of the variance of m flocks, noise included, that m UAVs explain."""
        seen = self.given(weights) * self.power / (self.power + self.noise)
        cross = 2.0 * (np.conj(seen) * self.cross[flock, head]).real
        left = self.response[flock, head] - cross + np.abs(seen) ** 2 * self.stimulus[head]
        return np.clip(1.0 - left.sum(axis=-1) / self.response[flock, head].sum(axis=-1), 0.0, 1.0)

    def reversed(self) -> Responses:
        """The same in reversed time, in which heads follow their followers."""
        return replace(self, cross=self.cross.conj())


def joint_density(
    stimulus: Floats, response: Floats, cross: Complex, first: Floats, second: Floats, both: Any
) -> Floats:
    """Log-density, up to a constant, of two circular complex normal signals on three axes.

    Args:
        stimulus: squared modulus of the first signal, summed over the axes.
        response: squared modulus of the second signal.
        cross: the second signal times the conjugate of the first.
        first: variance of the first signal.
        second: variance of the second signal.
        both: covariance of the second signal with the first, real or complex.
    """
    determinant = np.maximum(first * second - np.abs(both) ** 2, _LEAST)
    square = stimulus * second + response * first - 2.0 * (np.conj(both) * cross).real
    return np.asarray(-3.0 * np.log(determinant) - square / determinant)


def responses(velocity: Floats, spectra: FlightSpectra, flocks: Flocks) -> Responses:
    """Compute the periodograms of the flocks and of all UAVs.

    The spectrum has the swarm's median power and autocorrelation; one window is too short to estimate them per UAV.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, without missing values.
        spectra: the spectra of these velocities.
        flocks: the flocks of these UAVs.
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
    """The fitted transfer function and the gains of the flocks.

    Args:
        seen: the periodograms.
        weights: ``(L,)`` g, which all flocks share.
        gain: ``(C, n)`` log-likelihood that each flock gains by following each UAV.
        chance: ``(C, n)`` the same for the best fit in reversed time.
    """

    seen: Responses
    weights: Floats
    gain: Floats
    chance: Floats

    @property
    def head(self) -> Indices:
        """``(C,)``: the head of each flock."""
        return np.asarray(self.gain.argmax(axis=1))

    @property
    def believed(self) -> bool:
        """Whether the best UAVs lead clearly, and the fit is likely, and more likely than in reversed time."""
        best = self.gain.max(axis=1)
        rise = best.mean() - self.chance.max(axis=1).mean()
        clear = np.minimum(lead(self.gain), _CLEAR).mean()
        return bool(clear > _STANDS_OUT and rise > _RISE and np.median(best) > _ABSURD)


def lead(gain: Floats) -> Floats:
    """``(C,)``: the difference between the best and the second best of the gains ``(C, n)`` of each flock."""
    ranked = np.partition(gain, -2, axis=1)
    return np.asarray(ranked[:, -1] - ranked[:, -2])


def leads_of_flocks(velocity: Floats, spectra: FlightSpectra, flocks: Flocks) -> Leads | None:
    """Fit heads of flocks by the transfer function.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, without missing values.
        spectra: the spectra of these velocities.
        flocks: the flocks of these UAVs.

    Returns:
        ``None`` if there are no flocks or no UAV leads clearly.
    """
    if not len(flocks.several) or len(flocks.label) < 3:
        return None
    seen = responses(velocity, spectra, flocks)
    weights, gain = fit_response(seen)
    _, chance = fit_response(seen.reversed())
    found = Leads(seen, weights, gain, chance)
    return found if found.believed else None


def fit_response(seen: Responses) -> tuple[Floats, Floats]:
    """Fit the response ``(L,)`` that explains the flocks best; also return their gains ``(C, n)``.

    Heads and response are fitted alternately, starting from each pure delay and from one with a negative sign.
    """
    starts = np.concatenate([np.eye(_LAGS), -np.eye(_LAGS)[:1]])
    found = [climbed(seen, start) for start in starts]
    return max(found, key=lambda fit: float(np.maximum(fit[1].max(axis=1), 0.0).sum()))


def climbed(seen: Responses, weights: Floats) -> tuple[Floats, Floats]:
    """Fit a response and its gains from one start."""
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
    """Convert the fit to the common result; each flock of two or more UAVs has a head."""
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
    """Test each head: the lead over the second best UAV, against the lead in reversed time."""
    _, led = np.unique(leads.head, return_inverse=True)
    count = np.bincount(led, weights=np.bincount(flocks.label)[flocks.several]).astype(np.int64)
    added = np.asarray(np.bincount(led, weights=lead(leads.gain)), np.float64) - head_price(len(flocks.label))
    chance = np.asarray(np.bincount(led), np.float64) * float(np.median(lead(leads.chance)))
    return judged(count, added, chance[None])
