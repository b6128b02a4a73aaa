"""Whatever ends `usnet evaluate`: the same command resumes to the rows of an undisturbed run, and no process stays."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pandas.testing import assert_frame_equal
from sample_detectors import untimed

from usnet_env.evaluation import EvaluationResult

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="signals and limits of Linux")

COMMAND = [
    *("evaluate", "--detector", "sample_detectors:Slow", "--detector", "random", "--episodes", "12", "--seed", "3"),
    *("--set", "clusters=3", "uavs=20", "observation_steps=20", "max_rounds=5", "--workers", "2"),
]


def start(out, most=None):
    """Start the command in a session of its own; no file may exceed ``most`` bytes."""

    def prepare():
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
        if most is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    path = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "usnet_env", *COMMAND, "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,
        preexec_fn=prepare,
    )


def members(session):
    """The numbers and parents of a session's living processes."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent, _, number = stat.read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        if int(number) == session and state != "Z":
            found[int(stat.parent.name)] = int(parent)
    return found


def finish(running):
    """Wait for the end; returns the status and what was said, once no process of the session is left."""
    err = running.communicate(timeout=600)[1]
    end = time.monotonic() + 300
    while (left := members(running.pid)) and time.monotonic() < end:
        time.sleep(0.05)
    assert left == {}, err
    return running.returncode, err


def wait_for_rows(running, out):
    rows = out / "rows.csv"
    while running.poll() is None and not (rows.exists() and rows.read_bytes().count(b"\n") > 4):
        time.sleep(0.01)
    assert running.poll() is None, running.communicate()[1]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed")
    assert finish(start(out))[0] == 0
    return untimed(EvaluationResult.load(out))


ENDS = {
    "Ctrl-C": (lambda running: os.killpg(running.pid, signal.SIGINT), 130, "the same command resumes"),
    "SIGTERM": (lambda running: running.terminate(), -signal.SIGTERM, ""),
    "kill -9 of the parent": (lambda running: running.kill(), -signal.SIGKILL, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("how", ENDS)
def test_a_run_that_was_ended_resumes(tmp_path, undisturbed, how):
    end, status, words = ENDS[how]
    running = start(tmp_path)
    wait_for_rows(running, tmp_path)
    end(running)
    found, err = finish(running)
    assert found == status, err
    assert words in err
    assert "Traceback" not in err
    assert 4 <= len(EvaluationResult.load(tmp_path).rows) < 24
    assert finish(start(tmp_path))[0] == 0
    assert_frame_equal(untimed(EvaluationResult.load(tmp_path)), undisturbed)


@pytest.mark.slow
def test_a_full_disk_is_one_sentence_and_the_run_resumes(tmp_path, undisturbed):
    status, err = finish(start(tmp_path, most=2_000))
    assert status == 2
    assert "rows.csv can't be written: " in err
    assert err.count("\n") == 1
    assert 1 <= len(EvaluationResult.load(tmp_path).rows) < 24
    assert finish(start(tmp_path))[0] == 0
    assert_frame_equal(untimed(EvaluationResult.load(tmp_path)), undisturbed)
