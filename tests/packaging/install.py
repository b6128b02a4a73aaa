"""Install the package as a user does, in an empty environment, and check it outside of the repository.

python tests/packaging/install.py newest    the README, and the tests of what an installation adds to the code
python tests/packaging/install.py lowest    an evaluation and the demo, with the lowest versions that are allowed
"""

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
COPIED = ("tests", "docs", "examples", "README.md", "CONTRIBUTING.md", "pyproject.toml")  # no package is among them
HERE = """
import sys, numpy, pandas, usnet_env, detectors

assert all(module.__file__.startswith(sys.prefix) for module in (usnet_env, detectors))
print("NumPy", numpy.__version__, "pandas", pandas.__version__)
"""
# The command line, entry points, data files, optional formats and worker processes; the rest is the same code.
INSTALLED = (
    "test_cli*.py", "test_parts.py", "test_plugins.py", "test_public_names.py", "tracks/test_detect*.py",
    "tracks/test_readers.py", "evaluation/test_cli*.py", "evaluation/test_suites.py",
    "evaluation/test_tasks.py",
)  # fmt: skip
EVALUATION = """
import usnet_env

if __name__ == "__main__":
    detectors = ["reader", "lagged-regression(clusters=2)", "lagged-correlation", "granger", "random"]
    swarm = {"clusters": 2, "uavs": 12, "observation_steps": 40}
    result = usnet_env.evaluate("USNET/MultiCluster-v0", detectors, episodes=2, workers=2, env_kwargs=swarm, out="runs")
    assert [entry["episodes"] for entry in result.summary] == [2] * len(detectors)
    assert result.summary[0]["metrics"]["exact"]["mean"] == 1.0
"""


def call(*command: str | Path, folder: Path = ROOT) -> None:
    """Run a command whose output is shown; end where it fails."""
    print("+", *(str(part).removeprefix(f"{folder}/") for part in command), flush=True)
    if status := subprocess.run(command, cwd=folder, check=False).returncode:
        sys.exit(f"{command[0]} ended with {status}")


def check_newest(folder: Path, python: Path) -> None:
    """Run the README with what its first command installs; then the tests that need no PyTorch."""
    install, test = (python, "-m", "pip", "install", "-qq"), (python, "-m", "pytest", "-n", "2", "-m", "not slow")
    call(*install, ".[replay]", "pytest", "pytest-xdist", "hypothesis")
    for name in COPIED:
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy)(ROOT / name, folder / name)
    call(python, "-c", HERE, folder=folder)
    call(*test, "-k", "README.md and page and run", "tests/test_documentation.py", folder=folder)
    call(*install, ".[tracks,multiagent]")
    chosen = [path for pattern in INSTALLED for path in sorted((folder / "tests").glob(pattern))]
    call(*test, "--dist", "worksteal", *chosen, folder=folder)


def check_lowest(folder: Path, python: Path) -> None:
    """Run an evaluation with two processes, and the demo."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["replay"]]
    pins = sorted({re.sub(r"(\[[^]]*\])?\s*>=\s*([\w.]+).*", r"==\2", line) for line in wanted})
    print(*pins, flush=True)
    (folder / "pins.txt").write_text("\n".join(pins), encoding="utf-8")
    (folder / "check.py").write_text(EVALUATION, encoding="utf-8")
    call(python, "-m", "pip", "install", "-qq", "--prefer-binary", "-c", folder / "pins.txt", ".[replay]")
    usnet = python.with_name("usnet")
    for command in ((python, "check.py"), (usnet, "demo", "--out", "demo"), (usnet, "list", "detectors")):
        call(*command, folder=folder)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        call(sys.executable, "-m", "venv", folder / "venv")
        {"newest": check_newest, "lowest": check_lowest}[sys.argv[1]](folder, folder / "venv/bin/python")


if __name__ == "__main__":
    main()
