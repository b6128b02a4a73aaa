import importlib.metadata
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import usnet_env.envs
from usnet_env import ArgumentError, Detection, plugins, registry
from usnet_env.cli import main
from usnet_env.detection import read_tags
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.sensors import PLACEMENTS, register_placement
from usnet_env.plugins import (
    DetectorLike,
    describe_detectors,
    detector_label,
    detector_names,
    list_detectors,
    make_detector,
    register_detector,
)
from usnet_env.swarm.formation import FORMATIONS, register_formation

BUILT_IN = ["destroy-all", "lagged-correlation", "lagged-regression", "none", "one-per-round", "random"]


class Mine:
    """Names the first few.

    More about it.
    """

    def __init__(self, count=2, *, table=()):
        self.count = count
        self.table = table

    def reset(self, seed=None):
        pass

    def detect(self, window):
        candidates = np.arange(window.uavs) < self.count
        return Detection(candidates, candidates)

    class Inner:
        def reset(self, seed=None):
            pass

        def detect(self, window):
            return Detection(window.alive, window.alive)


class NeedsOne(Mine):
    def __init__(self, count):
        super().__init__(count)


class Refuses(Mine):
    def __init__(self, count=1):
        raise ZeroDivisionError("division\nby zero.")


class RefusesClearly(Mine):
    def __init__(self, count=1):
        raise ArgumentError("count must be odd, got 1.")


class Lacking:
    def detect(self, window):
        return None


class Unhashable(Mine):
    __hash__ = None


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    monkeypatch.setattr(plugins.DETECTORS, "_registered", {})


@pytest.fixture
def installed(monkeypatch):
    """Adds entry points as other distributions would."""

    def add(*points):
        real = importlib.metadata.entry_points
        extra = [importlib.metadata.EntryPoint(name, value, plugins.DETECTORS.group) for name, value in points]
        monkeypatch.setattr(registry, "entry_points", lambda group: [*extra, *real(group=group)])

    return add


def test_the_built_in_detectors_are_found_and_made():
    assert set(BUILT_IN) <= set(detector_names())
    for name in BUILT_IN:
        detector = make_detector(name)
        assert isinstance(detector, DetectorLike)
        assert detector_label(detector) == name
        detector.reset(0)


def test_names_are_listed_without_importing_any_detector(fresh_process):
    code = (
        "import sys, usnet_env.plugins as p; names = p.detector_names(); "
        "assert 'lagged-regression' in names; assert 'detectors' not in sys.modules"
    )
    fresh_process.run(code)


def test_every_built_in_detector_has_a_line():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a detector whose extra is not installed says so
        lines = describe_detectors()
    assert sorted(lines) == detector_names()
    assert all(lines[name].endswith(".") and "\n" not in lines[name] for name in BUILT_IN)


def test_detectors_are_described_without_importing_any(fresh_process):
    code = (
        "import sys, usnet_env.plugins as p; entries = {entry.name: entry for entry in p.list_detectors()}; "
        "assert not {'detectors', 'torch'} & set(sys.modules), sorted(sys.modules); "
        "assert entries['gassl'].needs == ('torch',), entries['gassl']; "
        "assert entries['random'].needs == () and entries['random'].description.startswith('Names ')"
    )
    fresh_process.run(code)


def test_the_description_and_the_tags_from_the_source_are_those_of_the_class():
    for entry in list_detectors():
        if not entry.missing:
            detector = make_detector(entry.name)
            assert entry.description == (detector.__doc__ or "").partition("\n")[0]
            assert entry.tags == read_tags(detector)


def test_detectors_that_do_not_declare_torch_do_not_import_it(fresh_process):
    code = (
        "import sys, usnet_env.plugins as p; "
        "[p.make_detector(entry.name).reset(0) for entry in p.list_detectors() if not entry.needs]; "
        "assert 'torch' not in sys.modules"
    )
    fresh_process.run(code)


