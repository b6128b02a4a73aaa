"""A small field, in which swarms differ in all but size: what PPO learns there, beside every detector.

    OMP_NUM_THREADS=1 python benchmarks/small_field.py --trainings 5
    python benchmarks/small_field.py --draw                  # trains and plays nothing: the table of the rows

A row is an episode; all play the same swarms, on none of which PPO trained.
"""

from __future__ import annotations

from typing import Any

import learning
from paper import shared
from pivot import mean, pivot, rate, size
from suites import DETECTORS

from usnet_env import evaluate

ROWS = shared.RESULTS / "small_field.csv.gz"
PPO, EPISODES = "PPO", 50
STUDY = learning.Study(
    "USNET/SingleCluster-Field-v0",
    {"followers": [5, 9], "bystanders": 0, "traffic": 0, "observation_steps": 30},
    24 * learning.ROLLOUT,
    {},
    learning.FALLING,
)


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play the episodes of a detector, or those of PPO after a training of it."""
    detector = game["detector"]
    if detector == PPO:
        from detectors.policy_detector import PolicyDetector

        policy, _ = learning.train(STUDY, learning.SB3, 1000 * game["training"])
        detector = PolicyDetector(policy)
    found = evaluate(STUDY.env, detector, episodes=EPISODES, seed=shared.SEED, env_kwargs=STUDY.arguments)
    return [game | row for row in found.rows[["episode", "J", "exact", "f1_first"]].to_dict("records")]


def report(rows: Any) -> str:
    """A line for each detector, the best first; the trainings of PPO are one line."""
    order = -rows.groupby("detector").J.mean()
    rows = rows.sort_values("detector", key=lambda names: names.map(order), kind="stable")
    return pivot(rows, {"detector": "detector"}, {"n": size, "exact": rate("exact"), "J": mean("J")})


def main(argv: list[str] | None = None) -> None:
    parser = shared.parse(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=1)
    parser.add_argument("--detector", nargs="*", default=[PPO, "reader(objective='P1')", *DETECTORS])
    given = parser.parse_args(argv)
    trainings = {name: given.trainings if name == PPO else 1 for name in given.detector}
    games = [{"detector": name, "training": k} for name, count in trainings.items() for k in range(count)]
    print(report(shared.measure(given, games, play)))


if __name__ == "__main__":
    main()
