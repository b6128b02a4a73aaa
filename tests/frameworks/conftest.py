"""What the tests of the frameworks share: their examples can be imported, and PyTorch uses one thread."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "frameworks"))


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Small networks wait for each other on more."""
    torch = sys.modules.get("torch")  # the core's environment has none
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
