"""What all tests share."""

import gc
import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

# As many processes as cores leave a core each: more threads than that make small tensor operations wait for each other,
# a hundred times longer than they take. This must be said before the libraries are imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A property doesn't depend on time, but Hypothesis's deadline (200 ms per example) and its check for slow generation
# do: on a busy machine the first `text()` of a process, which builds a table of Unicode, takes seconds and fails it.
import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("usnet", deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("usnet")


def pytest_collection_finish():
    """Keep what was imported out of the garbage collector, which would look through all of it again and again.

    It took a third of the time of the tests.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def fresh_process():
    """Runs programs that import from a folder in new processes; one that fails fails the test."""

    def run_program(program, folder=None):
        done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return SimpleNamespace(run=run_program)


@pytest.fixture
def declare(monkeypatch, tmp_path):
    """Declares entry points, beside those that are there, as another distribution would; a module may be given."""
    from usnet_env import parts

    def declare_points(group, module=None, **values):
        if module:
            (tmp_path / f"{module[0]}.py").write_text(module[1])
            monkeypatch.syspath_prepend(tmp_path)
        found = parts.entry_points
        points = {group: [EntryPoint(name, value, group) for name, value in values.items()]}
        monkeypatch.setattr(parts, "entry_points", lambda group: [*found(group=group), *points.get(group, ())])
        parts.find_entry_points.cache_clear()

    yield declare_points
    parts.find_entry_points.cache_clear()


@pytest.fixture
def run(capsys):
    """Run a command line; returns its exit status, standard output and standard error."""
    from usnet_env.cli import main

    def runner(*words):
        status = main([str(word) for word in words])
        output = capsys.readouterr()
        return status, output.out, output.err

    return runner


@pytest.fixture
def refused(run):
    """Run a command line that is refused in one sentence and prints nothing else; returns the sentence."""

    def refuse(*words):
        status, out, err = run(*words)
        assert (status, out) == (2, "")
        assert err.startswith("usnet: ")
        assert err.endswith((".\n", "?\n"))
        assert err.count("\n") == 1
        return err

    return refuse
