"""The command line from end to end: in this process, or in a separate one where signals and pipes matter."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usnet_env import cli, evaluate
from usnet_env.cli import main
from usnet_env.cli.options import parse_pairs
from usnet_env.evaluation import METRICS
from usnet_env.evaluation.environments import find_environment, list_arguments

SAMPLES = Path(__file__).parent / "evaluation"
SMALL = ["--set", "clusters=3", "uavs=20", "observation_steps=20", "max_rounds=5"]
QUICK = ["evaluate", "--detector", "destroy-all", "--episodes", "2", *SMALL]


def refused(run, words, *expected):
    status, out, err = run(*words)
    assert status == 2, err
    assert out == ""
    assert err.startswith("usnet: ")
    assert err.endswith(".\n")
    assert err.count("\n") == 1
    assert all(word in err for word in expected), err


def process(*words, variables=None, **options):
    path = os.pathsep.join(filter(None, [str(SAMPLES), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "usnet_env", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path} | (variables or {}),
        preexec_fn=restore_ctrl_c,
        **options,
    )


def restore_ctrl_c():
    """Restore SIGINT, which a shell's background job and its children ignore: the tests below send it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def living(group):
    """Command lines of a process group's members, without defunct ones (not every container's init reaps them)."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, pgrp = stat.read_text().rpartition(")")[2].split()[:3]
            if int(pgrp) == group and state != "Z":
                found.append(stat.with_name("cmdline").read_text())
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
    return found


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The words of a run that has been played, and its folder: the same words show its results once more."""
    out = tmp_path_factory.mktemp("played") / "run"
    words = ["evaluate", "--detector", "none", "--detector", "random(count=3)", "--trivial", "--episodes", "2", *SMALL]
    words += ["--out", str(out)]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main([*words, "--json"]) == 0
    return words, out, printed.getvalue()


def test_json_is_the_summary_and_nothing_else(run, played):
    status, out, err = run(*played[0], "--json")
    assert (status, err) == (0, "")
    summary = json.loads(out)
    labels = ["none", "random(count=3)", "destroy-all", "random", "one-per-round"]
    assert [entry["detector"] for entry in summary] == labels
    for entry in summary:
        assert set(entry) == {"detector", "episodes", "metrics"}
        assert entry["episodes"] == 2
        assert set(entry["metrics"]) <= set(METRICS)
        assert {"J", "rounds", "redundancy", "success", "exact", "ap_first"} <= set(entry["metrics"])
    assert summary[2]["metrics"]["J"] == {"mean": 1.85, "low": 1.85, "high": 1.85}


def test_one_ranked_table_and_a_sentence(run, played):
    """The best J is first, whatever the order of the options; every line fits a terminal of 80 columns."""
    status, out, err = run(*played[0])
    assert status == 0
    assert err == f"Rows, summary and config are in {played[1]}.\n"
    lines = out.splitlines()
    names = [
        line.split()[0] for line in lines if line and line.split()[0] in {"destroy-all", "none", "random(count=3)"}
    ]
    assert names[0] == "destroy-all"
    assert sorted(names[:3]) == sorted({"destroy-all", "none", "random(count=3)"})
    assert sum("J_m↓" in line for line in lines) == 1
    assert all(heading in out for heading in ("rounds↓", "redundancy↓", "exact↑", "F1↑", "s↓"))
    assert max(map(len, lines)) <= 80
    assert lines[-1] == "destroy-all has the lowest J_m: 1.850 in every episode."
    assert "precision" not in out


def test_all_prints_the_table_of_all_metrics(run, played):
    status, out, _ = run(*played[0], "--all")
    assert status == 0
    for word in ("destroy-all", "random", "J", "redundancy", "precision", "AP", "seconds", "in round 1", "1.850"):
        assert word in out


def test_one_set_takes_every_pair_and_may_repeat(run, played):
    many = run(
        "evaluate", "--set", "clusters=3", "--detector", "random(count=3)", "--set=uavs=20", "observation_steps=20",
        "--set", "max_rounds=5", "--json", "--episodes", "2",
    )  # fmt: skip
    (entry,) = json.loads(many[1])
    (one,) = [each for each in json.loads(played[2]) if each["detector"] == entry["detector"]]
    del one["metrics"]["seconds_per_round"], entry["metrics"]["seconds_per_round"]
    assert entry == one


