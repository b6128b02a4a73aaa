"""Named parts of every kind: found by name, declared by installed packages, registered by programs, and labelled."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import detectors.clustering  # noqa: F401  # it creates a registry
from usnet_env import ArgumentError, parts
from usnet_env.envs import MultiClusterEnv
from usnet_env.parts import REGISTRIES, Registry, format_label, parse_label


def check_number(value, subject="part"):
    if not isinstance(value, int):
        raise ArgumentError(f"{subject} must be a whole number, got {value!r}.")
    return value


@pytest.fixture
def numbers(monkeypatch):
    monkeypatch.setattr(parts, "REGISTRIES", {})
    return Registry("number", "size", "usnet.numbers", __name__, check_number, {"one": 1}, reserved=("none",))


def test_parts_are_found_by_name_in_order_of_their_origin(numbers, declare):
    declare("usnet.numbers", top="sys:maxsize", one="sys:maxsize", none="sys:maxsize")
    numbers.register("two", 2)
    assert list(numbers) == ["one", "top", "two"]
    assert (len(numbers), "top" in numbers, "none" in numbers, None in numbers) == (3, True, False, False)
    assert (numbers["one"], numbers.find("two")) == (1, 2)
    assert numbers.find("top") == numbers["top"] > 10**9
    with pytest.raises(ArgumentError, match=r"^size must be one of none, one, top, two, got 'tow' \(did you mean 'two"):
        numbers.find("tow")
    with pytest.raises(KeyError):
        numbers["three"]


def test_a_name_is_taken_once(numbers, declare):
    declare("usnet.numbers", top="sys:maxsize")
    numbers.register("two", 2)
    numbers.register("two", 2)
    numbers.register("one", 1)  # the same part again changes nothing
    for name in ("one", "two", "top"):
        with pytest.raises(ArgumentError, match=rf"^name must be a new one, got '{name}'"):
            numbers.register(name, 22)
    numbers.register("two", 22, replace=True)
    assert (numbers["two"], numbers["one"]) == (22, 1)
    with pytest.raises(ArgumentError, match=r"^name must be a new one, got 'one', which is the name of an installed"):
        numbers.register("one", 22, replace=True)
    with pytest.raises(ArgumentError, match=r"^number must be a whole number"):
        numbers.register("half", 0.5)


@pytest.mark.parametrize("name", ["", " ", "a b", "a:b", "a(b)", "-a", "none", None, 3])
def test_a_name_that_cannot_be_selected_is_refused(numbers, name):
    with pytest.raises(ArgumentError, match=r"^name must consist of letters"):
        numbers.register(name, 2)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_module:x", "number 'odd' can't be loaded: ModuleNotFoundError: No module named 'no_such_module'"),
        ("sys:nothing", "number 'odd' can't be loaded: AttributeError"),
        ("sys:path", "number 'odd' must be a whole number"),
        ("torch.nothing_of_this_name:x", r"number 'odd' needs torch; `pip install 'usnet\[torch\]'` installs it"),
    ],
)
def test_what_cannot_be_loaded_says_why(numbers, declare, value, reason):
    declare("usnet.numbers", odd=value)
    with pytest.raises((ArgumentError, ImportError), match=rf"^{reason}"):
        numbers.find("odd")


SOURCE = """
import numpy as np
from detectors.clustering import KMeans as Groups
from usnet_env.swarm.follow import LaggedSum
from usnet_env.swarm.mobility import CompiledMobility

class Backwards(LaggedSum):
    kappa = -1.0

onwards = CompiledMobility(5, 1)
corner = lambda rng, roles: np.zeros((len(roles.root), 3))
"""
STRANGERS = {"follow strategy": "Backwards", "mobility": "onwards", "formation": "corner", "clusterer": "Groups"}


def test_an_installed_package_declares_parts_of_every_kind(monkeypatch, declare):
    for kind, name in STRANGERS.items():
        registry = REGISTRIES[kind]
        declare(registry.group, ("strangers_parts", SOURCE), strange=f"strangers_parts:{name}")
        monkeypatch.setattr(registry, "_loaded", {})
        assert "strange" in registry
        assert registry.find("strange") is registry["strange"]
    env = MultiClusterEnv(follow="strange", mobility="strange", formation="strange")
    env.reset(seed=0)


LITERALS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()


@given(
    st.dictionaries(
        st.sampled_from(["clusters", "ridge", "table"]),
        LITERALS | st.lists(LITERALS | st.dictionaries(st.text(max_size=3), LITERALS, max_size=2), max_size=3),
    )
)
def test_a_label_of_literals_is_read_as_what_it_was_made_of(arguments):
    assert parse_label(format_label("a-name", arguments), {}) == ("a-name", arguments)


@pytest.mark.parametrize(
    "inner",
    [
        "", "count=1", "count=1))", "3)", "*[1])", "**{'count': 1})", "count=1, count=2)", "count=one)",
        "count=__import__('os').getpid())", "count=1)(2)", "count=1).x", "count=1\x00)", "(" * 5000 + ")" * 5000 + ")",
    ],
)  # fmt: skip
def test_brackets_take_literals_only(inner):
    with pytest.raises(ArgumentError, match=r"^detector must be written name\(argument=value, \.\.\.\) with Python"):
        parse_label(f"random({inner}", {})


def test_an_argument_is_given_once_and_a_name_is_a_text():
    assert parse_label(" random ( count = 1 )", {"scale": 2}) == ("random", {"count": 1, "scale": 2})
    with pytest.raises(ArgumentError, match=r"^count must be given once"):
        parse_label("random(count=1)", {"count": 1})
    for name in ("", " ", None, 3):
        with pytest.raises(ArgumentError, match=r"^detector must be a name"):
            parse_label(name, {})
