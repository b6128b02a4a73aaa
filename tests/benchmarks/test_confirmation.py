"""The ablation of the test that confirms leaders."""

from collections import Counter

import confirmation_ablation
from running import RESULTS, read_csv

from usnet_env.tracks import confirming


def test_every_change_moves_a_part_that_exists() -> None:
    names = {name for change in confirmation_ablation.CHANGES.values() for name in change.patches}
    assert names
    assert all(hasattr(confirming, name) for name in names)


def test_every_window_was_answered_under_every_change() -> None:
    rows = read_csv(RESULTS / confirmation_ablation.FILE.name)
    counts = Counter((row["set"], row["recording"], row["detector"], row["window"]) for row in rows)
    assert set(counts.values()) == {len(confirmation_ablation.CHANGES)}
    assert {row["change"] for row in rows} == set(confirmation_ablation.CHANGES)


def test_more_ids_of_leaderless_flocks_are_confirmed_if_no_lead_is_needed() -> None:
    """``lagged-regression`` names an id in every window; all are wrong."""
    confirmed = {}
    for change in ("", "lead-never"):
        found = [
            confirmation_ablation.confirm(case, "lagged-regression", number, change)
            for seed in range(2)
            for number, case in enumerate(confirmation_ablation.make("leaderless", seed))
        ]
        assert {each["named"] for each in found} == {1}
        assert not any(each["confirmed_right"] or each["followers_right"] for each in found)
        confirmed[change] = sum(each["confirmed"] for each in found)
    assert confirmed[""] <= 1 < confirmed["lead-never"]
