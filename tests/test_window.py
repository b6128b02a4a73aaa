import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp

from usnet_env import ArgumentError, Window


def parts(instants=4, uavs=3, **changes):
    rng = np.random.default_rng(0)
    values = {
        "position": rng.normal(size=(instants, uavs, 3)),
        "velocity": rng.normal(size=(instants - 1, uavs, 3)),
        "seen": np.ones((instants, uavs), np.int8),
        "alive": np.ones(uavs, np.int8),
        "round": 1,
    }
    return {**values, **changes}


def test_fields_sizes_and_types():
    window = Window(**parts(instants=6, uavs=5, round=np.int64(3)))
    assert (window.uavs, window.observation_steps, window.round) == (5, 5, 3)
    assert type(window.round) is int
    names, types = ("position", "velocity", "seen", "alive"), [np.float32, np.float32, bool, bool]
    assert [getattr(window, name).dtype for name in names] == types


def test_arrays_are_read_only_copies():
    given_parts = parts()
    window = Window(**given_parts)
    for name in ("position", "velocity", "seen", "alive"):
        array = getattr(window, name)
        before = array.copy()
        given_parts[name][:] = 0
        assert np.array_equal(array, before)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        window.round = 2


@pytest.mark.parametrize("value", [None, "first", 1.5, np.nan, [1, 2], np.zeros(0), 0])
def test_a_bad_round_of_an_observation_is_named(value):
    with pytest.raises(ArgumentError, match=r"^round must be a whole number from 1, got .*\.$"):
        Window.from_observation(parts(round=value))


@given(hnp.arrays(bool, (5, 4)), hnp.arrays(bool, 4))
def test_a_velocity_is_seen_where_both_its_ends_are_and_the_uav_lives(seen, alive):
    window = Window(**parts(instants=5, uavs=4, seen=seen, alive=alive))
    for t in range(4):
        for i in range(4):
            assert window.velocity_seen[t, i] == (seen[t, i] and seen[t + 1, i] and alive[i])


def test_from_observation_is_the_window_that_the_observation_holds():
    whole = parts(6, 5, round=np.array([3], np.float32), step=np.float32([0.5]))
    window = Window.from_observation(whole)
    for name in ("position", "velocity"):
        np.testing.assert_array_equal(getattr(window, name), whole[name].astype(np.float32))
    assert (window.round, window.step) == (3, 0.5)
    assert Window.from_observation(parts()).step is None


@pytest.mark.parametrize("key", ["position", "velocity", "seen", "alive", "round"])
def test_an_observation_without_a_key_is_refused(key):
    observation = parts()
    del observation[key]
    for value in (observation, None, [1, 2]):
        with pytest.raises(ArgumentError, match=r"^observation must be a mapping with the keys position, .*, got "):
            Window.from_observation(value)


class NeedsGradient:
    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")  # as torch does


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("position", NeedsGradient()),
        ("position", np.zeros((4, 3, 2))),
        ("position", np.zeros((1, 3, 3))),
        ("position", np.zeros((4, 0, 3))),
        ("position", np.full((4, 3, 3), np.nan)),
        ("position", [[1], [1, 2]]),
        ("position", None),
        ("position", np.ma.masked_equal(np.arange(36.0).reshape(4, 3, 3), 3.0)),
        ("position", np.zeros((4, 3, 3), complex)),
        ("position", np.full((4, 3, 3), 1e39)),
        ("velocity", np.full((3, 3, 3), -1e300)),
        ("velocity", np.zeros((4, 3, 3))),
        ("seen", np.ones((3, 3))),
        ("seen", np.full((4, 3), 2)),
        ("seen", np.full((4, 3), np.nan)),
        ("alive", np.ones(2)),
        ("round", 0),
        ("round", True),
    ],
)
def test_a_bad_part_is_refused_in_one_sentence_that_names_it(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must .*, got .*[^.]\.$") as caught:
        Window(**parts(**{name: value}))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("step", [0, np.nan, "a second", [1, 2]])
def test_a_bad_step_is_named(step):
    for make in (lambda: Window(**parts(step=step)), lambda: Window.from_observation(parts(step=step))):
        with pytest.raises(ArgumentError, match=r"^step must be .*, got .*\.$"):
            make()
