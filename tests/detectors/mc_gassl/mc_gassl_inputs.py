"""GRU inputs with known clusters for the tests of MC-GASSL."""

import torch

from detectors.mc_gassl.gru import GruInputs, GruParameters
from detectors.mc_gassl.training_steps import Clustered


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def parameters(seed=0, dtype=torch.float64, spread=1.0):
    drawn = (spread * torch.randn(3, 6, generator=generator(seed + k), dtype=dtype) for k in range(3))
    return GruParameters(*drawn)


def random_inputs(times=5, uavs=9, memory=4, seed=0, dtype=torch.float64, unseen=0.0):
    """Positions in a small arena, velocities of any length."""
    own = generator(seed)
    position = 2.0 * torch.randn(times, uavs, 3, generator=own, dtype=dtype)
    velocity = torch.randn(times, uavs, memory, 3, generator=own, dtype=dtype)
    return GruInputs(position, velocity, torch.rand(times, uavs, generator=own) >= unseen)


def clustered(times=5, uavs=9, clusters=3, seed=0):
    labels = torch.arange(uavs) % clusters
    return Clustered(random_inputs(times, uavs, seed=seed), labels)
