"""The recordings that no detector met before: what is read, and who leads in it."""

import numpy as np
import pandas as pd
import pytest
import recordings
from paper.shared import read_rows


def walk(seed, count):
    turns = np.cumsum(np.random.default_rng(seed).normal(0, 0.06, count))
    return np.cumsum([np.cos(turns), np.sin(turns)], axis=1)


@pytest.fixture
def folder(tmp_path):
    films, parts = tmp_path / "termites/analysis/Rs/films", tmp_path / "platoons/data/OpenACC_data/mixed"
    films.mkdir(parents=True)
    parts.mkdir(parents=True)
    first, second = walk(1, 900)[:, 6:], walk(1, 900)[:, :-6]  # the second animal is where the first one was
    wide = pd.DataFrame({"position": range(894), "x0": first[0], "y0": first[1], "x1": second[0], "y1": second[1]})
    wide.to_csv(films / "a_tandem-position.csv", index=False)
    for name, cars in {"a_part1": (1, 2, 4), "a_part2": (2, 3)}.items():
        route, columns = walk(2, 1500), {"Time": np.arange(1400) / 10}
        for k, car in enumerate(cars):
            columns[f"E{car}"], columns[f"N{car}"] = route[:, 60 - 15 * k :][:, :1400]
        (parts / f"{name}.csv").write_text("Date,\n" * 5 + pd.DataFrame(columns).to_csv(index=False))
    return tmp_path


def test_who_leads_is_read_from_the_order_and_the_distance(folder):
    ((kind, _, pair),) = recordings.read_termites(folder / "termites")
    first, second = pair.drop_duplicates("id").id
    assert kind == "Rs"
    assert set(pair[pair.id == first].leader) == {""}
    assert set(pair[pair.id == second].leader) <= {first, ""}
    (seen, _, cars), (unseen, _, _) = recordings.read_platoons(folder / "platoons")
    assert (seen, unseen) == ("platoons", "platoons-unseen")
    order = cars.drop_duplicates("id")
    assert order.leader.tolist() == ["", *order.id[:2]]  # car 3 has no track: car 4 follows car 2


def test_rows_are_played_once_and_become_tables(folder, tmp_path):
    rows = tmp_path / "rows.csv.gz"
    call = [str(folder), "--rows", str(rows), "--detector", "lagged-network", "--detector"]
    recordings.main([*call, "destroy-all"])
    played = read_rows(rows)
    assert set(played["set"]) == {"Rs", "platoons", "platoons-unseen"}
    assert played.query("detector == 'destroy-all'").eval("named_right == heads").all()
    cars = played.query("set == 'platoons' and detector == 'lagged-network'")
    assert cars.named_right.mean() > 0.5
    recordings.main([*call, "reader"])
    again = read_rows(rows)
    pd.testing.assert_frame_equal(again[: len(played)], played)
    assert set(again[len(played) :].detector) == {"reader"}
    assert set(again[len(played) :].weights.str.len()) == {8}
    assert "| `reader` |" in recordings.report(again)
