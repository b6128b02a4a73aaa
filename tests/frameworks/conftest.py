"""What the tests of the frameworks share: importable examples, and one thread for PyTorch."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "frameworks"))


@pytest.fixture(autouse=True)
def one_thread():
    """Small networks wait for each other on more."""
    torch = sys.modules.get("torch")  # the core's environment has none
    threads = torch.get_num_threads() if torch else 1
    if torch:
        torch.set_num_threads(1)
    yield
    if torch:
        torch.set_num_threads(threads)
