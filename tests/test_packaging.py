"""What the packages promise to whoever installs them: few imports, no side effects, arrows that point down."""

import ast
import os
import re
import subprocess
import sys
import tarfile
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SOURCES = sorted(path for package in ("usnet_env", "detectors") for path in (ROOT / package).rglob("*.py"))


def run_python(program: str) -> None:
    """Run a program in a fresh interpreter; its traceback becomes the test's message."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_the_arrows_point_down():
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 kept, 0 broken" in done.stdout


def test_the_core_works_without_any_extra():
    run_python("""
import sys
from importlib.abc import MetaPathFinder

EXTRAS = {"matplotlib", "rerun", "pyarrow", "pandas", "torch", "stable_baselines3", "mpe2", "vmas", "pettingzoo",
          "sphinx", "myst_parser", "furo", "pytest", "hypothesis", "importlinter", "ruff", "mypy"}

class NoExtras(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"{name} is an extra", name=name)

sys.meta_path.insert(0, NoExtras())

import gymnasium as gym
import numpy as np
import usnet_env

env = gym.make("USNET/MultiCluster-v0", clusters=2, uavs=8, observation_steps=40)
env.reset(seed=0)
env.step(np.eye(1, 8, dtype=np.int8)[0])
result = usnet_env.evaluate(
    "USNET/MultiCluster-v0", ["lagged-regression(clusters=2)", "destroy-all"], episodes=2, isolate=False,
    env_kwargs={"clusters": 2, "uavs": 8, "observation_steps": 40},
)
assert [entry["episodes"] for entry in result.summary] == [2, 2]
assert result["destroy-all"]["J"]["mean"] == 1.75
assert not EXTRAS & set(sys.modules)
""")


def test_an_import_changes_nothing_global():
    run_python("""
import os
import random
import sys
import warnings
import gymnasium as gym, numba, numpy as np, scipy.linalg, sklearn.metrics
from threadpoolctl import threadpool_info

