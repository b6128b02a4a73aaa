"""What the tests of the frameworks share: importable examples, one thread for PyTorch, loops that stay Python."""

import sys
from pathlib import Path

import pytest
from run_script import run_script

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


@pytest.fixture(scope="module")
def script(request):
    """What the module's example trains, and the lines that its script prints, with the arguments ``WORDS``."""
    return run_script(request.module.example, *request.module.WORDS)


@pytest.fixture(scope="module")
def untrained(request):
    """What the module's example trains in no steps."""
    return request.module.example.train(0)


@pytest.fixture(scope="module")
def trained(script):
    """What the script trains."""
    return script[0]


@pytest.fixture(scope="module", autouse=True)
def tianshou_uncompiled():
    """Tianshou's loops as they are written: it compiles them anew in every process, which takes 15 seconds."""
    places = ("tianshou.algorithm.algorithm_base", "tianshou.data.buffer.manager")
    modules = [sys.modules[name] for name in places if name in sys.modules]
    loops = [
        (module, name, loop) for module in modules for name, loop in vars(module).items() if hasattr(loop, "py_func")
    ]
    for module, name, loop in loops:
        setattr(module, name, loop.py_func)
    yield
    for module, name, loop in loops:
        setattr(module, name, loop)