@pytest.mark.parametrize(
    ("tags", "answer"),
    [
        ("Tags(most_uavs=20, takes_clusters=True)", "(at most 20 UAVs; takes M)"),
        ("Tags(uses_positions=False, needs=('torch', 'no_such_package'))", "(needs torch, no_such_package: not"),
        ("make_tags()", ""),
        ("Tags(most_uavs=most)", ""),
    ],
)
def test_declared_tags_are_listed_without_an_import(installed, tmp_path, monkeypatch, capsys, tags, answer):
    source = f"class Tagged:\n    'Has tags.'\n    tags = {tags}\n"
    (tmp_path / "tagged_stranger.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    installed(("tagged", "tagged_stranger:Tagged"))
    assert main(["list", "detectors"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("tagged ")]
    assert f"Has tags. {answer}".rstrip() in line
    assert "tagged_stranger" not in sys.modules


def test_unknown_tags_are_refused(installed, tmp_path, monkeypatch):
    (tmp_path / "odd_stranger.py").write_text("class Odd:\n    tags = Tags(colour=3)\n")
    monkeypatch.syspath_prepend(tmp_path)
    installed(("odd", "odd_stranger:Odd"))
    with pytest.warns(UserWarning, match="detector 'odd' must declare known tags: .*colour"):
        assert describe_detectors()["odd"].startswith("not available")


PACKAGE = {
    "faraway/__init__.py": "from .middle import Near as Other\n",
    "faraway/middle.py": "import no_such_package_anywhere\nfrom faraway.inner.deep import Near\n",
    "faraway/inner/__init__.py": "import json\nimport scipy\n",
    "faraway/inner/base.py": "class Base:\n    tags = Tags(needs=('no_such_package_anywhere',), least_steps=7)\n",
    "faraway/inner/deep.py": '"""Not this."""\nfrom .base import Base\n\n'
    'class Near(Base):\n    """Found through three files.\n\n    M.\n    """\n',
}


def test_a_class_is_found_where_its_package_imports_it_from(installed, tmp_path, monkeypatch):
    for name, source in PACKAGE.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    installed(("reexported", "faraway:Other"))
    (entry,) = [entry for entry in list_detectors() if entry.name == "reexported"]
    assert entry.description == "Found through three files."
    assert entry.needs == entry.missing == ("no_such_package_anywhere",)
    assert entry.tags.least_steps == 7
    assert not [name for name in sys.modules if name.startswith("faraway")]


def test_arguments_in_brackets_beside_them_and_in_both():
    for detector in (
        make_detector("lagged-regression(clusters=5, ridge=-1e-3)"),
        make_detector("lagged-regression", clusters=5, ridge=-1e-3),
        make_detector(" lagged-regression ( ridge = -1e-3 )", clusters=5),
    ):
        assert detector.get_params() == {"clusters": 5, "lags": 4, "squares": True, "ridge": -1e-3}
    assert make_detector("random()").count == 1
    made = make_detector(f"{__name__}:Mine(count=3, table={{'a': [1, (2, None)]}})")
    assert type(made).__name__ == "Mine"
    assert (made.count, made.table) == (3, {"a": [1, (2, None)]})
    assert make_detector(f"{__name__}:Mine.Inner")


@pytest.mark.parametrize(
    "text",
    [
        "random(",
        "random(count=1",
        "random(count=1))",
        "random(3)",
        "random(*[1])",
        "random(**{'count': 1})",
        "random(count=1, count=2)",
        "random(count=one)",
        "random(count=1 + len('a'))",
        "random(count=__import__('os').getpid())",
        "random(count=1)(2)",
        "random(count=1) + f(1)",
        "random(count=1).x",
        "random(count=1\x00)",
        "random(" + "(" * 5000 + ")" * 5000 + ")",
        "random(count=" + "-" * 100_000 + "1)",
    ],
)
def test_brackets_take_literals_only(text):
    with pytest.raises(ArgumentError, match=r"^detector must be written name\(argument=value, \.\.\.\) with Python"):
        make_detector(text)


@settings(max_examples=40)
@given(st.text(max_size=30))
def test_any_text_gives_a_detector_or_one_sentence(text):
    for name in (text, f"random({text})", f"random{text}"):
        try:
            make_detector(name)
        except ArgumentError as error:
            sentence = str(error)
        else:
            continue
        assert "\n" not in sentence
        assert sentence.endswith(".")


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        (
            "lagged-regresion",
            {},
            r"detector must be one of .*lagged-regression.* \(did you mean 'lagged-regression'\?\)\.",
        ),
        ("", {}, r"detector must be a name, got ''\."),
        (None, {}, r"detector must be a name, got None\."),
        (
            "lagged-regression",
            {"cluster": 5},
            r"detector 'lagged-regression' has no argument 'cluster' \(did you mean 'clusters'\?\); "
            r"it takes clusters, lags, squares, ridge\.",
        ),
        ("none(x=1)", {}, r"detector 'none' has no argument 'x'; it takes no arguments\."),
        (
            "random(count=1)",
            {"count": 1},
            r"count must be given once, got it in 'random\(count=1\)' and as a further argument\.",
        ),
        ("no_such_module:X", {}, r"detector 'no_such_module:X' can't be loaded: ModuleNotFoundError: .*\."),
        ("math:nothing", {}, r"detector 'math:nothing' can't be loaded: AttributeError: .*\."),
        (".relative:X", {}, r"detector '\.relative:X' can't be loaded: .*\."),
        ("math:pi", {}, r"detector 'math:pi' must be a class or a function that returns a detector, got 3\.14.*\."),
        (
            f"{__name__}:Lacking",
            {},
            r"detector '.*:Lacking' must have the methods detect\(window\) and reset\(seed\).*",
        ),
        (f"{__name__}:NeedsOne", {}, r"detector '.*:NeedsOne' needs the argument 'count'; it takes count\."),
        (f"{__name__}:Refuses", {}, r"detector '.*' could not be made: ZeroDivisionError: division by zero\."),
        (f"{__name__}:RefusesClearly", {}, r"count must be odd, got 1\."),
    ],
)
def test_each_mistake_has_its_sentence(name, arguments, sentence):
    with pytest.raises(ArgumentError, match=f"^{sentence}$"):
        make_detector(name, **arguments)