def test_whole_numbers_are_decimal(run):
    """YAML 1.1 reads 0100 as 64, and 1:30 as 90."""
    assert parse_pairs(["uavs=0100", "sizes=[010, 0x10, 1_0]"]) == {"uavs": 100, "sizes": [10, "0x10", "1_0"]}
    status, _, err = run(*QUICK[:5], "--set", "uavs=1:30")
    assert status == 2
    assert "uavs must be a whole number, got '1:30'." in err


def test_values_are_yaml(run, tmp_path):
    words = ["cluster_sizes=[2, 3,4]", "clusters=3", "uavs=12", "position_noise=1e-3", "head_jitter=true", "follow=f2"]
    status, _, err = run(
        *QUICK[:5], "--set", "follow_seed=null", "observation_steps=20", *words, "--out", str(tmp_path)
    )
    assert status == 0, err
    assert json.loads((tmp_path / "run.json").read_text())["config"]["env_kwargs"] == {
        "follow_seed": None,
        "observation_steps": 20,
        "cluster_sizes": [2, 3, 4],
        "clusters": 3,
        "uavs": 12,
        "position_noise": 0.001,
        "head_jitter": True,
        "follow": "f2",
    }


def test_out_keeps_the_run_and_the_same_command_reads_it(run, played):
    words, folder, first = played
    second = run(*words, "--json")
    assert second == (0, first, "")
    with open(folder / "episodes.csv", newline="") as file:
        assert [row["episode"] for row in csv.DictReader(file)] == ["0", "1"] * 5
    refused(run, [*words, "--seed", "9", "--json"], "out must be", "seed")


def test_arguments_of_a_detector_and_two_workers(run):
    name = "lagged-correlation(clusters=3)"
    status, out, err = run("evaluate", "--detector", name, "--episodes", "3", *SMALL, "--json", "--workers", "2")
    assert (status, err) == (0, "")
    (theirs,) = json.loads(out)
    (ours,) = evaluate("USNET/MultiCluster-v0", name, episodes=3, env_kwargs=parse_pairs(SMALL[1:])).summary
    assert ours["detector"] == name
    for entry in (ours, theirs):
        del entry["metrics"]["seconds_per_round"]
    assert ours == theirs


@pytest.mark.parametrize(
    ("what", "names"),
    [
        ("envs", ["USNET/SingleCluster-v0", "USNET/MultiCluster-v0", "usnet_env.multiagent.usnet_evasion_v0"]),
        ("detectors", ["random", "none", "destroy-all", "one-per-round", "lagged-correlation", "lagged-regression"]),
        ("follow", [*(f"f{number}" for number in range(1, 8)), "none"]),
        ("mobility", ["iid", "gauss_markov", "smooth_turn", "waypoint", "straight"]),
        ("formation", ["uniform", "around"]),
        ("placement", ["grid", "uniform"]),
        ("fusion", ["union", "majority", "scores"]),
        ("clusterer", ["kmeans", "spectral", "lead-votes"]),
    ],
)
def test_list_names_all(run, what, names):
    status, out, err = run("list", what)
    assert (status, err) == (0, "")
    lines = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert set(names) <= set(lines)
    assert all(lines[name] for name in names)  # each with a description


def test_the_list_of_environments_repeats_no_sentence(run):
    lines = [line.split(maxsplit=1) for line in run("list", "envs")[1].splitlines()]
    assert len({description.strip() for _, description in lines}) == len(lines)
    texts = {name: description.strip() for name, description in lines}
    assert texts["USNET/MultiCluster-M8-v0"] == "USNET/MultiCluster-v0 with clusters=8, uavs=185"


