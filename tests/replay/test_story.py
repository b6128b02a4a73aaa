"""The words about an episode, its picture, animation and page: what they say, show and load."""

import html
import json
import re
import sys

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.collections import PathCollection
from small_episode import MIND, ROUNDS, SAMPLES, UAVS, large_episode, small_episode

from usnet_env import ArgumentError, make_detector
from usnet_env.drawing import HIT, REDUNDANT, pixels_of
from usnet_env.replay import animate, draw_episode, record_episode, write_picture
from usnet_env.replay.animate import NAME, REMERGE, VERDICT, WATCH, Painter, describe_frame, list_scenes
from usnet_env.replay.page import write_page
from usnet_env.replay.story import annotated_uavs, describe_outcome, describe_round, explain_replay, tell_round

pytest.importorskip("matplotlib")


def long_episode(rounds, **changes):
    small = small_episode()
    repeated = ("position", "velocity", "seen", "root", "scores", *MIND[:-1])
    values = {
        **{name: np.repeat(getattr(small, name)[:1], rounds, axis=0) for name in repeated},
        "alive": np.ones((rounds, UAVS), bool),
        "candidates": np.zeros((rounds, UAVS), bool),
        "objective": np.arange(rounds) + 1.0,
        "over_budget": np.zeros(rounds, bool),
        "seconds": np.zeros(rounds),
        "reasons": None,
    }
    return small_episode(**values | changes)


def test_words_say_what_happened():
    episode = small_episode()
    assert describe_round(episode, 1) == "2 candidates (1 head hit, 1 redundant), 1 head left"
    assert describe_round(episode, 2) == "1 candidate (1 head hit, 0 redundant), 0 heads left"
    outcome = "2 of 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083 (J_m, lower is better)."
    assert describe_outcome(episode) == outcome
    outcome = describe_outcome(long_episode(4))
    assert outcome.startswith("0 of 2 heads found in 4 rounds with 0 redundant candidates: J = 4.000")
    single = small_episode(problem="P1", objective=[0.0, 0.0])
    assert describe_outcome(single).endswith("J = 0.000 (J_s, 0 is best).")
    assert "lower is better" not in tell(single)
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    assert describe_round(over, 1) == "2 candidates, over the shot budget: no UAV destroyed, 2 heads left"


def tell(record):
    names = [str(i) for i in range(record.uavs)]
    told = [text for number in range(1, record.rounds + 1) for text in tell_round(record, number, names)]
    return "\n".join([*told, explain_replay(record)])


def test_a_round_is_told_as_it_happens():
    watched, answered = tell_round(small_episode(), 1, [str(i) for i in range(UAVS)])
    assert watched == "**Round 1 of 2**"
    assert "2 candidates (1 head hit, 1 redundant), 1 head left." in answered
    assert "- **3** redundant, p 0.10, score" in answered
    assert "Adds 2 nats." in answered
    chosen = [{"head_0": "UAV 0: iid, jitter; price 0.1"}, {}]
    assert "- head_0, UAV 0: iid, jitter; price 0.1" in tell(small_episode(choices=chosen))


def test_reasons_are_the_detectors():
    episode = small_episode()
    marked = {i: (word, why) for i, word, why in annotated_uavs(episode, 1)}
    assert list(marked) == [i for i in np.argsort(-episode.scores[0]) if i in (0, 3, 5)]
    assert {i: word for i, (word, _) in marked.items()} == {0: "hit", 3: "redundant", 5: "missed"}
    assert marked[3][1].endswith(": Adds 2 nats.")
    assert marked[5][1] == f"p 0.90, score {episode.scores[0, 5]:.3g}"
    together = small_episode(clusters=np.zeros((ROUNDS, UAVS), int))
    assert {i: why for i, _, why in annotated_uavs(together, 1)}[5].endswith(": found in the group of UAV 0, UAV 3")
    assert annotated_uavs(small_episode(reasons=None, probability=None), 2)[0][2].startswith("score ")
    assert "… and 30 more" in tell(large_episode(candidates=np.ones((1, 60), bool)))


def test_what_is_true_of_tracks_is_said_of_tracks():
    """Where the truth is not known, there is in each window what was found."""
    ids, found = [f"bird-{i}" for i in range(UAVS)], small_episode().candidates.any(axis=0)
    truth = {"head": found, "decoy": np.zeros(UAVS, bool), "alive": np.ones((ROUNDS, UAVS), bool), "labelled": False}
    config = {"ids": ids, "start": ["0 s", "9 s"], "end": ["9 s", "18 s"]}
    record = small_episode(**truth, over_budget=[True, True], config=config)
    assert describe_outcome(record) == "In 2 windows, 3 of 12 ids lead at least once; the truth is unknown."
    assert describe_round(record, 1) == "0 s to 9 s: 2 leaders found"
    assert next(list_scenes(record, 2)).text == "0 s to 9 s: the detector watches 20 steps"
    assert tell_round(record, 2, ids)[0] == "**Window 2 of 2**\n\n9 s to 18 s"
    assert not record.destroyed.any()
    for word in ("UAV", "destroyed", "J =", "Round", "round"):
        assert word not in tell(record), word


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_a_map_of_each_round_in_one_scale():
    small = small_episode()
    spread = small.position.copy()
    spread[1] *= 3
    figure = draw_episode(small_episode(position=spread))
    assert [title.partition(":")[0] for title in titles(figure)] == ["Round 1", "Round 2"]
    assert len({np.ptp(axes.get_xlim()).round(3) for axes in figure.axes}) == 1
    assert "2 of 2 heads found in 2 rounds" in figure.get_suptitle()
    texts = {text.get_text() for text in figure.axes[-1].get_legend().get_texts()}
    assert {"candidate: redundant", "head, not a candidate", "destroyed earlier", "decoy: has no followers"} <= texts
    assert figure.axes[0].get_legend() is None