def test_a_registered_detector_is_found_by_its_name():
    register_detector("mine", Mine)
    register_detector("mine", Mine)  # registering the same class twice is allowed
    register_detector("five", lambda extra=0: Mine(count=5))
    assert {"mine", "five"} <= set(detector_names())
    assert make_detector("mine(count=4)").count == 4
    assert make_detector("five(extra=1)").count == 5
    assert describe_detectors()["mine"] == "Names the first few."


def test_registering_what_cannot_be_used_is_refused():
    register_detector("mine", Mine)
    for name in ("mine", "random"):
        with pytest.raises(
            ArgumentError, match=rf"^name must be a new one.*, got '{name}', which is .* (already|inst)"
        ):
            register_detector(name, NeedsOne)
    for name in ("", "a b", "a:b", "a(b)", "-a", None, 3):
        with pytest.raises(ArgumentError, match=r"^name must consist of letters"):
            register_detector(name, Mine)
    with pytest.raises(ArgumentError, match=r"^factory must be a class or a function"):
        register_detector("other", Mine())
    with pytest.raises(ArgumentError, match=r"^replace must be true or false, got 'yes'"):
        register_detector("mine", Mine, replace="yes")


def test_a_notebook_may_register_a_new_class_under_the_same_name():
    register_detector("mine", Mine)
    register_detector("mine", NeedsOne, replace=True)
    assert type(make_detector("mine(count=1)")) is NeedsOne
    register_detector("fresh", Mine, replace=True)
    assert type(make_detector("fresh")) is Mine
    with pytest.raises(
        ArgumentError, match=r"^name must be a new one, got .random., which is the name of an installed"
    ):
        register_detector("random", Mine, replace=True)


def test_labels():
    register_detector("mine", Mine)
    register_detector("five", lambda extra=0: Mine.Inner())
    assert detector_label("lagged-regression", {"clusters": 5}) == "lagged-regression(clusters=5)"
    assert detector_label("lagged-regression( ridge=0.1,clusters=5 )") == "lagged-regression(clusters=5, ridge=0.1)"
    assert detector_label("random()") == "random"
    assert detector_label(make_detector("lagged-regression", clusters=5, lags=4)) == "lagged-regression(clusters=5)"
    assert detector_label(make_detector("detectors.lagged:OnePerRound")) == "one-per-round"
    assert detector_label(Mine(count=3)) == "mine(count=3)"
    assert detector_label(Mine(table=np.arange(3))) == "mine(table=array([0, 1, 2]))"
    assert detector_label(NeedsOne(7)) == "NeedsOne(count=7)"
    assert detector_label(Unhashable()) == "Unhashable"
    assert detector_label(make_detector("five(extra=2)")) == "five(extra=2)"
    with pytest.raises(ArgumentError, match=r"^arguments must be empty if detector is an object"):
        detector_label(Mine(), {"count": 3})