def test_the_help_of_evaluate_has_every_argument_and_an_example(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    out = run("evaluate", "--help")[1]
    assert "usnet evaluate --detector lagged-regression --trivial" in out
    words = set(out.replace(",", " ").replace(";", " ").partition("Arguments for --set:")[2].split())
    for name in ("USNET/MultiCluster-v0", "USNET/SingleCluster-v0"):
        arguments = list_arguments(find_environment(name))
        assert set(arguments) <= words
    assert max(map(len, out.splitlines())) <= 80


def test_version_and_help(run):
    status, out, _ = run("--version")
    assert status == 0
    assert out.startswith("usnet ")
    for words in (["--help"], ["evaluate", "--help"], ["demo", "--help"], ["list", "-h"]):
        status, out, err = run(*words)
        assert (status, err) == (0, "")
        assert "Usage: usnet" in out


@pytest.mark.parametrize("group", [[], ["train"], ["reproduce"]])
def test_short_helps_fit_on_one_line_of_a_narrow_terminal(run, monkeypatch, group):
    monkeypatch.setenv("COLUMNS", "80")
    out = run(*group, "--help")[1]
    lines = out.partition("Commands:\n")[2].splitlines()
    shown = cli._usnet.get_command(None, group[0]) if group else cli._usnet
    assert len(lines) == len(shown.list_commands(None))  # none is wrapped
    assert all(line.endswith(".") and not line.endswith("...") for line in lines), out


def test_help_imports_nothing_heavy(fresh_process):
    code = "import sys; from usnet_env.cli import main; main(['--help']); print([m for m in {!r} if m in sys.modules])"
    heavy = ["torch", "sklearn", "scipy.stats", "rich.table", "matplotlib", "rerun", "usnet_env.evaluation"]
    assert fresh_process.run(code.format(heavy)).splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], []),
        (["--episodes", "0"], ["--episodes", "'0'"]),
        (["--episodes", "-3"], ["--episodes", "'-3'"]),
        (["--episodes", "2.5"], ["--episodes", "'2.5'"]),
        (["--episodes", "nan"], ["--episodes", "'nan'"]),
        (["--episodes", "many"], ["--episodes", "'many'"]),
        (["--episodes", "9" * 5000], ["--episodes"]),
        (["--episodes"], ["--episodes"]),
        (["--time-limit", "0"], ["--time-limit", "'0'"]),
        (["--memory-limit", "much"], ["--memory-limit", "'much'"]),
        (["--seed", "-1"], ["--seed", "'-1'"]),
        (["--seed", "1e3"], ["--seed", "'1e3'"]),
        (["--seed", str(2**63)], ["--seed"]),
        (["--seed", ""], ["--seed", "''"]),
        (["--workers", "0"], ["--workers", "'0'"]),
        (["--workers", "inf"], ["--workers", "'inf'"]),
        (["--workers", "100000"], ["--workers", "4096"]),
        (["--backend", "dask"], ["--backend", "'dask'", "ray"]),
        (["--backend", "serial", "--workers", "2"], ["workers must be 1 if backend is 'serial'"]),
        (["--address", "auto"], ["address must be None unless backend is 'ray'"]),
        (["--env", "USNET/MultiCluster"], ["env ", "USNET/MultiCluster-v0"]),
        (["--env", "Usnet/Multicluster-v0"], ["env ", "USNET/MultiCluster-v0"]),
        (["--env", "CartPole-v1"], ["env ", "USNET environment"]),
        (["--env", ""], ["env "]),
        (["--env", "nowhere:X-v0"], ["env ", "nowhere"]),
        (["--detector", "lagged-regresion"], ["lagged-regression"]),
        (["--detector", "random(seeed=1)"], ["seeed"]),
        (["--detector", "random(", "--trivial"], ["random("]),
        (["--detector", "nowhere:Missing"], ["nowhere"]),
        (["--detector", ""], ["detector"]),
        (["--detector", "destroy-all"], ["detector", "twice"]),
        (["--set"], ["--set"]),
        (["--set", "--json"], ["--set"]),
        (["--set", "follow"], ["--set", "'follow'"]),
        (["--set", "=f1"], ["--set", "'=f1'"]),
        (["--set", "follow=f1", "follow=f2"], ["--set", "follow"]),
        (["--set", "folow=f1"], ["folow", "'follow'", "miss_rate"]),
        (["--env", "USNET/SingleCluster-v0", "--set", "clusters=3"], ["clusters", "its size is 'followers'"]),
        (["--set", "follow=f9"], ["follow", "'f9'"]),
        (["--set", "follow={a: 1}"], ["follow"]),
        (["--set", "follow=[1"], ["follow", "'[1'"]),
        (["--set", "follow=[[1]]"], ["follow"]),
        (["--set", "follow=2020-01-01"], ["follow"]),
        (["--set", "follow=!!python/object:os.system"], ["follow"]),
        (["--set", "miss_rate=.nan"], ["miss_rate", "nan"]),
        (["--set", "miss_rate=-1"], ["miss_rate", "-1"]),
        (["--set", "miss_rate=high"], ["miss_rate", "'high'"]),
        (["--set", "position_noise=.inf"], ["position_noise", "inf"]),
        (["--set", "observation_steps=0"], ["observation_steps", "0"]),
        (["--set", "observation_steps=1000000000000"], ["observation_steps"]),
        (["--set", "decoys=1.5"], ["decoys", "1.5"]),
        (["--set", "render_mode=human"], ["render_mode"]),
        (["--set", "max_episode_steps=3"], ["max_episode_steps"]),
        (["--out", "/dev/null"], ["out", "/dev/null"]),
        (["--no-such-option"], ["--no-such-option"]),
        (["stray"], ["stray"]),
    ],
)
def test_bad_input_is_one_sentence_with_the_name(run, words, expected):
    if not words:
        refused(run, ["evaluate", "--episodes", "1"], "--detector")
        return
    base = ["evaluate", "--detector", "destroy-all"]
    rest = [] if words[0] == "--episodes" else ["--episodes", "1"]
    refused(run, [*base, *rest, *words], *expected)


