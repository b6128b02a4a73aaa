"""Everything that the pages show is run, and what they say about the environments is compared with the code."""

import importlib
import inspect
import multiprocessing
import os
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import usnet_env.envs
from usnet_env.cli import main
from usnet_env.envs import ENVIRONMENTS
from usnet_env.multiagent import GAMES

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
WRITTEN = sorted(path for folder in ("envs", "detector", "results") for path in (ROOT / "docs" / folder).glob("*.md"))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
MARK = "--- end of a block ---"
FENCE = re.compile(r"^```(?P<kind>[^`\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
LEFT_ALONE = {"cd", "git", "make", "pip", "python", "rerun", "source"}  # also shown: tested elsewhere, or a viewer


PACKAGES = {"stone_soup_tracks": "stonesoup"}  # examples of extras that are not installed for the tests
PREPARED = {"tracks.md": "make_tracks.py"}  # the example that a page runs first, for its files


def prepare(page: Path, folder: Path) -> None:
    if page.name in PREPARED:
        run(ROOT / "examples" / PREPARED[page.name], folder)


def python_of(page: Path) -> str:
    """The page's Python blocks as one program, each line where it stands in the page; a mark is printed after each."""
    text = page.read_text(encoding="utf-8")
    program = ["\n"] * text.count("\n")
    for block in FENCE.finditer(text):
        if block["kind"] == "python":
            first = text.count("\n", 0, block.start("text"))
            lines = block["text"].splitlines(keepends=True)
            program[first : first + len(lines)] = lines
            program[first + len(lines)] = f"print({MARK!r})\n"
    return "".join(program)


def commands_of(page: Path) -> list[list[str]]:
    """All commands that the page shows: every line of a bash block, the lines with a prompt of a console block."""
    commands = []
    for block in FENCE.finditer(page.read_text(encoding="utf-8")):
        lines = block["text"].replace("\\\n", " ").splitlines()
        if block["kind"] == "console":
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        elif block["kind"] != "bash":
            continue
        commands += [words for line in lines if (words := shlex.split(line, comments=True))]
    return commands


def usnet_commands_of(page: Path) -> list[list[str]]:
    """What the page gives to the command line of this project, without its name."""
    names = (["usnet"], ["python", "-m", "usnet_env"])
    return [
        command[len(name) :] for command in commands_of(page) for name in names if command[: len(name)] == list(name)
    ]


def outputs_of(page: Path) -> list[tuple[int, str]]:
    """What the page says that its Python blocks print: the number of a block from 0, and the text of its output."""
    blocks = [each for each in FENCE.finditer(page.read_text(encoding="utf-8")) if each["kind"] in ("python", "output")]
    programs = [block["kind"] == "python" for block in blocks]
    return [
        (sum(programs[:number]) - 1, block["text"]) for number, block in enumerate(blocks) if block["kind"] == "output"
    ]


def tables_of(page: Path) -> list[str]:
    """The lines of the page's text blocks, with single spaces."""
    blocks = [each["text"] for each in FENCE.finditer(page.read_text(encoding="utf-8")) if each["kind"] == "text"]
    return [" ".join(line.split()) for block in blocks for line in block.splitlines()]


def play(program: Path | list[list[str]], folder: Path) -> None:
    """Run a script, or commands of the command line, in this process; what they print goes to a file."""
    os.chdir(folder)
    with open("printed.txt", "w", encoding="utf-8") as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
    sys.path.insert(0, str(ROOT / "examples"))
    # An evaluation starts its worker processes anew; as copies of this one, they need not import everything once more.
    context = multiprocessing.get_context
    multiprocessing.get_context = lambda method=None: context("fork" if method == "spawn" else method)
    if isinstance(program, Path):
        sys.path.insert(0, str(program.parent))
        sys.argv = [str(program)]
        runpy.run_path(str(program), run_name="__main__")
        return
    for command in program:
        if code := main(command):
            sys.exit(f"{command} ended with {code}")


def run(program: Path | list[list[str]], folder: Path) -> str:
    """Run a script or commands in a process and a folder of their own; return what they print.

    The process is a copy of one that has imported the libraries, as all that the tests start: importing them again for
    every page takes longer than the pages do.
    """
    process = multiprocessing.get_context("spawn").Process(target=play, args=(program, folder))
    process.start()
    process.join(timeout=300)
    if process.is_alive():
        process.kill()
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    assert process.exitcode == 0, printed
    return printed


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", [page for page in PAGES if python_of(page).strip()], ids=named)
def test_the_python_of_a_page_runs(page, tmp_path):
    prepare(page, tmp_path)
    script = tmp_path / f"page_{page.stem}.py"
    script.write_text(python_of(page), encoding="utf-8")
    printed = run(script, tmp_path).split(f"{MARK}\n")
    for number, shown in outputs_of(page):
        if shown.endswith("\n…\n"):  # the page shows the first lines
            assert printed[number].startswith(shown.removesuffix("…\n"))
        else:
            assert printed[number].rstrip() == shown.rstrip()


@pytest.mark.parametrize("page", [page for page in PAGES if usnet_commands_of(page)], ids=named)
def test_the_commands_of_a_page_run(page, tmp_path):
    prepare(page, tmp_path)
    printed = run(usnet_commands_of(page), tmp_path)
    if page.name in PREPARED:  # its tables are shown with fewer spaces and rows
        lines = {" ".join(line.split()) for line in printed.splitlines()}
        assert [line for line in tables_of(page) if line not in lines] == []


@pytest.mark.parametrize("script", EXAMPLES, ids=named)
def test_an_example_runs(script, tmp_path):
    if script.stem in PACKAGES:
        pytest.importorskip(PACKAGES[script.stem])
    run(script, tmp_path)


def test_the_readme_is_short_and_shows_both():
    readme = ROOT / "README.md"
    assert len(readme.read_text(encoding="utf-8").splitlines()) <= 130
    assert "evaluate" in python_of(readme)
    assert usnet_commands_of(readme)
    assert [words for words in commands_of(readme) if words[0] == "make"][:2] == [["make", "demo"], ["make", "test"]]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_shown_command_is_known(page):
    assert {words[0] for words in commands_of(page)} <= LEFT_ALONE | {"usnet"}


@pytest.mark.parametrize("page", PAGES + WRITTEN, ids=named)
def test_links_into_the_repository_lead_somewhere(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r"src=\"([^\"]+)\"", text)
    elsewhere = ("http:", "https:", "mailto:")
    inside = [target for target in targets if not target.startswith(elsewhere)]
    assert [target for target in inside if not (page.parent / target).exists()] == []


def test_no_page_names_a_place_on_a_machine():
    for page in PAGES:
        assert not re.search(r"(?<![\w.])/(home|root|work|tmp|Users)/", page.read_text(encoding="utf-8")), page


# The pages of environments and detectors, which are their docstrings


def load_generator(name: str) -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


def test_the_committed_pages_are_what_the_docstrings_say():
    assert load_generator("pages").find_differing() == {}


def test_pages_that_differ_are_named_and_written(tmp_path, monkeypatch, capsys):
    pages = load_generator("pages")
    pages.write_pages(tmp_path / "docs")
    changed, stray = tmp_path / "docs" / "envs" / "field.md", tmp_path / "docs" / "detector" / "gone.md"
    changed.write_text("old")
    stray.write_text("a detector that has gone")
    monkeypatch.setattr(pages, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(sys, "argv", ["pages.py", "--check"])
    assert pages.main() == 1
    assert sorted(line.split()[0] for line in capsys.readouterr().err.splitlines()) == [
        "docs/detector/gone.md",
        "docs/envs/field.md",
    ]
    monkeypatch.setattr(sys, "argv", ["pages.py"])
    assert pages.main() == 0
    assert not stray.exists()
    assert changed.read_text() == (ROOT / "docs" / "envs" / "field.md").read_text()


def test_the_page_of_a_detector_lists_its_arguments_with_their_defaults():
    generator = load_generator("detector_pages")
    for name, target in generator.detector_classes().items():
        module, _, attribute = target.rpartition(".")
        page = (ROOT / "docs" / "detector" / f"{name}.md").read_text(encoding="utf-8")
        for parameter in inspect.signature(getattr(importlib.import_module(module), attribute)).parameters.values():
            assert f"`{parameter.name}={parameter.default!r}`" in page, name


def generated_pages() -> dict[str, str]:
    return load_generator("environment_pages").environment_pages()


CLASSES = sorted({f"{kind}Env" for kind, _ in ENVIRONMENTS.values()})
SECTIONS = [
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
]


def test_every_game_has_a_page_with_gymnasiums_sections():
    pages = load_generator("environment_pages").game_pages()
    assert set(pages) == set(GAMES)
    for name, text in pages.items():
        headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
        assert [heading for heading in headings if heading in SECTIONS] == SECTIONS, name


def test_the_field_page_has_every_model():
    page = (ROOT / "docs" / "field.md").read_text(encoding="utf-8")
    for table in load_generator("environment_pages").field_tables():
        assert table in page, table


def test_every_detector_is_in_the_overview_and_has_a_page():
    page = (ROOT / "docs" / "detectors.md").read_text(encoding="utf-8")
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    names = list(shipped["usnet.detectors"])
    assert [name for name in names if f"| [`{name}`](detector/{name}.md) |" not in page] == []
    generator = load_generator("detector_pages")
    pages = generator.detector_pages()
    classes = {name: target.replace(":", ".") for name, target in shipped["usnet.detectors"].items()}
    assert [name for name in names if f"autoclass:: {classes[name]}\n" not in pages[name]] == []
    assert set(generator.ASSUMPTIONS) == set(names)
    figures = [path for path, _ in generator.FIGURES.values()]
    assert [path for path in figures if not (ROOT / "docs" / "images" / path).exists()] == []


def test_the_page_of_recorded_tracks_has_gymnasiums_sections():
    text = load_generator("environment_pages").environment_pages()["tracks"]
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == SECTIONS
    assert "USNET/Tracks-v0" in text


def test_every_registered_id_stands_on_a_page():
    pages = "\n".join(generated_pages().values())
    assert [name for name in ENVIRONMENTS if f"`{name}`" not in pages] == []


@pytest.mark.parametrize("name", CLASSES)
def test_a_docstring_has_gymnasiums_sections(name):
    docstring = inspect.getdoc(getattr(usnet_env.envs, name))
    assert re.findall(r"^## (.+)$", docstring, re.MULTILINE) == SECTIONS


@pytest.mark.parametrize("name", CLASSES)
def test_a_docstring_lists_the_arguments_with_their_defaults(name):
    kind = getattr(usnet_env.envs, name)
    section = inspect.getdoc(kind).partition("## Arguments")[2].partition("## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \| `?\"?([^`\"|]+?)\"?`? \|", section, re.MULTILINE))
    defaults = {
        parameter.name: parameter.default
        for parameter in inspect.signature(kind).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    assert rows == {
        name: f"{value:g}" if type(value) in (int, float) else str(value) for name, value in defaults.items()
    }
