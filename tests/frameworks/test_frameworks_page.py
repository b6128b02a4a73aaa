"""What the page on frameworks shows runs, each snippet where its framework is installed."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "frameworks.md").read_text(encoding="utf-8")
EXAMPLES = ROOT / "examples" / "frameworks"
NEEDED = {
    "Stable-Baselines3": ["sb3_contrib"],
    "TorchRL": ["torchrl", "pettingzoo"],
    "Tianshou": ["tianshou"],
    "Minari": ["minari", "torch"],
    "SuperSuit": ["supersuit", "stable_baselines3"],
}


def sections() -> dict[str, str]:
    """The snippet of each section that has one."""
    parts = re.split(r"^## (.+)$", PAGE, flags=re.MULTILINE)[1:]
    snippets = {
        heading: re.search(r"^```py\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        for heading, text in zip(parts[::2], parts[1::2], strict=True)
    }
    return {heading: snippet[1] for heading, snippet in snippets.items() if snippet}


def test_every_framework_has_a_snippet():
    assert sorted(sections()) == sorted(NEEDED)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
@pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning")
@pytest.mark.parametrize("heading", NEEDED)
def test_a_snippet_runs(heading, monkeypatch):
    for module in NEEDED[heading]:
        pytest.importorskip(module)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    exec(compile(sections()[heading], heading, "exec"), {"__name__": heading})


def test_the_page_names_every_script_and_no_other():
    scripts = {path.name for path in EXAMPLES.glob("*.py") if "__main__" in path.read_text(encoding="utf-8")}
    named = set(re.findall(r"^python examples/frameworks/(\S+)$", PAGE, re.MULTILINE))
    assert named == scripts
    assert scripts <= set(re.findall(r"`(\w+\.py)`", PAGE))
