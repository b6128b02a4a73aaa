"""What the packages promise to whoever installs them: few imports, no side effects, arrows that point down."""

import hashlib
import re
import tomllib
from importlib.metadata import EntryPoint
from importlib.resources import files
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def test_the_core_works_without_any_extra(fresh_process, tmp_path):
    rows = [f"{i},{t},{t + i},{i}\n" for t in range(150) for i in (1, 2)]
    (tmp_path / "tracks.csv").write_text("".join(["id,t,x,y\n", *rows]))
    said = fresh_process.run(
        """
import importlib.util, sys
from importlib.abc import MetaPathFinder

EXTRAS = {"matplotlib", "moviepy", "rerun", "pyarrow", "torch", "stable_baselines3", "pettingzoo", "ray", "pytest"}

class NoExtras(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"{name} is an extra", name=name)

sys.meta_path.insert(0, NoExtras())
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in EXTRAS else found(name, *rest)
sys.stderr = sys.stdout

import gymnasium as gym
import numpy as np
import usnet_env
from usnet_env.envs.wrappers import BoxMasks
from usnet_env.plugins import DETECTORS

swarm = {"clusters": 2, "uavs": 8, "observation_steps": 40}
env = BoxMasks(gym.make("USNET/MultiCluster-v0", **swarm))
env.reset(seed=0)
env.step(np.eye(1, 8, dtype=np.int8)[0])
assert {"gassl", "mc-gassl", "lagged-regression"} <= set(DETECTORS)
detectors = ["lagged-regression(clusters=2)", "destroy-all", "reader", "gassl(steps=0)"]
result = usnet_env.evaluate("USNET/MultiCluster-v0", detectors, episodes=2, env_kwargs=swarm)
assert [entry["episodes"] for entry in result.summary] == [2] * 4
assert result.summary[1]["metrics"]["J"]["mean"] == 1.75
assert not EXTRAS & set(sys.modules)
from usnet_env.cli import main
assert main(["list", "detectors"]) == 0
for words in (["evaluate", "--episodes", "1"], ["detect", "tracks.csv"]):
    assert main([*words, "--detector", "mc-gassl"]) == 2, words
import usnet_env.multiagent
try:
    import usnet_env.multiagent.usnet_evasion_v0
except ImportError as error:
    print(error)
""",
        tmp_path,
    )
    advice = "detector 'mc-gassl' needs torch; `pip install 'usnet[torch]'` installs it."
    assert f"not available: {advice}" in said
    games = "Games with several agents need PettingZoo; `pip install 'usnet[multiagent]'` installs it."
    assert said.endswith(f"usnet: {advice}\n" * 2 + f"{games}\n")


def test_an_import_changes_nothing_global(fresh_process):
    fresh_process.run("""
import os, random, sys, warnings
import gymnasium as gym, numba, numpy as np, pandas, scipy.linalg, sklearn.metrics
from threadpoolctl import threadpool_info

def world():
    kind, keys, *rest = np.random.get_state()
    return {
        "threads": {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()},
        "threads of numba": numba.get_num_threads(),
        "generators": (random.getstate(), kind, keys.tolist(), rest),
        "variables": dict(os.environ),
        "hooks": (sys.excepthook, sys.displayhook),
        "warnings": list(warnings.filters),
        "floating point": np.geterr(),
    }

before = world()
import usnet_env
env = gym.make("USNET/SingleCluster-v0")
env.reset(seed=3)
env.step(env.action_space.sample())
usnet_env.evaluate("USNET/SingleCluster-v0", "lagged-regression", episodes=1)
after = world()
# A library that is loaded later brings threads of its own.
after["threads"] = {pool: after["threads"].get(pool) for pool in before["threads"]}
assert after == before, [name for name in before if after[name] != before[name]]
""")


def test_modules_of_the_current_folder_do_not_hide_installed_ones(fresh_process, tmp_path):
    (tmp_path / "detectors").mkdir()
    (tmp_path / "detectors/__init__.py").touch()
    (tmp_path / "sklearn.py").write_text("raise SystemExit('the wrong sklearn')")
    (tmp_path / "mine.py").write_text("class Mine:\n    def reset(self, seed=None): ...\n    def detect(self, w): ...")
    fresh_process.run(
        """
import sys
del sys.path[0]  # as for a console script
from usnet_env.cli import main
from usnet_env.plugins import make_detector

assert main(["--version"]) == 0
make_detector("mine:Mine")
make_detector("granger")
""",
        tmp_path,
    )


def test_what_is_declared_is_there():
    for package in ("usnet_env", "detectors"):
        assert files(package).joinpath("py.typed").is_file()
    for group, points in PROJECT["entry-points"].items():
        for name, value in points.items():
            assert EntryPoint(name, value, group).load()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    newest = re.search(r"^## \[?([\d.]+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)[1]
    assert citation == PROJECT["version"] == newest
    for form in (ROOT / ".github/ISSUE_TEMPLATE").iterdir():
        assert {"name", "description", "body"} <= set(yaml.safe_load(form.read_text(encoding="utf-8")))
    data = ROOT / "detectors/reader/data"
    assert hashlib.sha256((data / "reader.safetensors").read_bytes()).hexdigest() in (data / "README.md").read_text()
    torches = [line for lines in EXTRAS.values() for line in lines if line.startswith("torch>")]
    assert torches
    assert all(re.search(r"<\d", line) for line in torches)


def test_the_first_install_is_small():
    """The extra of the README's first command brings no extra of developers, and neither does the core."""
    names = {re.match(r"[\w-]+", line)[0] for line in [*PROJECT["dependencies"], *EXTRAS["replay"]]}
    assert not names & {"torch", "stable-baselines3", "ray", "sphinx", "pytest", "mypy", "pyarrow", "usnet"}


# Global generators and settings, and reading files that may run code
NEVER = re.compile(
    r"np\.random\.(?!(default_rng|Generator|SeedSequence|BitGenerator|Philox|PCG64)\b)\w+"
    r"|(?<![\w.])random\.(seed|random|randint|choice|shuffle)\(|(?<!\w)set_num_threads|threadpool_limits"
    r"|\bpickle\.(loads?|Unpickler)\b|allow_pickle=True|torch\.load\((?![^\n]*weights_only=True)"
    r"|torch\.(manual_seed|seed|set_default_\w+|set_rng_state|cuda\.manual_seed)"
)
EXCUSED = ("detectors/checks/", "usnet_env/evaluation/tasks.py")  # bytes that the same run has pickled, no files


@pytest.mark.parametrize("package", ["usnet_env", "detectors"])
def test_no_source_touches_global_state_or_unpickles(package):
    for path in sorted((ROOT / package).rglob("*.py")):
        found = NEVER.search(path.read_text(encoding="utf-8"))
        assert found is None or path.relative_to(ROOT).as_posix().startswith(EXCUSED), (path, found[0])
    found = "np.random.seed(0)|random.seed(1)|torch.seed()|np.load(p, allow_pickle=True)|pickle.load(f)|torch.load(p)"
    assert all(NEVER.search(line) for line in found.split("|"))
    fine = "np.random.default_rng(0)|rng.random()|torch.Generator().manual_seed(0)|torch.load(p, weights_only=True)"
    assert not any(NEVER.search(line) for line in fine.split("|"))
