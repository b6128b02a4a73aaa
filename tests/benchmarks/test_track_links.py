"""Files of simulated tracks with known links, and what is counted of the links that are found."""

import numpy as np
import pandas as pd
import pytest
import track_links

from usnet_env.tracks.found import DetectedWindow, Event, Link
from usnet_env.tracks.result import FoundLeaders


@pytest.mark.parametrize("kind", track_links.KINDS)
def test_a_follower_repeats_the_mean_velocity_of_the_ids_that_it_copies(kind):
    tracks, parents, delay = track_links.simulate_links(kind, 6, 10, False, 0)
    position = tracks.position.reshape(6, -1, 3)[..., :2]
    velocity, (leader, *_) = np.diff(position, axis=1), (i for i in range(6) if not parents[i])
    assert parents[leader] == []
    for i in (i for i in range(6) if parents[i]):
        lag = round(10 * delay[i])
        copied = velocity[parents[i]].mean(axis=0)
        assert np.corrcoef(velocity[i][lag:].ravel(), copied[:-lag].ravel())[0, 1] > 0.6


def test_links_are_counted_with_the_errors_of_their_delays():
    links = (
        Link(1, 0, 0, 1.1, 0.9, 1.3),  # right, and .1 s off
        Link(2, 0, 0, 2.0, 1.8, 2.2),  # wrong: it copies 1
        Link(3, 0, 0, None, direct=False),
    )
    found = FoundLeaders((DetectedWindow(0.0, 9.0, (), links=links),), (), "reader")
    counted = track_links.score_links(found, [[], [0], [1], [2]], np.array([0.0, 1.0, 1.0, 1.0]))
    assert counted == {
        "possible": 3, "links": 3, "drawn": 2, "right": 1,
        "delay_error": pytest.approx(0.1), "intervals": 1, "covered": 1,
    }  # fmt: skip


def test_a_change_is_found_once_in_time_and_with_both_leaders():
    events = [(62.0, 0, 1), (64.0, 0, 1), (130.0, 1, 0)]
    found = type("Found", (), {"events": [Event(time, "changes", (), old, new) for time, old, new in events]})
    counted = track_links.score_changes(found, [(range(8), [(0, 0), (60, 1), (120, 0)])])
    assert counted == {"changes": 2, "found": 1, "false": 2, "time_error": 2.0}


def test_the_tables_have_shares_of_links_with_the_file_as_unit(tmp_path, capsys):
    path = tmp_path / "rows.csv"
    rows = pd.DataFrame(
        {
            "kind": ["star", "star", "one change"], "ids": 6, "rate": 2, "strong": 0, "file": [0, 1, 0], "seed": 1,
            "possible": [10, 10, 0], "links": [10, 5, 0], "drawn": [5, 5, 0], "right": [4, 5, 0],
            "intervals": [4, 5, 0], "covered": [4, 5, 0],
            "delay_error": [0.1, 0.3, np.nan], "changes": [0, 0, 1], "found": [0, 0, 1],
            "false": [0, 0, 2], "time_error": [np.nan, np.nan, 1.0],
        }
    )  # fmt: skip
    rows.to_csv(path, index=False)
    track_links.main(["--rows", str(path), "--draw"])
    shown = capsys.readouterr().out
    assert "| star | 2 | 0.750 (" in shown
    assert "| 0.667 (" in shown
    assert "| one change | 1 | 1 | 1 | 2 | 1.0 |" in shown
