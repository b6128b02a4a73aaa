"""Which feature classes of follow-mixture contain a follow strategy: R² of a least-squares fit of its direction.

    OMP_NUM_THREADS=1 python benchmarks/strategy_classes.py    # writes results/follow_mixture/classes.csv

The noise-free direction of every follower at every step is regressed on the features that the detector computes
(``detectors.series.features``) from the true head's past, once with one law for all followers and once with one
law for each follower; each follower has its own constant. R² = 1 means that the class contains the strategy exactly;
1 - R² is what it leaves unexplained.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from follow_mixture_strategies import STRATEGIES
from numpy.typing import NDArray
from running import RESULTS, make_parser, write_csv

from detectors.follow_mixture.motion import lagged, read_motion
from detectors.series.features import CLASSES, make_features
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.swarm import FollowInputs, FollowStrategy
from usnet_env.swarm.follow import follow_strategy

Floats, Indices = NDArray[np.float64], NDArray[np.intp]

FILE = RESULTS / "follow_mixture" / "classes.csv"
SEED = 7077
MEMORY = 4  # L, the detector's default
STEPS = 200  # two windows: many more rows than a law has numbers, also for one follower alone
#: R² from which a class counts as containing a strategy. The rest is then less than the followers' own noise, whose
#: variance is 0.05² on each axis, beside some 0.3 of the direction: about 0.0075 of it.
CONTAINED = 0.9925


def follow_truly(
    strategy: FollowStrategy, window: Window, followers: Indices, heads: Indices, parameters: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The noise-free directions that a strategy gives.

    Args:
        strategy: the follow strategy.
        window: its first :data:`MEMORY` steps are past only.
        followers: indices ``(f,)``.
        heads: indices ``(f,)`` of the followers' heads.
        parameters: of the strategy in this episode.

    Returns:
        ``(f, T_ob - MEMORY, 3)``, not normalised.
    """
    directions = []
    for step in range(MEMORY, window.observation_steps):
        position = window.position[step - MEMORY : step + 1][::-1]
        velocity = window.velocity[step - MEMORY : step][::-1]
        inputs = FollowInputs(
            own_position=position[:, followers].swapaxes(0, 1),
            head_velocity=velocity[:, heads].swapaxes(0, 1),
            head_position=position[:, heads].swapaxes(0, 1),
            parameters=parameters,
        )
        directions.append(strategy.direction(inputs))
    return np.stack(directions, axis=1)


def fly(name: str, seed: int = SEED) -> tuple[Floats, Floats]:
    """Fly a swarm of iid heads by a strategy.

    Returns:
        The directions ``(f, R, 3)`` of its f followers, and the pasts ``(f, R, L, 3)`` of their heads.
    """
    env = MultiClusterEnv(follow=name, observation_steps=STEPS, clusters=5, uavs=35)
    observation, _ = env.reset(seed=seed)
    window = Window.from_observation(observation)
    strategy = follow_strategy(name)
    followers = np.flatnonzero(~env.swarm.head)
    heads = env.swarm.root[followers]
    parameters = strategy.draw(np.random.default_rng(seed))
    motion = read_motion(window, np.arange(window.uavs))
    if motion is None:
        raise RuntimeError("the window must hold enough velocities for the detector's features")
    directions = follow_truly(strategy, window, followers, heads, parameters).astype(np.float64)
    return directions, lagged(motion.velocity, MEMORY)[heads]


def explained(features: Floats, direction: Floats) -> float:
    """R² of a least-squares fit of ``direction (n, 3)`` on ``features (n, p)``, which both have mean 0."""
    residual = direction - features @ np.linalg.lstsq(features, direction, rcond=None)[0]
    return float(1.0 - (residual**2).sum() / (direction**2).sum())


def measure(name: str) -> list[dict[str, str]]:
    """One row for each class: R² with one law for all followers, and the smallest R² of one law for each follower."""
    direction, past = fly(name)
    direction = direction - direction.mean(axis=1, keepdims=True)  # each follower has a constant of its own
    rows = []
    values, columns = make_features(past, CLASSES)
    for library, used in columns.items():
        features = values[:, used].swapaxes(1, 2)
        together = explained(features.reshape(-1, features.shape[2]), direction.reshape(-1, 3))
        alone = min(explained(own, wanted) for own, wanted in zip(features, direction, strict=True))
        rows.append({"strategy": name, "class": library, "r2_shared": f"{together:.6f}", "r2_each": f"{alone:.6f}"})
    return rows


def contained(rows: list[dict[str, str]]) -> bool:
    """Whether some class contains the strategy of the rows, with one law for all followers or one for each."""
    return max(float(row[kind]) for row in rows for kind in ("r2_shared", "r2_each")) >= CONTAINED


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--out", type=Path, default=FILE)
    out = parser.parse_args().out
    rows = [row for name in STRATEGIES for row in measure(name)]
    write_csv(out, rows)
    for name in STRATEGIES:
        own = [row for row in rows if row["strategy"] == name]
        best = max(own, key=lambda row: max(float(row["r2_shared"]), float(row["r2_each"])))
        print(f"{name}: {best['class']}, shared {best['r2_shared']}, each {best['r2_each']}")


if __name__ == "__main__":
    main()