def world():
    kind, keys, *rest = np.random.get_state()
    return {
        "threads": {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()},
        "threads of numba": numba.get_num_threads(),
        "generator of Python": random.getstate(),
        "generator of NumPy": (kind, keys.tolist(), rest),
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
usnet_env.evaluate("USNET/SingleCluster-v0", "lagged-regression", episodes=1, isolate=False)
after = world()
# A library that is loaded later brings threads of its own.
after["threads"] = {pool: after["threads"].get(pool) for pool in before["threads"]}
assert after == before, [name for name in before if after[name] != before[name]]
""")


def test_loops_compile_where_no_cache_folder_can_be_written(fresh_process):
    fresh_process.run("""
import importlib

from numba.core import caching

import usnet_env.swarm.kernels
from usnet_env.compiling import compiled

# Numba's locators find no folder: neither the package nor the home of the user can be written.
caching.CacheImpl._locator_classes = []
importlib.reload(usnet_env.swarm.kernels)

@compiled()
def double(number):
    return 2 * number

assert double(3) == 6
""")


@pytest.fixture
def crowded(tmp_path):
    """A folder with modules that have the names of installed ones, and a detector."""
    (tmp_path / "detectors").mkdir()
    (tmp_path / "detectors/__init__.py").touch()
    (tmp_path / "sklearn.py").write_text("raise SystemExit('the wrong sklearn')")
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    def reset(self, seed=None): ...\n    def detect(self, window): ..."
    )
    return tmp_path


def run_in(folder: Path, program: str) -> None:
    """Run a program in a folder that is not on the path, as for a console script."""
    program = f"import sys\ndel sys.path[0]\n{program}"
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_modules_of_the_current_folder_do_not_hide_installed_ones(crowded):
    run_in(
        crowded,
        """
from usnet_env.cli import main
from usnet_env.plugins import make_detector

assert main(["--version"]) == 0
make_detector("mine:Mine")
make_detector("granger")
""",
    )


def test_a_foreign_package_of_the_same_name_is_named(crowded):
    (crowded / "sklearn.py").unlink()
    run_in(
        crowded,
        f"""
sys.path.insert(0, {str(crowded)!r})
import contextlib, io
from usnet_env.cli import main

wanted = "the package 'detectors' that Python found is not that of usnet: rename '{crowded}/detectors', or"
for words in (["check-detector", "mine:Mine"], ["evaluate", "--detector", "granger", "--episodes", "1"]):
    with contextlib.redirect_stderr(io.StringIO()) as written:
        assert main(words) in (1, 2)
    assert wanted in written.getvalue(), written.getvalue()
    assert written.getvalue().count("\\n") == 1
""",
    )


@pytest.mark.slow
def test_the_lowest_versions_that_are_allowed():
    done = subprocess.run([sys.executable, ROOT / "tests/packaging/lowest.py"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_tests_of_the_sdist_can_be_collected(tmp_path):
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path], cwd=ROOT, check=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as files:
        files.extractall(tmp_path, filter="data")
    (sources,) = tmp_path.glob("usnet-*/")
    environment = os.environ | {"PYTHONPATH": str(sources)}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"],
        cwd=sources, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]


@pytest.mark.parametrize("package", ["usnet_env", "detectors"])
def test_the_types_ship(package):
    assert files(package).joinpath("py.typed").is_file()


def test_one_version_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    newest = re.search(r"^## \[([^]]+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1]
    assert citation == project == newest


def test_torch_is_bounded_wherever_it_is_asked_for():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    torches = [line for lines in extras.values() for line in lines if line.startswith("torch")]
    assert torches
    assert all(re.search(r"<\d", line) for line in torches)


# No file touches what is global in a process, or runs code from a file.

OWN_GENERATORS = {"BitGenerator", "Generator", "PCG64", "Philox", "SeedSequence", "default_rng"}
NEVER = {
    "numba.set_num_threads",
    "pickle.load",
    "pickle.loads",
    "pickle.Unpickler",
    "threadpoolctl.threadpool_limits",
    "torch.cuda.manual_seed",
    "torch.cuda.manual_seed_all",
    "torch.manual_seed",
    "torch.random.manual_seed",
    "torch.seed",
    "torch.set_default_device",
    "torch.set_default_dtype",
    "torch.set_num_interop_threads",
    "torch.set_num_threads",
    "torch.set_rng_state",
}


def _modules(tree: ast.Module) -> dict[str, str]:
    """What each imported name stands for, by its dotted path."""
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                names[alias.asname or alias.name.partition(".")[0]] = (
                    alias.name if alias.asname else alias.name.partition(".")[0]
                )
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                names[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    return names


def _dotted(node: ast.expr, modules: dict[str, str]) -> str:
    if isinstance(node, ast.Name):
        return modules.get(node.id, "")
    if isinstance(node, ast.Attribute) and (owner := _dotted(node.value, modules)):
        return f"{owner}.{node.attr}"
    return ""


def offences(source: str) -> list[str]:
    """Uses of global generators, global settings and unpickling in a Python source."""
    if not re.search("random|pickle|threadpoolctl|torch|numba", source):
        return []
    tree = ast.parse(source)
    modules = _modules(tree)
    found = []
    for node in ast.walk(tree):
        name = _dotted(node, modules) if isinstance(node, ast.Name | ast.Attribute) else ""
        owner, _, last = name.rpartition(".")
        global_generator = (owner == "numpy.random" and last not in OWN_GENERATORS) or (
            owner == "random" and last != "Random"
        )
        if global_generator or name in NEVER:
            found.append(name)
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            if not (isinstance(node.value, ast.Constant) and node.value.value is False):
                found.append("allow_pickle")
        elif isinstance(node, ast.Call) and _dotted(node.func, modules) == "torch.load":
            safe = {keyword.arg: keyword.value for keyword in node.keywords}.get("weights_only")
            if not (isinstance(safe, ast.Constant) and safe.value is True):
                found.append("torch.load")
    return found


EXCUSED = {  # bytes that the same run has pickled, no files
    "detectors/checks/arguments.py": ["pickle.loads"],
    "detectors/checks/run.py": ["pickle.loads"],
    "usnet_env/processes/ray_pool.py": ["pickle.loads"],  # a function that the run sends to its workers
}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_source_touches_global_state_or_unpickles(path):
    assert offences(path.read_text(encoding="utf-8")) == EXCUSED.get(path.relative_to(ROOT).as_posix(), [])


@pytest.mark.parametrize(
    "source",
    [
        "import numpy as np\nnp.random.seed(0)",
        "import numpy\nx = numpy.random.normal(3)",
        "from numpy.random import rand\nrand()",
        "from numpy import random as r\nr.shuffle([1])",
        "import random\nrandom.seed(1)",
        "import torch as t\nt.manual_seed(0)",
        "from torch import set_num_threads\nset_num_threads(1)",
        "import numpy as np\nnp.load('x', allow_pickle=True)",
        "import pickle\npickle.load(open('x', 'rb'))",
        "import torch\ntorch.load('x')",
        "import torch\ntorch.load('x', weights_only=False)",
    ],
)
def test_these_would_be_found(source):
    assert offences(source)


@pytest.mark.parametrize(
    "source",
    [
        "import numpy as np\nrng = np.random.default_rng(0)\nrng.shuffle([1])",
        "import numpy as np\ndef f(rng: np.random.Generator): rng.random()",
        "import torch\ng = torch.Generator().manual_seed(0)\ntorch.load('x', weights_only=True)",
        "import pickle, numpy as np\npickle.dumps(1)\nnp.load('x', allow_pickle=False)",
    ],
)
def test_these_are_fine(source):
    assert offences(source) == []
