"""Minari: record the games of a detector in a data set, load it, and train a network to imitate the detector.

pip install -e '.[minari]'
python examples/frameworks/minari_imitation.py
"""

import argparse
import os
import tempfile
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import minari
import numpy as np
import torch
from minari.data_collector import EpisodeBuffer
from torch import Tensor, nn

from detectors.policy_detector import PolicyDetector
from usnet_env import Window, evaluate, make_detector
from usnet_env.plugins import DetectorLike

ENV = "USNET/MultiCluster-v0"
ARGUMENTS = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5}
LARGER = {"clusters": 4, "uavs": 40}
DATASET, TEACHER = "usnet/two-clusters/lagged-regression-v0", "lagged-regression(clusters=2)"


def record(games: int, seed: int = 0) -> minari.MinariDataset:
    """Record the teacher's games in a data set below ``MINARI_DATASETS_PATH``. The teacher sees windows only."""
    env, teacher = gym.make(ENV, **ARGUMENTS), make_detector(TEACHER)
    return minari.create_dataset_from_buffers(
        DATASET,
        [play_episode(env, teacher, number, seed + number) for number in range(games)],
        env=env,
        eval_env=env,
        algorithm_name=TEACHER,
        author="USNET",
        author_email="none",
        code_permalink="none",
        description="Windows of small swarms, and the candidates that the teacher named.",
    )


def play_episode(env: gym.Env, teacher: DetectorLike, number: int, seed: int) -> EpisodeBuffer:
    """Play one game without Minari's DataCollector, which needs JAX."""
    teacher.reset(number)
    observation, info = env.reset(seed=seed)
    observations, infos, actions, outcomes = [observation], [info], [], []
    while not outcomes or not (outcomes[-1][1] or outcomes[-1][2]):
        actions.append(teacher.detect(Window.from_observation(observation)).candidates.astype(np.int8))
        observation, *outcome, info = env.step(actions[-1])
        observations.append(observation)
        infos.append(info)
        outcomes.append(outcome)
    rewards, terminations, truncations = map(list, zip(*outcomes, strict=True))
    return EpisodeBuffer(
        number, seed, None, stack(observations), np.stack(actions), rewards, terminations, truncations, stack(infos)
    )


def stack(mappings: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Stack mappings with the same keys into one, with a new first axis."""
    return {name: np.stack([one[name] for one in mappings]) for name in mappings[0]}


def load_rounds(games: Iterable[minari.EpisodeData]) -> tuple[Tensor, Tensor, Tensor]:
    """Velocities ``(R, T_ob, N, 3)``, living UAVs ``(R, N)`` and candidates ``(R, N)`` of all rounds R."""
    velocity, alive, named = [], [], []
    for game in games:
        rounds = len(game.actions)  # there is one more observation: the window after the last round
        velocity.append(game.observations["velocity"][:rounds])
        alive.append(game.observations["alive"][:rounds])
        named.append(game.actions)
    return tuple(torch.from_numpy(np.concatenate(parts)) for parts in (velocity, alive, named))


class Student(nn.Module):
    """Judges each UAV by the share of the swarm that copies it; the input is that of :class:`PolicyDetector`."""

    def __init__(self, hidden: int = 16) -> None:
        super().__init__()
        self.judge = nn.Sequential(nn.Linear(1, hidden), nn.Tanh(), nn.Linear(hidden, 1))

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """``(B, N)`` logits; below -100 for a destroyed UAV."""
        velocity, alive = observation["velocity"], observation["alive"]
        agreement = torch.einsum("btic,btjc->bij", velocity[:, 1:], velocity[:, :-1])
        agreement -= 1e6 * (torch.eye(alive.shape[1]) + (alive == 0)[:, None])
        copied = nn.functional.one_hot(agreement.argmax(dim=2), alive.shape[1])  # row i: the UAV that i copies
        share = (copied * alive[..., None]).sum(dim=1) / alive.sum(dim=1, keepdim=True).clamp(min=1)
        return self.judge(share[..., None])[..., 0] - 1e3 * (alive == 0)


def imitate(dataset: minari.MinariDataset, updates: int, seed: int = 0) -> tuple[Student, list[float]]:
    """Train a student on the data set; return it and its loss in each update (cross entropy per living UAV)."""
    torch.manual_seed(seed)  # a script may seed PyTorch's global generator, from which layers draw their weights
    student = Student()
    optimizer = torch.optim.Adam(student.parameters(), lr=5e-2)
    velocity, alive, named = load_rounds(dataset)
    losses = []
    for _ in range(updates):
        logits = student({"velocity": velocity, "alive": alive})
        loss = nn.functional.binary_cross_entropy_with_logits(logits, named.float(), weight=alive.float())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    return student, losses


def main(arguments: Sequence[str] | None = None) -> None:
    """Record, load, train, and compare with the teacher, on larger swarms too."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--games", type=int, default=100, help="games to record")
    parser.add_argument("--updates", type=int, default=100)
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--datasets", help="folder to keep the data set in; by default the data set is deleted")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        os.environ["MINARI_DATASETS_PATH"] = asked.datasets or temporary
        record(asked.games)
        dataset = minari.load_dataset(DATASET)
        print(f"{dataset.total_episodes} games, {dataset.total_steps} rounds in {DATASET}")
        student, losses = imitate(dataset, asked.updates)
    print(f"loss: {losses[0]:.3f}, after {asked.updates} updates {losses[-1]:.3f}")
    for swarm in (ARGUMENTS, {**ARGUMENTS, **LARGER}):
        print(f"{swarm['uavs']} UAVs in {swarm['clusters']} clusters")
        detectors = {"student": PolicyDetector(student), "teacher": f"lagged-regression(clusters={swarm['clusters']})"}
        result = evaluate(ENV, detectors, episodes=asked.episodes, seed=2022, env_kwargs=swarm)
        print(result.to_markdown(["f1_first", "J"]))


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
