"""A run that is resumed has the code that it began with, however its detectors and parts are given."""

from __future__ import annotations

import subprocess
import sys
import types

import numpy as np
import pytest

from usnet_env import ArgumentError, evaluate, register_detector, register_follow_strategy
from usnet_env.parts import REGISTRIES

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 3}

HELPER = """
import numpy as np
LIMIT = 0.5
def unused(): return 1
def choose(scores): return scores > LIMIT
"""
DETECTOR = """
from usnet_env import Detection
import numpy as np
from code_helper import choose

class Base:
    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)

class Edited(Base):
    clusters = 3

    def detect(self, window):
        scores = self.rng.random(window.uavs)
        return Detection(choose(scores) & window.alive, scores)

class Other(Base):
    def detect(self, window):
        return Detection(window.alive, window.alive)

if __name__ == "__main__":
    print("not a part of it")
"""

EDITS = {
    "method": ("code_detector", "choose(scores) &", "(scores > 0.9) &"),
    "attribute": ("code_detector", "clusters = 3", "clusters = 4"),
    "base": ("code_detector", "default_rng(seed)", "default_rng(1)"),
    "constant of another module": ("code_helper", "0.5", "0.7"),
    "function of another module": ("code_helper", "scores > LIMIT", "scores < LIMIT"),
    "change from outside": ("code_detector", "\nclass Other", "Edited.clusters = 5\nclass Other"),
}
HARMLESS = {
    "comment": ("code_detector", "clusters = 3", "clusters = 3  # three"),
    "another class": ("code_detector", "Detection(window.alive, window.alive)", "None"),
    "another function": ("code_helper", "return 1", "return 2"),
    "main block": ("code_detector", "not a part", "no part"),
}
WAYS = {
    "name": lambda: "code_detector:Edited",
    "object": lambda: __import__("code_detector").Edited(),
    "registered name": lambda: "code-edited",
}


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Writes two modules, and forgets what this process has imported of them when one is edited."""
    monkeypatch.syspath_prepend(tmp_path)

    def forget():
        for name in ("code_detector", "code_helper"):
            sys.modules.pop(name, None)
        REGISTRIES["detector"]._registered.pop("code-edited", None)

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        forget()

    def edit(name, old, new):
        text = (tmp_path / f"{name}.py").read_text()
        assert old in text
        write(name, text.replace(old, new))

    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # two edits in one second have the same time stamp
    write("code_helper", HELPER)
    write("code_detector", DETECTOR)
    yield edit
    forget()


def play(way, out, **more):
    if way == "registered name":
        register_detector("code-edited", __import__("code_detector").Edited, replace=True)
    how = {"episodes": 1, "env_kwargs": SMALL, "out": out} | more
    return evaluate(MULTI, {"mine": WAYS[way]()}, **how)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("edit", EDITS)
def test_edited_code_is_refused(modules, tmp_path, way, edit):
    play(way, tmp_path / "run")
    play(way, tmp_path / "run")
    modules(*EDITS[edit])
    with pytest.raises(ArgumentError, match=r"^out must be .* with a run in which detector 'mine' has other code.*\.$"):
        play(way, tmp_path / "run", episodes=2)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("edit", HARMLESS)
def test_what_a_detector_does_not_use_may_be_edited(modules, tmp_path, way, edit):
    play(way, tmp_path / "run")
    modules(*HARMLESS[edit])
    assert len(play(way, tmp_path / "run", episodes=2).rows) == 2


def test_an_isolated_run_refuses_edited_code_without_loading_it(modules, tmp_path):
    play("name", tmp_path / "run", isolate=True)
    play("name", tmp_path / "run", isolate=True, episodes=2)
    assert "code_detector" not in sys.modules
    modules(*EDITS["function of another module"])
    with pytest.raises(ArgumentError, match=r"has other code of detector 'code_detector:Edited'\.$"):
        play("name", tmp_path / "run", isolate=True, episodes=3)
    assert "code_detector" not in sys.modules


def test_the_code_of_the_main_script_is_compared_without_the_call_itself(tmp_path):
    script = tmp_path / "script.py"
    text = DETECTOR.replace("from code_helper import choose", "choose = lambda scores: scores > 0.5").replace(
        'print("not a part of it")',
        f"import usnet_env\n    r = usnet_env.evaluate({MULTI!r}, Edited(), episodes=2, env_kwargs={SMALL}, out='run', "
        "workers=2)\n    print(len(r.rows))",
    )

    def run(text):
        script.write_text(text)
        return subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)

    assert run(text).stdout == "2\n"
    assert run(text.replace("episodes=2", "episodes=3")).stdout == "3\n"
    assert "'Edited' has other code." in run(text.replace("scores > 0.5", "scores > 0.6")).stderr


def test_the_code_of_a_notebook_is_compared(tmp_path, monkeypatch):
    notebook = types.ModuleType("code_notebook")  # it has no file
    monkeypatch.setitem(sys.modules, "code_notebook", notebook)
    cells = DETECTOR.replace("from code_helper import choose", HELPER)

    def run(text, episodes):
        exec(compile(text, "<cell>", "exec"), vars(notebook))
        asked = {"episodes": episodes, "env_kwargs": SMALL, "out": tmp_path}
        return len(evaluate(MULTI, notebook.Edited(), **asked).rows)

    assert run(cells, 1) == 1
    assert run("\n\n" + cells.replace("return 1", "return 2"), 2) == 2
    for old, new in (("0.5", "0.6"), ("choose(scores) &", "(scores > 0.9) &"), ("default_rng(seed)", "default_rng(1)")):
        with pytest.raises(ArgumentError, match=r"'Edited' has other code\.$"):
            run(cells.replace(old, new), 3)


def test_a_follow_strategy_that_is_replaced_is_refused(tmp_path):
    def run(function, episodes):
        register_follow_strategy("code-turn", function, lags=1, replace=True)
        how = {"episodes": episodes, "env_kwargs": SMALL | {"follow": "code-turn"}, "out": tmp_path}
        return evaluate(MULTI, "none", **how)

    run(lambda inputs: inputs.head_velocity[:, 0], 1)
    run(lambda inputs: inputs.head_velocity[:, 0], 2)
    with pytest.raises(ArgumentError, match=r"with a run with other code of follow strategy 'code-turn'\.$"):
        run(lambda inputs: -np.asarray(inputs.head_velocity[:, 0]), 3)


def test_runs_of_detectors_of_this_package_hold_their_names_only(tmp_path):
    config = evaluate(MULTI, ["random", "lagged-regression"], episodes=1, env_kwargs=SMALL, out=tmp_path).config
    assert config["identities"] == ["random", "lagged-regression"]
    assert "code" not in config
