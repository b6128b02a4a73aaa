"""The example of each framework trains, its agent plays beside detectors, and the snippets of the page run."""

import importlib
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

EXAMPLES = {
    "ppo": ("torch", "--steps 1024 --episodes 2", ["PPO", "regression", "random"]),
    "supervised": ("torch", "--windows 128 --episodes 2", ["supervised", "untrained", "reader", "lagged", "random"]),
    "torchrl_ppo": ("torchrl", "--steps 1024 --episodes 2", ["PPO", "regression"] * 2),
    "minari_imitation": ("minari", "--games 3 --updates 2 --episodes 2", ["student", "teacher"] * 2),
}
pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_trains_and_compares_its_agent_with_detectors(name, capsys, monkeypatch):
    pytest.importorskip(EXAMPLES[name][0])
    example = importlib.import_module(name)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    example.main(EXAMPLES[name][1].split())
    shown = capsys.readouterr().out.splitlines()
    lines = [re.match(r"\| (\w+)[^|]* \| \d+ \|.* \| (-?[\d.]+)", line) for line in shown]
    scores = [(line[1], float(line[2])) for line in lines if line]
    assert [agent for agent, _ in scores] == EXAMPLES[name][2]
    assert np.isfinite([score for _, score in scores]).all()


def test_a_truncated_game_has_the_value_of_its_last_window(monkeypatch):
    torch = pytest.importorskip("torch")
    ppo = importlib.import_module("ppo")
    monkeypatch.setattr(ppo, "GAMES", 4)
    monkeypatch.setattr(ppo, "ROUNDS", 1)
    torch.manual_seed(0)
    arguments = {"clusters": 3, "uavs": 12, "observation_steps": 20, "max_rounds": 1, "observe": ("velocity", "alive")}
    envs, twins = (gym.make_vec("USNET/MultiCluster-v0", 4, autoreset_mode="SameStep", **arguments) for _ in range(2))
    network = ppo.PairNetwork()
    for part in network.parameters():
        torch.nn.init.normal_(part)  # a new network has the value 0
    rollout, _ = ppo.play(envs, network, envs.reset(seed=0)[0])
    twins.reset(seed=0)
    _, reward, _, truncated, info = twins.step(rollout["action"][0].numpy().astype(np.int8))
    assert truncated.all()
    last = [torch.from_numpy(np.stack([one[name] for one in info["final_obs"]])) for name in ("velocity", "alive")]
    expected = torch.from_numpy(reward).float() + network(*last)[1] - rollout["value"][0]
    torch.testing.assert_close(rollout["advantage"][0], expected)


ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "frameworks.md").read_text(encoding="utf-8")
NEEDED = {
    "Stable-Baselines3": ["sb3_contrib"],
    "Networks for raw windows": ["stable_baselines3"],
    "TorchRL": ["torchrl", "pettingzoo"],
    "BenchMARL": ["benchmarl"],
    "SuperSuit": ["supersuit", "stable_baselines3"],
    "Tianshou": ["tianshou"],
    "Minari": ["minari", "torch"],
}
QUICK, SLOW = "Stable-Baselines3", ([], [pytest.mark.slow])  # each framework takes seconds to import


@pytest.mark.filterwarnings("ignore:SyncDataCollector has been deprecated:DeprecationWarning")  # by BenchMARL
@pytest.mark.filterwarnings("ignore:size_average and reduce args:UserWarning")
@pytest.mark.parametrize("heading", [pytest.param(name, marks=SLOW[name != QUICK]) for name in NEEDED])
def test_a_snippet_runs(heading, monkeypatch):
    for module in NEEDED[heading]:
        pytest.importorskip(module)
    section = re.search(rf"^## {heading}$(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)[1]
    snippet = re.search(r"^```py\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)[1]
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    exec(compile(snippet, heading, "exec"), {"__name__": heading})


def test_the_page_names_every_script_and_no_other():
    scripts = (ROOT / "examples" / "frameworks").glob("*.py")
    scripts = {path.name for path in scripts if "__main__" in path.read_text(encoding="utf-8")}
    assert set(re.findall(r"^python examples/frameworks/(\S+)$", PAGE, re.MULTILINE)) == scripts
