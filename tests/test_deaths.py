"""Whatever ends a run: when it is resumed, its rows are those of an undisturbed run. Prints what was kept."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time

import pytest
from test_interruptions import SAMPLES, interrupt, rows_of, wait_for_the_end_of

sys.path.insert(0, str(SAMPLES))
from test_backends import run_on_cluster

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="signals and limits of Linux"),
]

# The same episodes as in `evaluation/ray_cluster.py`.
COMMAND = [
    *("evaluate", "--detector", "sample_detectors:Mortal", "--detector", "random", "--episodes", "12", "--seed", "3"),
    *("--set", "clusters=3", "uavs=20", "observation_steps=20", "max_rounds=5", "--workers", "2", "--json"),
]
SIGNALS = ["Ctrl-C", "SIGTERM", "kill -9 of a worker", "kill -9 of the parent"]
DETECTORS = {"crashing detector": "raise", "hanging detector": "hang", "memory-eating detector": "memory"}
DEATHS = [*SIGNALS, "full disk", "two writers", "vanished folder", *DETECTORS, "lost Ray node"]
ENOUGH = 5  # rows before a run is disturbed


def start(out, *more, death="", before=None):
    path = os.pathsep.join(filter(None, [str(SAMPLES), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "usnet_env", *COMMAND, *more, "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path, "USNET_TEST_DEATH": death},
        start_new_session=True,
        preexec_fn=before,
    )


def finish(running, status=0):
    err = running.communicate(timeout=300)[1]
    assert (running.returncode == 0) == (status == 0), err
    assert wait_for_the_end_of(running.pid) == {}, err
    return err


def count(out):
    try:
        return (out / "episodes.csv").read_bytes().count(b"\n") - 1
    except OSError:
        return 0


def wait_for_rows(running, out):
    while running.poll() is None and count(out) < ENOUGH:
        time.sleep(0.01)
    assert running.poll() is None, "it ended before it was disturbed"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Rows and folder of an undisturbed run."""
    out = tmp_path_factory.mktemp("undisturbed")
    finish(start(out))
    return rows_of(out, "evaluate"), out


@pytest.fixture(scope="module")
def report():
    lines = []
    yield lines
    print("\n| what ended the run | rows kept | rows after resuming | equal |\n| --- | ---: | ---: | --- |")
    print("\n".join(lines))


def disturb(death, out, folder):
    """Start a run and end it, or try to."""
    if death in DETECTORS:
        limits = ("--time-limit", "10", "--memory-limit", "1000")
        err = finish(start(out, *limits, death=DETECTORS[death]), status=2)
        assert "failed in episode" in err
        return
    if death == "full disk":
        size = (folder / "run.json").stat().st_size + 300
        assert size < (folder / "episodes.csv").stat().st_size
        err = finish(start(out, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))), status=2)
        assert "File too large" in err
        return
    running = start(out)
    wait_for_rows(running, out)
    if death == "two writers":
        os.killpg(running.pid, signal.SIGSTOP)  # it would end before the second one has started
        assert "which process" in finish(start(out), status=2)
        os.killpg(running.pid, signal.SIGCONT)
        finish(running)
    elif death == "vanished folder":
        away = out.with_name("away")
        out.rename(away)
        assert "which was removed" in finish(running, status=2)
        assert not out.exists()
        away.rename(out)
    else:
        interrupt(running, death, twice=False)
        finish(running, status=running.wait(60))


@pytest.mark.parametrize("death", DEATHS)
def test_a_run_that_was_ended_resumes_to_the_rows_of_an_undisturbed_one(tmp_path, undisturbed, report, death):
    rows, folder = undisturbed
    out = tmp_path / "run"
    if death == "lost Ray node":
        pytest.importorskip("ray")
        found = run_on_cluster(out, "node")
        kept = found["kept"][0]  # the run itself goes on
    else:
        disturb(death, out, folder)
        kept = count(out)
        finish(start(out))
    after = rows_of(out, "evaluate")
    report.append(f"| {death} | {kept} of {len(rows)} | {len(after)} | {'yes' if after == rows else 'no'} |")
    assert after == rows
    assert [path.name for path in out.iterdir() if path.name.startswith(".")] == []
