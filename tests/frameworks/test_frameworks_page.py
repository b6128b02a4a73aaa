"""What the page on frameworks shows runs, each snippet where its framework is installed."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "frameworks.md").read_text(encoding="utf-8")
NEEDED = {
    "Stable-Baselines3": ["sb3_contrib"],
    "Networks for raw windows": ["stable_baselines3"],
    "TorchRL": ["torchrl", "pettingzoo"],
    "BenchMARL": ["benchmarl"],
    "Tianshou": ["tianshou"],
    "Minari": ["minari", "torch"],
}
QUICK, SLOW = "Stable-Baselines3", ([], [pytest.mark.slow])  # each framework takes seconds to import


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
@pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning")
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
