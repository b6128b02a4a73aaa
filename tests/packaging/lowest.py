"""Install the lowest versions that pyproject.toml allows in a fresh environment, and run the package there.

    python tests/packaging/lowest.py            the dependencies, and the extras render and replay
    python tests/packaging/lowest.py --keep DIR  keep the environment in DIR

The extras with PyTorch are left out: `tests/frameworks/extras.sh` installs them one by one.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXTRAS = ("render", "replay")
PROGRAM = """
import sys
import gymnasium as gym
import numpy as np
import usnet_env

env = gym.make("USNET/MultiCluster-v0", clusters=2, uavs=12, observation_steps=40, render_mode="rgb_array")
env.reset(seed=0)
env.step(np.eye(1, 12, dtype=np.int8)[0])
assert env.render().ndim == 3
detectors = ["follow-mixture", "lagged-regression(clusters=2)", "lagged-correlation", "granger", "factions", "random"]
result = usnet_env.evaluate(
    "USNET/MultiCluster-v0", detectors, episodes=2, workers=2,
    env_kwargs={"clusters": 2, "uavs": 12, "observation_steps": 40}, out=sys.argv[1],
)
assert [entry["episodes"] for entry in result.summary] == [2] * len(detectors)
assert result["follow-mixture"]["exact"]["mean"] == 1.0, result["follow-mixture"]
"""


def lowest_versions() -> list[str]:
    """One pin a dependency, ``name==lowest``, of the core and of :data:`EXTRAS`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(line for name in EXTRAS for line in project["optional-dependencies"][name])]
    return sorted({re.sub(r"(\[[^]]*\])?\s*>=\s*([\w.]+).*", r"==\2", line) for line in wanted})


def run(folder: Path) -> None:
    """Make the environment in ``folder``, and run a demo, an evaluation and refused commands there."""
    python, usnet = folder / "venv/bin/python", folder / "venv/bin/usnet"
    pins = folder / "pins.txt"
    pins.write_text("\n".join(lowest_versions()) + "\n", encoding="utf-8")
    print(" ".join(lowest_versions()), flush=True)
    call([sys.executable, "-m", "venv", folder / "venv"])
    call([python, "-m", "pip", "install", "--quiet", "hatchling"])
    call([python, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, ROOT])
    (wheel,) = folder.glob("usnet-*.whl")
    extras = ",".join(EXTRAS)
    call([python, "-m", "pip", "install", "--quiet", "--prefer-binary", "-c", pins, f"{wheel}[{extras}]"])
    (folder / "check.py").write_text(f"if __name__ == '__main__':\n{indented(PROGRAM)}", encoding="utf-8")
    call([python, "check.py", "runs"], cwd=folder)
    call([usnet, "demo", "--out", "demo"], cwd=folder)
    call([usnet, "list", "detectors"], cwd=folder)
    for refused in ([usnet], [usnet, "evaluate", "nothing"], [usnet, "reproduce"]):
        done = subprocess.run(refused, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 2 or "Traceback" in done.stderr:
            sys.exit(f"{refused[1:]} ended with {done.returncode}:\n{done.stderr}")


def indented(program: str) -> str:
    """The program as the body of an ``if``: worker processes import the file that they were started from."""
    return "".join(f"    {line}\n" if line else "\n" for line in program.splitlines())


def call(command: list[str | Path], cwd: Path | None = None) -> None:
    """Run a command; where it fails, end with its output."""
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}")


def main() -> None:
    """Run in a temporary folder, or in the folder of ``--keep``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, metavar="DIR", help="a folder for the environment, which stays")
    keep = parser.parse_args().keep
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        run(keep.resolve())
        return
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder))


if __name__ == "__main__":
    main()
