"""The command line from end to end: in this process, or in a separate one where signals and pipes matter."""

import io
import json
import subprocess
import sys
from functools import partial

import pytest

from usnet_env import cli
from usnet_env.cli import GROUP, main
from usnet_env.cli.options import parse_pairs
from usnet_env.replay import EpisodeRecord, demo
from usnet_env.replay.story import describe_round

SMALL = ["--set", "clusters=3", "--set", "uavs=20", "--set", "observation_steps=20", "--set", "max_rounds=5"]
QUICK = ["evaluate", "--detector", "destroy-all", "--episodes", "2", *SMALL]


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module of the user."""

    def write(name, source):
        (tmp_path / f"{name}.py").write_text(source)

    monkeypatch.syspath_prepend(tmp_path)
    return write


def test_values_of_set_are_json_or_yaml():
    words = ["sizes=[2, 3,4]", "noise=1e-3", "least=-2.5e-1", "jitter=true", "seed=null", "follow=f2", "all=[f1, 2.5]"]
    assert parse_pairs(words) == {
        "sizes": [2, 3, 4], "noise": 0.001, "least": -0.25, "jitter": True, "seed": None, "follow": "f2",
        "all": ["f1", 2.5],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("what", "names"),
    [
        ("envs", ["USNET/SingleCluster-v0", "USNET/MultiCluster-v0", "usnet_env.multiagent.usnet_evasion_v0"]),
        ("detectors", ["random", "none", "destroy-all", "one-per-round", "lagged-correlation", "lagged-regression"]),
        ("follow", [*(f"f{number}" for number in range(1, 8)), "none"]),
        ("mobility", ["iid", "gauss_markov", "smooth_turn", "waypoint", "straight"]),
        ("kinematics", ["unit", "limited"]),
        ("formation", ["uniform", "around", "gathered"]),
        ("clusterer", ["kmeans", "spectral"]),
        ("suites", ["paper", "controls-v2", "field-v3"]),
    ],
)
def test_list_names_all(run, what, names):
    status, out, err = run("list", what)
    assert (status, err) == (0, "")
    lines = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert set(names) <= set(lines)
    assert all(lines[name] for name in names)  # each with a description
    assert f"usnet list {what}\n" in run("list")[1]
    if what == "follow":
        assert "last three velocities of its head" in " ".join(lines["f3"])
        assert "followers copy followers" in " ".join(lines["chain"])
        assert " ".join(lines["chain-led"]).endswith("its heads follow unseen UAVs")


def test_version_and_help_whose_lines_fit_on_a_narrow_terminal(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run("--version")
    assert status == 0
    assert out.startswith("usnet ")
    for words in (["--help"], ["evaluate", "--help"], ["demo", "--help"], ["list", "-h"]):
        status, out, err = run(*words)
        assert (status, err) == (0, "")
        assert "Usage: usnet" in out
    out = run("--help")[1]
    lines = out.partition("Commands:\n")[2].splitlines()
    names = {line.split()[0] for line in lines}
    assert len(lines) == len(names)  # none is wrapped
    assert names >= {"demo", "evaluate", "detect", "replay", "report", "list", "check-detector", "train"}
    assert all(line.endswith(".") and not line.endswith("...") for line in lines), out


def test_without_a_detector_three_are_played(run):
    status, out, err = run("evaluate", "--episodes", "1", "--json", *SMALL)
    assert (status, err) == (0, "")
    assert [entry["detector"] for entry in json.loads(out)] == ["reader", "lagged-network", "lagged-regression"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("usnet eval", {"evaluate"}),
        ("usnet demo --detector lagged-", {"lagged-correlation", "lagged-network", "lagged-regression"}),
        ("usnet evaluate --suite paper-", {"paper-hard"}),
        ("usnet evaluate --env USNET/MultiCluster-N", {"USNET/MultiCluster-NoFollowers-v0"}),
        ("usnet demo --follow pig", {"pigeons"}),
    ],
)
def test_a_shell_completes_names(run, monkeypatch, words, expected):
    monkeypatch.setenv("_USNET_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    _, out, _ = run()
    assert {line.partition(",")[2] for line in out.splitlines()} == expected


EVALUATE = ["evaluate", "--detector", "none", "--episodes", "1"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--episodes", "0"], ["--episodes", "0 is not"]),
        (["--episodes", "9" * 5000], ["--episodes"]),
        (["--episodes"], ["--episodes"]),
        (["--time-limit", "0"], ["--time-limit", "0.0 is not"]),
        (["--memory-limit", "much"], ["--memory-limit", "'much'"]),
        (["--backend", "dask"], ["--backend", "'dask'", "ray"]),
        (["--env", "CartPole-v1"], ["env ", "USNET environment"]),
        (["--detector", "random(", "--trivial"], ["random("]),
        (["--detector", "x\x1b[2Jy"], ["detector", "x\\x1b[2Jy"]),
        (["--set", "follow"], ["--set", "'follow'"]),
        (["--set", "folow=f1"], ["folow", "'follow'", "miss_rate"]),
        (["--env", "USNET/SingleCluster-v0", "--set", "clusters=3"], ["clusters", "its size is 'followers'"]),
        (["--set", "follow=[1"], ["follow", "'[1'"]),
        (["--set", "follow=!!python/object:os.system"], ["follow"]),
        (["--set", "miss_rate=.nan"], ["miss_rate", "nan"]),
        (["--set", "observation_steps=1000000000000"], ["observation_steps"]),
        (["--set", "render_mode=human"], ["render_mode"]),
        (["--out", "/dev/null"], ["out", "/dev/null"]),
        (["--no-such-option"], ["--no-such-option"]),
        (["demo", "--seed", "x"], ["--seed"]),
        (["demo", "--detector", "x"], ["detector"]),
        (["demo", "--out", "/dev/null"], ["/dev/null"]),
        (["list", "nothing"], ["'nothing'"]),
        (["play"], ["'play'"]),
    ],
)
def test_bad_input_is_one_sentence_with_the_name(refused, words, expected):
    sentence = refused(*EVALUATE * words[0].startswith("-"), *words)
    assert all(word in sentence for word in expected), sentence


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (LookupError("lost\nmy way"), 1, "failed with LookupError: lost my way. USNET_TRACEBACK=1 shows where."),
        (KeyboardInterrupt(), 130, "interrupted. It goes on from here."),
        (SystemExit(3), 1, "ended by sys.exit(3) in a detector or another plug-in."),
        (MemoryError(), 1, "not enough memory; try fewer UAVs, observation steps or workers."),
        (OSError(28, "No space left on device", "rows.csv"), 1, "cannot use rows.csv: No space left on device."),
        (ModuleNotFoundError("no", name="ray"), 1, "this command needs ray; `pip install 'usnet[ray]'` installs it."),
    ],
)
def test_however_a_command_ends_it_is_one_sentence(run, monkeypatch, error, status, sentence):
    def end(context):
        context.obj = "It goes on from here."  # what a command has to say if it is interrupted
        raise error

    monkeypatch.setattr(cli._usnet, "invoke", end)
    assert run("list") == (status, "", f"usnet: {sentence}\n")
    monkeypatch.setenv("USNET_TRACEBACK", "1")
    assert "Traceback" in run("list")[2] or not isinstance(error, LookupError)


@pytest.mark.parametrize("command", ["list follow", pytest.param(" ".join(QUICK), marks=pytest.mark.slow)])
def test_a_reader_that_goes_away_ends_a_command_silently(command):
    words = [sys.executable, "-m", "usnet_env", *command.split()]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(600) in (0, 1)


def test_a_terminal_of_few_characters_loses_no_result(monkeypatch):
    shown, said = io.BytesIO(), io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, "ascii"))
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(said, "ascii"))
    assert main(QUICK) == 0
    assert b"destroy-all" in shown.getvalue()
    assert said.getvalue() == b""


@pytest.fixture
def install(monkeypatch, declare):
    source = "import click\n@click.command(short_help='Say hello.')\ndef hello(): click.echo('hello')\nplain = print\n"
    monkeypatch.setattr(cli._usnet, "commands", dict(cli._usnet.commands))
    return partial(declare, GROUP, ("foreign_command", source))


def test_a_foreign_command_is_listed_and_runs_but_replaces_none_of_this_package(install, run):
    install(greet="foreign_command:hello", evaluate="foreign_command:hello")
    assert "Say hello." in run("--help")[1]
    assert run("greet") == (0, "hello\n", "")
    assert "--detector" in run("evaluate", "--help")[1]


def test_a_broken_command_is_left_out_of_the_list_and_refused_in_one_sentence(install, run):
    install(lost="nowhere:command", other="foreign_command:plain")
    with pytest.warns(UserWarning, match="command '(lost|other)' cannot be used"):
        assert "lost" not in run("--help")[1]
    for name, reason in (("lost", "No module named 'nowhere'"), ("other", "must be a click.Command")):
        status, _, err = run(name)
        assert status == 1
        assert reason in err
        assert err.count("\n") == 1


def test_check_detector_has_a_status_for_scripts(run, module):
    module(
        "first",
        "import os\nimport numpy as np\nfrom usnet_env import Detection\nclass First:\n"
        "    def reset(self, seed=None): ...\n    def detect(self, window):\n"
        "        named = np.arange(window.uavs) == 0\n        return Detection(named, named)\n"
        "class Ends(First):\n    def detect(self, window): os._exit(0)\n",
    )
    status, out, err = run("check-detector", "first:First")
    assert (status, err) == (1, "")
    assert "failed" in out
    sentence = "usnet: detector 'first:Ends' ended the process of its checks: EXIT(0).\n"
    assert run("check-detector", "first:Ends") == (2, "", sentence)


def test_demo_takes_options_and_opens_its_replay(run, tmp_path, monkeypatch):
    """Without its picture and page, which take long."""
    opened = []
    for name in ("write_picture", "write_page"):
        monkeypatch.setattr(demo, name, lambda record, path: path)
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: opened.append(words))
    words = ["--follow", "f3", "--clusters", "2", "--uavs", "14", "--detector", "one-per-round", "--open"]
    status, out, err = run("demo", "--out", str(tmp_path / "demo"), *words)
    assert status == 0, err
    assert "14 UAVs in 2 clusters, follow strategy f3" in out
    replay = str(tmp_path / "demo" / "replay.rrd")
    assert f"rerun {replay}" in out
    assert [words[1:] for words in opened] == [[replay]]
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {"episode.npz", "replay.rrd"}
    record = EpisodeRecord.load(tmp_path / "demo" / "episode.npz")
    assert (record.uavs, record.head.sum(), record.config["follow"]) == (14, 2, "f3")
    assert f"round 1: {describe_round(record, 1)}; " in out
    assert f"J = {record.objective[-1]:.3f}" in out