@pytest.mark.parametrize(
    "words", [["demo", "--seed", "x"], ["demo", "--detector", "x"], ["list", "nothing"], ["play"], ["--x"]]
)
def test_the_other_commands_refuse_in_one_sentence_too(run, words):
    refused(run, words)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["--episodes", "--seed", "--workers"]),
    st.one_of(st.text(max_size=8), st.floats().map(str), st.integers(max_value=-1).map(str)),
)
def test_no_word_after_a_number_s_option_brings_a_traceback(option, word):
    with contextlib.redirect_stderr(io.StringIO()) as err, contextlib.redirect_stdout(io.StringIO()):
        status = main([*QUICK[:3], option, word, "--set", "uavs=0"])  # so that a good number ends at once as well
    assert status == 2
    assert err.getvalue().startswith("usnet: ")
    assert "Traceback" not in err.getvalue()


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=12), st.text(max_size=12))
def test_no_pair_brings_a_traceback(key, value):
    with contextlib.redirect_stderr(io.StringIO()) as err, contextlib.redirect_stdout(io.StringIO()):
        status = main([*QUICK[:3], "--set", "uavs=0", f"--set={key}={value}"])
    assert status == 2
    assert err.getvalue().startswith("usnet: ")
    assert "Traceback" not in err.getvalue()


def test_a_failing_detector_is_one_sentence(run, monkeypatch):
    monkeypatch.syspath_prepend(str(SAMPLES))
    words = ["evaluate", "--episodes", "4", *SMALL, "--detector", "sample_detectors:Failing"]
    refused(run, words, "sample_detectors:Failing", "episode 2", "ZeroDivisionError")


def test_a_detector_that_ends_its_process_is_a_failure_and_one_that_prints_breaks_no_json(run, monkeypatch):
    monkeypatch.syspath_prepend(str(SAMPLES))
    words = [*QUICK, "--json", "--detector", "sample_detectors:Printing", "--detector", "sample_detectors:Ending"]
    status, out, err = run(*words)
    assert status == 2
    assert [entry["detector"] for entry in json.loads(out)] == ["destroy-all", "sample_detectors:Printing"]
    assert err.startswith("usnet: detector 'sample_detectors:Ending' failed in episode ")
    assert err.endswith("round 2: it ended its process with status 0.\n")
    assert err.count("\n") == 1


def test_a_typo_in_an_argument_leaves_no_run_behind(run, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(SAMPLES))
    words = [*QUICK, "--out", str(tmp_path / "run"), "--detector"]
    refused(run, [*words, "sample_detectors:Demanding(clusters='three')"], "clusters must be a whole number")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_of_few_characters_loses_no_result(encoding):
    running = process(*QUICK, variables={"PYTHONIOENCODING": encoding}, encoding=encoding)
    out, err = running.communicate(timeout=120)
    assert (running.returncode, err) == (0, "")
    assert "destroy-all" in out


def test_a_closed_standard_error_fails_nothing():
    done = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m usnet_env list envs 2>&-"], capture_output=True, check=True
    )
    assert b"USNET/MultiCluster-v0" in done.stdout