def test_a_leader_has_its_colour_in_all_windows():
    candidates = np.arange(UAVS) == np.array([[0], [5]])
    truth = {"head": candidates.any(axis=0), "decoy": np.zeros(UAVS, bool), "alive": np.ones((2, UAVS), bool)}
    root = np.broadcast_to([[0], [5]], (2, UAVS))
    figure = draw_episode(small_episode(labelled=False, candidates=candidates, root=root, **truth))
    dots = [[each for each in axes.collections if isinstance(each, PathCollection)] for axes in figure.axes]
    first, second = ({tuple(color) for each in drawn for color in each.get_facecolor()} for drawn in dots)
    assert first.isdisjoint(second)


def test_many_rounds_are_cut_short_and_it_says_so():
    figure = draw_episode(long_episode(9))
    assert [title.partition(":")[0] for title in titles(figure)] == [f"Round {n}" for n in (1, 2, 3, 4, 5, 9)]
    assert "6 of 9 rounds" in " ".join(figure.get_suptitle().split())
    assert len(draw_episode(long_episode(4)).axes) == 4


def test_the_file_is_whole_and_of_the_kind_that_its_name_says(tmp_path):
    path = write_picture(small_episode(), tmp_path / "new" / "e.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(path.parent.iterdir()) == [path]
    assert write_picture(small_episode(), path.with_name("e.pdf")).read_bytes().startswith(b"%PDF")
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "e.png", tmp_path / "e.jpg"):
        with pytest.raises(ArgumentError, match=r"^path must"):
            write_picture(small_episode(), place)


pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")


