"""What commands print into pipes and files."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "words", [["evaluate", "--detector", "none", "--episodes", "1", "--all"], ["check-detector", "none"]]
)
def test_lines_in_a_file_are_not_padded(run, words):
    _, out, _ = run(*words)
    assert out
    assert all(line == line.rstrip() for line in out.splitlines())


def test_list_without_a_word_says_what_can_be_listed(run):
    status, out, err = run("list")
    assert (status, err) == (0, "")
    assert "usnet list detectors\n" in out


# The table is printed by Rich, which turns a closed pipe into SystemExit.
PROGRAM = """
import sys
import usnet_env.cli as cli
from usnet_env.cli import output
from rich.console import Console

def invoke(context):
    for _ in range(10_000):
        Console(width=80).print("x" * 79)

cli._usnet.invoke = invoke
sys.exit(cli.main(["list", "follow"]))
"""


@pytest.mark.parametrize("command", [["-c", PROGRAM], ["-m", "usnet_env", "list", "follow"]])
def test_a_closed_pipe_ends_a_command_silently(command):
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) in (0, 1)
