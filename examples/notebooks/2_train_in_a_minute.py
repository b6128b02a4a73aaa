# %% [markdown]
# # Train in a minute
#
# A network of a few numbers learns from labelled swarms whom to name, and is then a detector like any other.
# It needs `pip install '.[torch]'`.

# %%
import gymnasium as gym
import numpy as np
import torch

from usnet_env import Detection, Window, evaluate, register_detector

GAME = {"clusters": 3, "uavs": 30, "follow": "f2", "observation_steps": 30}

# %% [markdown]
# Four numbers for each UAV: how much more it is copied than it copies, one to four steps later, by one other UAV.


# %%
def describe(window: Window) -> torch.Tensor:
    """The numbers of all UAVs, (N, 4)."""
    velocity = np.where(window.velocity_seen[..., None], window.velocity, 0.0)
    steps = len(velocity)
    numbers = []
    for lag in range(1, 5):
        copied = np.einsum("tic,tjc->ij", velocity[lag:], velocity[:-lag]) / (steps - lag)
        numbers.append((copied - copied.T).max(axis=0))
    return torch.tensor(np.stack(numbers, axis=1), dtype=torch.float32)


# %% [markdown]
# Swarms with known heads, in one batch:

# %%
envs = gym.make_vec("usnet_env:USNET/MultiCluster-v0", num_envs=64, **GAME)
observations, _ = envs.reset(seed=0)
windows = [Window.from_observation({name: part[i] for name, part in observations.items()}) for i in range(64)]
inputs = torch.cat([describe(window) for window in windows])
heads = torch.tensor(envs.unwrapped.swarm.head.reshape(-1), dtype=torch.float32)

# %%
generator = torch.Generator().manual_seed(0)
network = torch.nn.Sequential(torch.nn.Linear(4, 16), torch.nn.ReLU(), torch.nn.Linear(16, 1))
with torch.no_grad():
    for weights in network.parameters():
        weights.copy_(0.3 * torch.randn(weights.shape, generator=generator))
optimiser = torch.optim.Adam(network.parameters(), lr=0.02)
for step in range(300):
    loss = torch.nn.functional.binary_cross_entropy_with_logits(network(inputs)[:, 0], heads)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    if step % 100 == 0:
        print(step, f"{loss.item():.3f}")


# %%
class Learned:
    """Names the UAVs that the network finds more probably heads than not."""

    def reset(self, seed=None):
        """Forget nothing: a game has no memory here."""

    def detect(self, window):
        """Ask the network."""
        with torch.no_grad():
            score = network(describe(window))[:, 0].numpy()
        return Detection((score > 0) & window.alive, score)


register_detector("learned-here", Learned, replace=True)
result = evaluate("USNET/MultiCluster-v0", ["learned-here"], episodes=10, seed=1, env_kwargs=GAME, trivial=True)
print(result.to_markdown(["J", "exact"]))
assert result["learned-here"]["J"]["mean"] < result["destroy-all"]["J"]["mean"]
