"""Commands that packages add to ``usnet`` by entry points."""

import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from usnet_env.cli import commands, main

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OWN = PROJECT["entry-points"][commands.GROUP]


@pytest.fixture
def install(monkeypatch, tmp_path):
    """Install a module with a command, by entry points of the names given."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "foreign_command.py").write_text(
        "import click\n@click.command(short_help='Say hello.')\ndef hello():\n    click.echo('hello')\nplain = print\n"
    )

    def installer(**values):
        points = [EntryPoint(name.replace("_", "-"), value, commands.GROUP) for name, value in values.items()]
        monkeypatch.setattr(commands, "entry_points", lambda group: points)
        commands.find_entry_points.cache_clear()

    yield installer
    commands.find_entry_points.cache_clear()
    sys.modules.pop("foreign_command", None)


def test_the_commands_of_this_package_are_found_and_load():
    found = commands.find_entry_points(commands.GROUP)
    assert {name: found[name].value for name in OWN} == OWN
    assert all(point.load().name == name for name, point in found.items())


def test_a_foreign_command_is_listed_and_runs(install, capsys):
    install(greet="foreign_command:hello")
    assert main(["--help"]) == 0
    assert "greet           Say hello." in capsys.readouterr().out
    assert main(["greet"]) == 0
    assert capsys.readouterr().out == "hello\n"


def test_a_broken_command_is_left_out_of_the_list_and_refused_in_one_sentence(install, capsys):
    install(lost="nowhere:command", other="foreign_command:plain")
    with pytest.warns(UserWarning, match="command '(lost|other)' cannot be used"):
        assert main(["--help"]) == 0
    assert "lost" not in capsys.readouterr().out
    for name, reason in (("lost", "No module named 'nowhere'"), ("other", "must be a click.Command")):
        assert main([name]) == 1
        said = capsys.readouterr().err
        assert reason in said
        assert said.count("\n") == 1


def test_the_commands_of_this_package_cannot_be_replaced(install, capsys):
    install(reproduce="foreign_command:hello", evaluate="foreign_command:hello")
    for name in ("reproduce", "evaluate"):
        assert main([name, "--help"]) == 0
        assert f"Usage: usnet {name}" in (said := capsys.readouterr().out)
        assert "--" in said.partition("Options:")[2].replace("--help", "") or "Commands:" in said
