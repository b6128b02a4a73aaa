"""Install the lowest versions that pyproject.toml allows, with the extra ``replay``, and run the package there."""

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import usnet_env

if __name__ == "__main__":
    detectors = ["reader", "lagged-regression(clusters=2)", "lagged-correlation", "granger", "random"]
    swarm = {"clusters": 2, "uavs": 12, "observation_steps": 40}
    result = usnet_env.evaluate("USNET/MultiCluster-v0", detectors, episodes=2, workers=2, env_kwargs=swarm, out="runs")
    assert [entry["episodes"] for entry in result.summary] == [2] * len(detectors)
    assert result.summary[0]["metrics"]["exact"]["mean"] == 1.0
"""


def call(*command: str | Path, folder: Path = ROOT) -> None:
    """Run a command; where it fails, end with its output."""
    done = subprocess.run([str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}")


def main() -> None:
    """Make the environment in a temporary folder; run an evaluation with two processes and the demo."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["replay"]]
    pins = sorted({re.sub(r"(\[[^]]*\])?\s*>=\s*([\w.]+).*", r"==\2", line) for line in wanted})
    print(*pins, flush=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python, usnet = folder / "venv/bin/python", folder / "venv/bin/usnet"
        (folder / "pins.txt").write_text("\n".join(pins), encoding="utf-8")
        (folder / "check.py").write_text(PROGRAM, encoding="utf-8")
        call(sys.executable, "-m", "venv", folder / "venv")
        call(python, "-m", "pip", "install", "-q", "--prefer-binary", "-c", folder / "pins.txt", f"{ROOT}[replay]")
        call(python, "check.py", folder=folder)
        call(usnet, "demo", "--out", "demo", folder=folder)
        call(usnet, "list", "detectors", folder=folder)


if __name__ == "__main__":
    main()