def test_a_current_folder_that_was_removed_is_one_sentence(run, tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    refused(run, ["list", "envs"], "the current folder must exist")


def test_a_bug_is_one_sentence_and_can_be_looked_at(run, monkeypatch):
    import usnet_env.evaluation

    def broken(*_, **__):
        raise LookupError("lost\nmy way")

    monkeypatch.setattr(usnet_env.evaluation, "evaluate", broken)
    status, _, err = run(*QUICK)
    assert status == 1
    assert err == "usnet: failed with LookupError: lost my way. USNET_TRACEBACK=1 shows where.\n"
    monkeypatch.setenv("USNET_TRACEBACK", "1")
    assert "Traceback" in run(*QUICK)[2]


def test_a_disk_that_cannot_be_written_is_one_sentence(run, tmp_path):
    if os.geteuid() == 0:
        target = "/proc/nowhere/run"  # root writes anywhere but here
    else:
        tmp_path.chmod(0o500)
        target = str(tmp_path / "run")
    status, out, err = run(*QUICK, "--out", target)
    assert (status, out) == (1, "")
    assert err.startswith("usnet: cannot use ")
    assert err.count("\n") == 1


def _has_a_row(path):
    """Whether the table holds more than its header; the header is written first."""
    return path.exists() and path.read_bytes().count(b"\n") > 1


@pytest.mark.parametrize(
    ("how", "workers"),
    [
        pytest.param("ctrl-c", 1, marks=pytest.mark.slow),
        ("ctrl-c", 2),
        pytest.param("killed", 2, marks=pytest.mark.slow),
    ],
)
def test_a_stopped_run_leaves_whole_files_and_the_same_command_resumes(run, monkeypatch, tmp_path, how, workers):
    words = ["evaluate", "--detector", "sample_detectors:Slow", "--episodes", "12", *SMALL, "--json"]
    words += ["--out", str(tmp_path), "--workers", str(workers)]
    rows = tmp_path / "episodes.csv"
    running = process(*words, start_new_session=True)
    deadline = time.monotonic() + 60
    while not _has_a_row(rows) and time.monotonic() < deadline and running.poll() is None:
        time.sleep(0.02)
    if how == "killed":
        running.kill()
    else:
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to the process and to its workers
    out, err = running.communicate(timeout=30)
    assert out == ""
    if how == "ctrl-c":
        assert running.returncode == 130, err
        kept = f"Finished episodes are kept in {tmp_path}; the same command resumes from there."
        assert err == f"usnet: interrupted. {kept}\n"
        assert {path.name for path in tmp_path.iterdir()} == {"run.json", "episodes.csv"}
    deadline = time.monotonic() + 5  # workers and the standard library's helper end a moment after their parent
    while living(running.pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert living(running.pid) == []
    finished = rows.read_text().splitlines()[1:]
    assert 1 <= len(finished) < 12
    monkeypatch.syspath_prepend(str(SAMPLES))
    status, out, err = run(*words)
    assert status == 0, err
    assert json.loads(out)[0]["episodes"] == 12
    whole = rows.read_text().splitlines()[1:]
    assert set(finished) <= set(whole)  # seconds and all: none was played again
    assert len(whole) == 12


class Stopping:
    """Is interrupted in its first answer."""

    def reset(self, seed=None):
        pass

    def detect(self, window):
        raise KeyboardInterrupt


@pytest.mark.parametrize("where", ["env", "suite"])
def test_an_interruption_before_the_first_episode_points_to_no_folder(run, monkeypatch, tmp_path, where):
    out = tmp_path / "run"
    monkeypatch.setattr("usnet_env.evaluation.agents.make_detector", lambda name: Stopping())
    if where == "env":
        words = ["--backend", "serial", *SMALL]
    else:
        words = ["--suite", "controls", "--cell", "decoys"]
        monkeypatch.setattr("usnet_env.evaluation.frozen_suites.evaluate", stop)
    status, shown, err = run("evaluate", "--detector", "none", "--episodes", "2", "--out", out, *words)
    assert (status, shown, err) == (130, "", "usnet: interrupted. No episode was finished.\n")


def stop(*_, **__):
    raise KeyboardInterrupt


def test_a_reader_that_goes_away_leaves_no_traceback():
    running = process("list", "envs")
    running.stdout.close()
    with running:
        err = running.stderr.read()
    assert "Traceback" not in err
    assert "Exception" not in err


def test_demo_says_where_it_cannot_write(run):
    status, _, err = run("demo", "--out", "/dev/null")
    assert status == 2
    assert err.startswith("usnet: ")
    assert "/dev/null" in err
    assert err.count("\n") == 1


def test_demo_plays_and_leaves_its_files(run, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: opened.append(words))
    words = ["--follow", "f3", "--clusters", "2", "--uavs", "14", "--detector", "one-per-round", "--open"]
    status, out, err = run("demo", "--out", str(tmp_path / "demo"), *words)
    assert status == 0, err
    assert "14 UAVs in 2 clusters, follow strategy f3, seed 3; detector one-per-round." in out
    assert [words[1:] for words in opened] == [[str(tmp_path / "demo" / "replay.rrd")]]
    suffixes = {path.suffix for path in (tmp_path / "demo").iterdir()}
    assert suffixes == {".npz", ".rrd", ".png", ".html"}
