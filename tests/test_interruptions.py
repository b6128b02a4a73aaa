"""Sixty interruptions at random moments: the resumed rows are those of an undisturbed run, and no process stays."""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SAMPLES = Path(__file__).parent / "evaluation"
COMMANDS = {
    "evaluate": [
        *("evaluate", "--detector", "sample_detectors:Slow", "--detector", "random", "--episodes", "12", "--seed", "3"),
        *("--set", "clusters=3", "uavs=20", "observation_steps=20", "max_rounds=5", "--workers", "2", "--json"),
    ],
    "isolated": [],
    "reproduce": [
        *("reproduce", "table2", "--detector", "sample_detectors:Slow", "--detector", "random", "--workers", "2"),
        *("--cells", "f1:2,f2:2,f3:2,f4:2,f5:2,f6:2,f1:3,f2:3", "--episodes", "4"),
    ],
}
COMMANDS["isolated"] = [*COMMANDS["evaluate"], "--isolate", "--secret", "00112233445566778899aabbccddeeff"]
ROWS = {"evaluate": "episodes.csv", "isolated": "episodes.csv", "reproduce": "episodes-seed2022.csv"}
TIMES_EACH = 5  # 5 interruptions of each of 3 commands in each of 4 ways
TIMED = ("seconds_per_round", "seconds")


def start(command, out):
    path = os.pathsep.join(filter(None, [str(SAMPLES), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "usnet_env", *COMMANDS[command], "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job ignores it
    )


def members(session):
    """Numbers and parents of a session's living processes."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent, _, number = stat.read_text().rpartition(")")[2].split()[:4]
            if int(number) == session and state != "Z":
                found[int(stat.parent.name)] = (int(parent), stat.with_name("cmdline").read_text())
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
    return found


def workers_of(parent):
    return [pid for pid, (above, line) in members(parent).items() if above == parent and "spawn_main" in line]


def wait_for_the_end_of(session):
    """What is left of a session after a while: a worker that is just starting, and Python's own helper process, notice
    the end of their parent a moment later.
    """
    end = time.monotonic() + 20
    while (left := members(session)) and time.monotonic() < end:
        time.sleep(0.05)
    return left


def interrupt(running, how, twice):
    if how == "Ctrl-C":
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to the process and to its workers
        if twice:
            time.sleep(0.05)
            os.killpg(running.pid, signal.SIGINT)
    elif how == "SIGTERM":
        running.terminate()
    elif how == "kill -9 of the parent":
        running.kill()
    else:
        while running.poll() is None and not workers_of(running.pid):
            time.sleep(0.01)
        for worker in workers_of(running.pid)[:1]:
            os.kill(worker, signal.SIGKILL)


def rows_of(out, command):
    with (out / ROWS[command]).open(newline="") as file:
        return [{name: value for name, value in row.items() if name not in TIMED} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Rows of each command and the seconds that it takes, measured in its second run, when all caches are filled."""
    found = {}
    for command in COMMANDS:
        for _ in range(2):
            out = tmp_path_factory.mktemp(command)
            begin = time.monotonic()
            running = start(command, out)
            err = running.communicate(timeout=300)[1]
            assert running.returncode == 0, err
        found[command] = rows_of(out, command), time.monotonic() - begin
    return found


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("how", ["Ctrl-C", "SIGTERM", "kill -9 of the parent", "kill -9 of a worker"])
def test_interrupted_runs_resume_to_the_same_rows_and_leave_no_process(tmp_path, undisturbed, command, how):
    rows, seconds = undisturbed[command]
    chance = random.Random(f"{command} {how}")
    statuses = []
    for number in range(TIMES_EACH):
        running = start(command, tmp_path)
        time.sleep(chance.uniform(0.05, 0.9) * seconds)
        interrupt(running, how, twice=number % 2 == 1)
        err = running.communicate(timeout=60)[1]
        statuses.append(running.returncode)
        assert wait_for_the_end_of(running.pid) == {}, err
    running = start(command, tmp_path)
    err = running.communicate(timeout=300)[1]
    assert running.returncode == 0, err
    assert wait_for_the_end_of(running.pid) == {}
    assert rows_of(tmp_path, command) == rows
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == [], statuses
    print(f"{command}, {how}: statuses {statuses}")
