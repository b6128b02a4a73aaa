"""Spectra and groups of follow-mixture against slow definitions."""

import numpy as np
import pytest
from synthetic_windows import swarm_window

from detectors.follow_mixture.motion import fit_spectra, read_motion, smoothed_pasts


def flown(seed, **config):
    window, _ = swarm_window(seed, **config)
    motion = read_motion(window, np.arange(window.uavs))
    return motion, fit_spectra(motion.velocity, motion.unit)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_the_variance_of_the_noise_is_estimated(noise):
    motion, spectra = flown(5, position_noise=noise, mobility="gauss_markov", head_jitter=True)
    assert np.sqrt(spectra.noise) * motion.speed == pytest.approx(noise, rel=0.2)
    assert flown(5, mobility="gauss_markov", head_jitter=True)[1].noise == 0


def expect(motion, spectra, uav, t, lag):
    """The velocity ``lag`` steps before step t, given those before t: the conditional mean of a normal distribution."""
    seen, power, memory = motion.velocity[uav], spectra.power[uav], spectra.memory[uav]
    flight = np.array([[power * memory ** abs(s - k) for k in range(t)] for s in range(t)])
    noise = spectra.noise * (2.0 * np.eye(t) - np.eye(t, k=1) - np.eye(t, k=-1))
    mean = seen.mean(axis=0)
    return mean + flight[t - lag] @ np.linalg.solve(flight + noise, seen[:t] - mean)


def test_smoothed_pasts_are_expectations_given_earlier_observations():
    motion, spectra = flown(6, position_noise=0.5)
    pasts = smoothed_pasts(motion.velocity, spectra, 4)
    assert pasts.shape == (len(motion.velocity), 4, 3, motion.velocity.shape[1] - 4)
    for uav, row, lag in ((7, 40, 2), (0, 0, 1), (29, 95, 4)):
        np.testing.assert_allclose(pasts[uav, lag - 1, :, row], expect(motion, spectra, uav, row + 4, lag), atol=1e-8)