def painted(frame, color):
    """Whether each half of a frame, the map of the detector and that of the truth, has pixels of a colour."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    height, width = frame.shape[:2]
    maps = np.abs(frame[: int(0.88 * height)].astype(int) - rgb).max(axis=-1) < 24  # without the legend
    return bool(maps[:, : width // 2].sum() > 20), bool(maps[:, width // 2 :].sum() > 20)


@pytest.fixture(scope="module")
def scenes():
    return list(list_scenes(small_episode(), 3))


def test_scenes_tell_the_game_in_order(scenes):
    first = [scene.phase for scene in scenes if scene.round == 1]
    assert first == [WATCH, WATCH, WATCH, NAME, VERDICT, REMERGE]
    assert [scene.phase for scene in scenes if scene.round == ROUNDS] == [WATCH, WATCH, WATCH, NAME, VERDICT, VERDICT]
    assert [scene.samples for scene in scenes[:3]] == [1, 11, SAMPLES]
    assert scenes[4].text == "2 candidates (1 head hit, 1 redundant), 1 head left"
    assert scenes[5].text.endswith(": 3")  # followers without a head
    assert "J = 2.083" in scenes[-1].text
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    assert REMERGE not in {scene.phase for scene in list_scenes(over, 3)}  # no follower has lost its head


def test_the_detector_is_not_shown_the_truth(scenes):
    """Hits are green and redundant candidates orange on the map of the truth, once the verdict is given."""
    painter = Painter(small_episode())
    for scene in scenes[2:6]:
        painter.draw(scene)
        frame = pixels_of(painter.figure)
        given = scene.phase == VERDICT
        assert painted(frame, HIT) == painted(frame, REDUNDANT) == (False, given)
        assert painted(frame, "#0072B2")[0] == (scene.phase in (NAME, VERDICT))


def test_an_intruder_is_drawn_where_it_is_at_that_time(scenes):
    record = small_episode(intruders=np.arange(SAMPLES)[:, None, None] * np.ones((ROUNDS, 1, 1, 3)))
    assert [describe_frame(record, scene)["intruders"][-1, 0, 0] for scene in scenes[:3]] == [0, 10, SAMPLES - 1]


def test_where_the_truth_is_unknown_no_verdict_is_given():
    record = small_episode(labelled=False, over_budget=[True, True], alive=np.ones((ROUNDS, UAVS), bool))
    shown = list(list_scenes(record, 2))
    assert [scene.phase for scene in shown] == [WATCH, WATCH, NAME] * ROUNDS + [NAME]
    assert shown[2].text == "it names 2 leaders"
    painter = Painter(record)
    for scene in shown[1:3]:
        painter.draw(scene)
        assert painted(pixels_of(painter.figure), "#332288") == (False, scene.phase == NAME)  # of the first leader


@pytest.mark.slow
def test_a_gif_has_each_scene_with_its_duration(tmp_path, scenes):
    path = animate(small_episode(), tmp_path / "game.gif", frames=3)
    with Image.open(path) as image:
        durations = []
        for number in range(image.n_frames):
            image.seek(number)
            durations.append(image.info["duration"])
    assert sum(durations) == pytest.approx(1000 * sum((0.5, 2.0, 2.5, 2.0)[scene.phase] for scene in scenes))
    assert len(durations) >= 8
    assert [file.name for file in tmp_path.iterdir()] == ["game.gif"]


@pytest.mark.slow
def test_an_mp4_is_written(tmp_path):
    pytest.importorskip("imageio_ffmpeg")  # of the extra render, which brings ffmpeg
    assert animate(large_episode(), tmp_path / "game.mp4", frames=2).read_bytes()[4:8] == b"ftyp"


def test_what_cannot_be_written_is_refused_before(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("game.png", "game.mp4"):  # without ffmpeg
        with pytest.raises(ArgumentError, match=r"path must end in \.gif"):
            animate(small_episode(), tmp_path / name)
    with pytest.raises(ArgumentError, match="frames must be"):
        animate(small_episode(), tmp_path / "game.gif", frames=1)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    return write_page(small_episode(), path)


def read_words(text):
    text = re.sub("<script.*?</script>|<style.*?</style>", "", text, flags=re.DOTALL)
    return html.unescape(re.sub("<[^>]*>", " ", text))


def test_the_page_holds_everything_and_loads_nothing(page):
    text = page.read_text()
    assert not re.findall(r"""(?:src|href)=""", text)
    assert "http" not in re.sub("base64,[^'\"]*", "", text)
    assert len(re.findall("data:image/png;base64", text)) == 12
    words = " ".join(read_words(text).split())
    assert "2 of 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083" in words
    assert "UAV 3 redundant, p 0.10, score" in words
    assert "Adds 2 nats." in words
    assert "Round 2: 1 candidate (1 head hit, 0 redundant), 0 heads left" in words
    assert "<title>by hand on USNET/MultiCluster-v0, seed 0</title>" in text
    assert page.stat().st_size < 2_000_000


def test_a_button_of_each_round_goes_to_its_first_frame(page):
    found = re.findall(r"(anim\w+)\.set_frame\((\d+)\); return", page.read_text())
    assert [number for _, number in found] == ["0", "6"]
    assert f"{found[0][0]} = new Animation" in page.read_text()


def test_a_uav_is_named_where_it_is_drawn(page, scenes):
    names, frames = re.search("const names = (.*), frames = (.*);", page.read_text()).groups()
    assert json.loads(names) == [f"UAV {i}" for i in range(UAVS)]
    painter = Painter(small_episode())
    painter.draw(scenes[0])
    picture = pixels_of(painter.figure)
    place = np.array(json.loads(frames)[0])
    column, up = (place[np.isfinite(place[:, 0])] * (picture.shape[1], picture.shape[0])).astype(int).T
    assert len(column) > 0
    assert (picture[len(picture) - 1 - up, column] < 200).all()  # a grey dot


def test_a_page_of_many_windows_animates_the_first_and_names_cannot_break_it(tmp_path, monkeypatch):
    monkeypatch.setattr("usnet_env.replay.page._MAX_ROUNDS", 1)
    about = {"detector": "<b>&amp;</script>", "config": {"ids": ["<!--<script>"] * UAVS}}
    record = small_episode(**about, **dict.fromkeys(MIND))
    text = write_page(record, tmp_path / "x.html").read_text()
    assert "<!--" not in text
    assert json.loads(re.search("const names = (.*), frames", text)[1]) == ["<!--<script>"] * UAVS
    assert "<title>&lt;b&gt;&amp;amp;&lt;/script&gt; on" in text
    assert "The animation shows the first 1 window." in text


def test_a_page_of_recorded_tracks_says_what_is_true_of_them(tmp_path):
    """bird-0 flies ahead, and three others fly its way later."""
    at = np.cumsum(np.cumsum(np.random.default_rng(1).normal(0, 0.1, (200, 2)), axis=0), axis=0)
    rows = [f"bird-{i},{t},{at[t - 2 * i, 0]},{at[t - 2 * i, 1] + i},bird-0" for i in range(4) for t in range(10, 100)]
    (tmp_path / "birds.csv").write_text("\n".join(["id,t,x,y,leader", *rows]))
    env = gym.make("USNET/Tracks-v0", path=tmp_path / "birds.csv", step=1.0, window=40)
    record = record_episode(env, make_detector("destroy-all"), 0, 1)
    words = read_words(write_page(record, tmp_path / "birds.html").read_text())
    assert "1 of 1 head found in 1 window with 3 redundant candidates: F1 = 0.400 (1 is best)" in words
    assert "bird-0" in words
    assert not re.search(r"\bUAVs?\b|destroyed|\bJ\b|[Rr]ound", words)