def test_a_label_makes_the_detector_again():
    for text in (
        "lagged-regression(clusters=5, squares=False)",
        "random(count=3)",
        "none",
        "lagged-correlation(max_lag=2)",
    ):
        assert detector_label(make_detector(text)) == text
        assert detector_label(make_detector(detector_label(text))) == text


def test_a_foreign_entry_point_is_found(installed):
    installed(("stranger", f"{__name__}:Mine"))
    assert "stranger" in detector_names()
    assert make_detector("stranger(count=9)").count == 9
    assert detector_label(make_detector("stranger(count=9)")) == "stranger(count=9)"
    with pytest.raises(ArgumentError, match="the name of an installed detector"):
        register_detector("stranger", NeedsOne)


def test_a_broken_foreign_detector_does_not_affect_others(installed, tmp_path, monkeypatch):
    (tmp_path / "broken_stranger.py").write_text("raise OSError('no\\nlicence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    installed(("broken", "broken_stranger:X"), ("stranger", f"{__name__}:Mine"))
    with pytest.warns(UserWarning, match="detector 'broken' can't be loaded: OSError: no licence"):
        lines = describe_detectors()
    assert lines["broken"].startswith("not available: ")
    assert lines["stranger"] == "Names the first few."
    assert lines["random"].startswith("Names living UAVs at random")
    assert make_detector("stranger")
    with pytest.raises(ArgumentError, match=r"^detector 'broken' can't be loaded: OSError: no licence\.$"):
        make_detector("broken")


def test_a_foreign_detector_cannot_take_a_name_of_this_package(installed):
    installed(("random", "a_stranger:Random"))
    with pytest.warns(UserWarning, match="detector 'random' of an unnamed distribution is ignored"):
        assert type(make_detector("random")).__name__ == "RandomDetector"


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import sys; sys.exit('no licence')", "SystemExit: no licence"),
        ("import nothing_of_that_name", "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("def broken(:", "SyntaxError: invalid syntax"),
        ("X = 3", "must be a class or a function that returns a detector, got 3"),
        ("", "AttributeError: .*has no attribute 'X'"),
    ],
)
def test_however_a_foreign_detector_fails_the_others_are_listed(installed, tmp_path, monkeypatch, source, reason):
    (tmp_path / "breaks.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "breaks", raising=False)
    installed(("broken", "breaks:X"), ("stranger", f"{__name__}:Mine"))
    with pytest.warns(UserWarning, match=f"detector 'broken' .*{reason}"):
        lines = describe_detectors()
    assert lines["broken"].startswith("not available: detector 'broken' ")
    assert lines["stranger"] == "Names the first few."
    assert set(BUILT_IN) <= set(lines)
    assert detector_label(make_detector("stranger")) == "stranger"
    with pytest.raises(ArgumentError, match=reason):
        make_detector("broken")


@pytest.mark.parametrize(("name", "value"), [("odd", "not a value!"), ("odd", ""), ("an odd name", "a:B")])
def test_a_malformed_entry_point_is_ignored(installed, name, value):
    installed((name, value), ("stranger", f"{__name__}:Mine"))
    with pytest.warns(UserWarning, match=f"detector '{name}' .* is ignored: an entry point must be written"):
        names = detector_names()
    assert "stranger" in names
    assert name not in names
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert detector_label(Unhashable()) == "Unhashable"


def test_distributions_without_metadata_are_accepted(monkeypatch):
    class Half:
        @property
        def name(self):
            raise KeyError("Name")

    class Nameless:
        name = None

    real = list(importlib.metadata.entry_points(group=plugins.DETECTORS.group))
    extra = []
    for number, distribution in enumerate((Half(), Nameless())):
        point = importlib.metadata.EntryPoint(f"half-{number}", f"{__name__}:Mine", plugins.DETECTORS.group)
        vars(point).update(dist=distribution)
        extra.append(point)
    monkeypatch.setattr(registry, "entry_points", lambda group: [*extra, *real])
    assert {"half-0", "half-1", *BUILT_IN} <= set(detector_names())
    assert make_detector("half-1(count=3)").count == 3


def test_all_three_ways_end_in_one_registry(installed):
    installed(("by-entry-point", f"{__name__}:Mine"))
    register_detector("by-hand", NeedsOne)
    made = [make_detector(name, count=3) for name in ("by-entry-point", "by-hand", f"{__name__}:Mine")]
    assert [type(detector).__name__ for detector in made] == ["Mine", "NeedsOne", "Mine"]
    assert [detector_label(detector) for detector in made] == [
        "by-entry-point(count=3)",
        "by-hand(count=3)",
        "by-entry-point(count=3)",
    ]


def test_an_installed_package_declares_parts_of_every_kind(monkeypatch, tmp_path):
    source = """
import numpy as np
from detectors.clustering import KMeans as Groups
from usnet_env.multiagent import Fusion
from usnet_env.swarm.follow import Lags
from usnet_env.swarm.mobility import CompiledMobility

class Backwards(Lags):
    kappa = -1.0

onwards = CompiledMobility(5, 1)
corner = lambda rng, roles: np.zeros((len(roles.root), 3))
middle = lambda rng, observers: np.full((observers, 3), 500.0)
both = Fusion("candidates", lambda votes, seen: votes.all(axis=0))
"""
    (tmp_path / "strangers_parts.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    names = {
        "follow strategy": "Backwards",
        "mobility": "onwards",
        "formation": "corner",
        "placement": "middle",
        "fusion rule": "both",
        "clusterer": "Groups",
    }
    groups = {registry.REGISTRIES[kind].group: f"strangers_parts:{name}" for kind, name in names.items()}

    def entry_points(group):
        value = groups.get(group)
        return [importlib.metadata.EntryPoint("strange", value, group)] if value else []

    monkeypatch.setattr(registry, "entry_points", entry_points)
    for kind in names:
        parts = registry.REGISTRIES[kind]
        assert "strange" in parts
        assert parts.find("strange") is parts["strange"]
        with pytest.raises(ArgumentError, match=f"the name of an installed {kind}"):
            parts.register("strange", next(iter(parts.values())))
        parts._loaded.clear()
    env = usnet_env.envs.MultiClusterEnv(follow="strange", mobility="strange", formation="strange")
    env.reset(seed=0)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [importlib.metadata.EntryPoint("odd", "math:pi", group)]
    )
    for kind in names:
        with pytest.raises(ArgumentError, match=rf"^{kind} 'odd' must be a .*, got 3\.14"):
            registry.REGISTRIES[kind].find("odd")


def test_a_formation_and_a_placement_can_be_registered(monkeypatch):
    monkeypatch.setattr(FORMATIONS, "_registered", {})
    monkeypatch.setattr(PLACEMENTS, "_registered", {})
    register_formation("line", lambda rng, roles: np.arange(len(roles.root))[:, None] * np.ones(3))
    register_placement("origin", lambda rng, observers: np.zeros((observers, 3)))
    env = usnet_env.envs.MultiClusterEnv(formation="line", clusters=2, uavs=9)
    env.reset(seed=0)
    game = usnet_observers_v0.parallel_env(placement="origin", clusters=2, uavs=9)
    observations, _ = game.reset(seed=0)
    assert not observations["observer_3"]["place"].any()
    for place, sentence in (
        (np.zeros(3), "return an array of shape"),
        (np.full((9, 3), np.nan), "return"),
    ):
        register_formation("bad", lambda rng, roles, place=place: place, replace=True)
        with pytest.raises(ArgumentError, match=f"formation function must {sentence}"):
            usnet_env.envs.MultiClusterEnv(formation="bad", clusters=2, uavs=9).reset(seed=0)
    for register in (register_formation, register_placement):
        with pytest.raises(ArgumentError, match="function must be a function"):
            register("worse", 3)
