"""The figures of attention: what they show is what the detector answered."""

import numpy as np
import pytest

from detectors.studies import attention
from usnet_env import ArgumentError, Detection

UAVS, HEAD = 5, 1


@pytest.fixture(scope="module")
def scene():
    return attention.find_scene("f1", UAVS - 1, HEAD, 0)


def answer(attention_weights, candidates=(HEAD,), **extras):
    named = np.isin(np.arange(UAVS), candidates)
    return Detection(named, attention_weights.sum(axis=0), attention=attention_weights, extras=extras)


@pytest.fixture
def found():
    """All UAVs attend to the head, but UAV 4 attends to UAV 2 most."""
    weights = np.full((UAVS, UAVS), 0.01)
    weights[:, HEAD] = 0.9
    weights[4, 2] = 0.95
    heads = np.stack([weights / number for number in range(1, 6)])
    return answer(weights, attention_heads=heads)


def heat_maps(figure):
    return [axes for axes in figure.axes if axes.images and axes.get_title()]


def test_scenes_have_their_head_where_the_figure_has_it():
    scene = attention.find_scene("f1", 5, 3, 0)
    assert scene.window.uavs == 6
    assert attention.find_scene("f1", 5, 3, scene.seed).seed == scene.seed
    with pytest.raises(ArgumentError, match="head must be an index from 0 to 5, got 6"):
        attention.find_scene("f1", 5, 6, 0)


def test_a_detector_without_attention_is_refused(scene):
    with pytest.raises(ArgumentError, match=r"detector must answer with attention, got 'random'"):
        attention.detect_head(scene, "random")


def test_a_detector_with_attention_answers_the_scene(scene):
    assert attention.detect_head(scene, "lagged-regression(clusters=1)").attention.shape == (UAVS, UAVS)


def test_heat_maps_show_alpha_and_every_attention_head(scene, found):
    panels = heat_maps(attention.draw_attention_heads(scene, found, "gassl"))
    assert [panel.get_title() for panel in panels] == [
        "attention weights α",
        "attention head 1: velocity at t",
        "attention head 2: velocity at t − 1",
        "attention head 3: velocity at t − 2",
        "attention head 4: velocity at t − 3",
        "attention head 5: position at t − 3",
    ]
    np.testing.assert_array_equal(panels[0].images[0].get_array(), found.attention)
    np.testing.assert_array_equal(panels[5].images[0].get_array(), found.extras["attention_heads"][4])
    assert {(panel.get_xlabel(), panel.get_ylabel()) for panel in panels} == {("UAV i′", "UAV i")}


def test_heat_maps_need_attention_heads(scene, found):
    with pytest.raises(ArgumentError, match="attention heads, got 'x'"):
        attention.draw_attention_heads(scene, answer(found.attention), "x")


def test_sizes_have_a_panel_and_a_colour_bar_each(scene, found):
    figure = attention.draw_attention_sizes([scene] * 4, [found] * 3 + [answer(found.attention, [0])], "gassl")
    panels = heat_maps(figure)
    assert [panel.get_title() for panel in panels] == ["m = 4: head found"] * 3 + ["m = 4: head missed"]
    assert sum(bool(axes.get_label() == "<colorbar>") for axes in figure.axes) == 4


def test_the_hierarchy_is_derived_from_the_attention(scene, found):
    assert attention.list_leaders(found.attention).tolist() == [1, 0, 1, 1, 2]
    assert attention.list_leaders(np.eye(UAVS)).tolist() == [-1] * UAVS
    graph, tree = attention.draw_hierarchy(scene, found, "gassl").axes
    shown = (found.attention > 0.02) & ~np.eye(UAVS, dtype=bool)
    lines = graph.collections[0]
    assert len(lines.get_segments()) == shown.sum()
    np.testing.assert_allclose(lines.get_linewidths(), 5.0 * found.attention[shown])
    links = [line for line in tree.lines if len(line.get_xdata())]
    assert len(links) == 3  # UAVs 0, 2 and 3 link to the candidate; UAV 4 to another UAV, by a dashed arc
    assert "link to another UAV" in [text.get_text() for text in tree.get_figure().legends[0].get_texts()]


def test_lines_are_as_wide_as_the_weights_say(scene, found):
    graph = attention.draw_hierarchy(scene, answer(found.attention / 2), "gassl").axes[0]
    assert max(graph.collections[0].get_linewidths()) == pytest.approx(5.0 * 0.95 / 2)
