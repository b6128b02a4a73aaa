"""Spectra and groups of follow-mixture against slow definitions."""

import numpy as np
import pytest
from mixture_windows import swarm_window

from detectors.follow_mixture.groups import _Bands, _merge_best, _spectral_bands
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


@pytest.mark.parametrize("steps", [9, 10])
def test_fourier_coordinates_keep_lengths_and_angles(steps):
    velocity = np.random.default_rng(0).standard_normal((4, steps, 3))
    coordinates, columns, count, wave, _ = _spectral_bands(velocity, fit_spectra(velocity, True))
    centred = velocity - velocity.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(coordinates @ coordinates.T, np.einsum("itx,jtx->ij", centred, centred), atol=1e-10)
    assert sorted(np.concatenate(columns)) == list(range(3 * (steps - 1)))
    assert count.tolist() == [len(some) for some in columns]
    assert (np.diff(wave) >= 0).all()
    assert wave.max() <= 4.0


def merge_slowly(gram, models, price):
    """The partition of the highest log density less prices on the path of greedy mergers, and its model."""
    uavs = gram.shape[1]

    def worth(model, members):
        return float(model.worth(gram[:, members][:, :, members].sum(axis=(1, 2)), np.float64(len(members))))

    path = [[[i] for i in range(uavs)]]
    while True:
        groups = path[-1]
        now = [worth(models[-1], some) for some in groups]
        rises = {
            (a, b): worth(models[-1], groups[a] + groups[b]) - now[a] - now[b]
            for a in range(len(groups))
            for b in range(a)
        }
        a, b = max(rises, key=rises.__getitem__, default=(0, 0))
        if not rises.get((a, b), 0.0) > price:
            break
        path.append([*(some for k, some in enumerate(groups) if k not in (a, b)), groups[a] + groups[b]])
    energy = np.einsum("fii->f", gram)
    found = []
    for model in models:
        alone = -0.5 * (energy / model.noise + uavs * model.count * np.log(model.noise)).sum()
        for mergers, groups in enumerate(path):
            found.append((alone + sum(worth(model, some) for some in groups) - mergers * price, groups, model))
    return max(found, key=lambda one: one[0])[1:]


@pytest.mark.parametrize("price", [0.0, np.log(13), 10.0])
@pytest.mark.parametrize("seed", range(5))
def test_groups_are_merged_as_by_definition(seed, price):
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, 13)
    shared = rng.normal(size=(3, 4, 6))[:, label]
    x = shared + rng.choice([0.2, 0.7]) * rng.normal(size=(3, 13, 6))
    x[:, rng.choice(13, 3, replace=False)] = rng.normal(size=(3, 3, 6))
    gram = x @ x.swapaxes(1, 2)
    count = np.full(3, 6.0)
    models = [
        _Bands(share * np.array([1.0, 1.2, 1.5]), (1.0 - share) / share * np.array([1.0, 0.8, 0.5]), count)
        for share in (0.03, 0.1, 0.3, 0.5)
    ]
    found, model = _merge_best(gram, models, price)
    groups, expected = merge_slowly(gram, models, price)
    assert model is expected
    wanted = {frozenset(some) for some in groups}
    assert {frozenset(np.flatnonzero(found == name).tolist()) for name in np.unique(found)} == wanted
