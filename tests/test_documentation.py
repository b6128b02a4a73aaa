"""What the pages show is run, and what they say about environments and detectors is compared with the code.

The quick tests run the first page and one example.
"""

import doctest
import importlib
import inspect
import multiprocessing
import os
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from multiprocessing import forkserver
from pathlib import Path

import pytest
from joblib.externals.loky import get_reusable_executor

import usnet_env.envs
from usnet_env.cli import main
from usnet_env.envs import ENVIRONMENTS
from usnet_env.multiagent import GAMES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("detectors/*.md"))]
LINKED = [*PAGES, *sorted((ROOT / "docs" / "results").glob("*.md"))]
EXAMPLES = sorted([*(ROOT / "examples").glob("*.py"), *(ROOT / "examples" / "notebooks").glob("*.py")])
SOURCES = [path for package in ("usnet_env", "detectors") for path in sorted((ROOT / package).rglob("*.py"))]
DOCTESTS = [path.relative_to(ROOT) for path in SOURCES if ">>> " in path.read_text(encoding="utf-8")]
MARK = "--- end of a block ---"
FENCE = re.compile(r"^```(?P<kind>[^`\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
CLASSES = sorted({f"{kind}Env" for kind, _ in ENVIRONMENTS.values()})
SECTIONS = "Description|Action Space|Observation Space|Rewards|Starting State|Episode End|Arguments|Version History"


def cases_of(paths: list[Path], quick: str) -> list:
    """A case for each path; all but one are slow."""
    marks = {path: [] if path.name == quick else [pytest.mark.slow] for path in paths}
    return [pytest.param(path, marks=marks[path], id=name_of(path)) for path in paths]


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks_of(page: Path) -> list[tuple[str, str, int]]:
    """Kind, text and first line of the page's blocks of code."""
    text = page.read_text(encoding="utf-8")
    return [(block["kind"], block["text"], text.count("\n", 0, block.start("text"))) for block in FENCE.finditer(text)]


def python_of(page: Path) -> str:
    """The page's Python blocks as one program, each line where it stands in the page; a mark is printed after each."""
    program = ["\n"] * page.read_text(encoding="utf-8").count("\n")
    for kind, text, first in blocks_of(page):
        if kind == "python":
            lines = text.splitlines(keepends=True)
            program[first : first + len(lines) + 1] = [*lines, f"print({MARK!r})\n"]
    return "".join(program)


def outputs_of(page: Path) -> list[tuple[int, str]]:
    """What the page says that its Python blocks print: the number of a block from 0, and the text of its output."""
    blocks = blocks_of(page)
    kinds = [kind for kind, _, _ in blocks]
    return [(kinds[:i].count("python") - 1, text) for i, (kind, text, _) in enumerate(blocks) if kind == "output"]


def commands_of(page: Path) -> list[list[str]]:
    """The ``usnet`` commands of the page's bash blocks, without that name."""
    lines = [line for kind, text, _ in blocks_of(page) if kind == "bash" for line in re.split(r"(?<!\\)\n", text)]
    commands = [shlex.split(line.replace("\\\n", " "), comments=True) for line in lines]
    commands = [words[2:] if words[:2] == ["python", "-m"] else words for words in commands]
    return [words[1:] for words in commands if words[:1] in (["usnet"], ["usnet_env"])]


def play(program: Path | list[list[str]], folder: Path) -> None:
    """Run a script, or commands of the command line, in this process; what they print goes to a file."""
    os.chdir(folder)
    with open("printed.txt", "w", encoding="utf-8") as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        if isinstance(program, Path):
            sys.argv = [str(program)]
            runpy.run_path(str(program), run_name="__main__")
        for command in program if isinstance(program, list) else ():
            assert main(command) == 0, command
    finally:  # joblib's workers wait for more to do, and this process for them
        get_reusable_executor().shutdown()


def run(program: Path | list[list[str]], folder: Path) -> str:
    """Run a script or commands in a process and a folder of their own; return what they print."""
    forkserver.set_forkserver_preload(["usnet_env.evaluation", "usnet_env.cli"])
    process = multiprocessing.get_context("forkserver").Process(target=play, args=(program, folder))
    process.start()
    process.join()
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    assert process.exitcode == 0, printed
    return printed


def prepare(page: Path, folder: Path) -> None:
    if page.stem.startswith("tracks"):
        run(ROOT / "examples" / "make_tracks.py", folder)


@pytest.mark.parametrize("page", cases_of([page for page in PAGES if python_of(page).strip()], "README.md"))
def test_the_python_of_a_page_runs(page, tmp_path):
    prepare(page, tmp_path)
    script = tmp_path / f"page_{page.stem}.py"
    script.write_text(python_of(page), encoding="utf-8")
    printed = run(script, tmp_path).split(f"{MARK}\n")
    for number, shown in outputs_of(page):
        assert printed[number].rstrip() == shown.rstrip()


@pytest.mark.parametrize("page", cases_of([page for page in PAGES if commands_of(page)], "README.md"))
def test_the_commands_of_a_page_run(page, tmp_path):
    prepare(page, tmp_path)
    printed = run(commands_of(page), tmp_path)
    if page.name == "README.md":  # the demo
        sizes = {path.suffix: path.stat().st_size for path in (tmp_path / "runs" / "demo").iterdir()}
        assert set(sizes) == {".npz", ".rrd", ".png", ".html"}
        assert min(sizes.values()) > 1000
        verify = [Path(sys.executable).with_name("rerun"), "rrd", "verify", tmp_path / "runs/demo/replay.rrd"]
        subprocess.run(verify, check=True)
    if page.name == "tracks.md":  # its table is shown as in a terminal, which wraps cells
        shown = "".join(text for kind, text, _ in blocks_of(page) if kind == "text")
        table, _, events = shown.partition("\n\n")
        assert set(table.split()) - set(printed.split()) == set()
        assert set(events.splitlines()) - set(printed.splitlines()) == set()


@pytest.mark.parametrize("script", cases_of(EXAMPLES, "custom_mobility.py"))
def test_an_example_runs(script, tmp_path):
    if script.stem == "stone_soup_tracks":
        pytest.importorskip("stonesoup")
    run(script, tmp_path)


@pytest.mark.parametrize("path", DOCTESTS, ids=str)
def test_examples_in_docstrings_print_what_they_say(path):
    module = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
    assert not doctest.testmod(importlib.import_module(module)).failed


@pytest.mark.parametrize("page", LINKED, ids=name_of)
def test_links_lead_somewhere_and_no_page_names_a_place_on_a_machine(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"(?<![\w.])/(home|root|work|tmp|Users)/", text)
    inside = re.findall(r"\]\((?!https?:|mailto:)([^)#\s]+)[^)]*\)", FENCE.sub("", text))
    assert [target for target in inside if not (page.parent / target).exists()] == []


def test_every_detector_is_in_the_overview_and_its_class_on_a_page():
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    detectors = shipped["usnet.detectors"]
    overview = (ROOT / "docs" / "detectors.md").read_text(encoding="utf-8")
    assert [name for name in detectors if f"[`{name}`](" not in overview] == []
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [name for name, at in detectors.items() if f"autoclass:: {at.replace(':', '.')}\n" not in pages] == []


def test_the_pages_are_few_and_one_shows_the_class_of_the_example():
    shown = (DOCS / "plugging_in.md").read_text(encoding="utf-8")
    assert (ROOT / "examples" / "custom_detector" / "most_copied.py").read_text(encoding="utf-8") in shown
    written = [page for page in DOCS.rglob("*.md") if not {"generated", "_build"} & set(page.parts)]
    assert len(written) + len(CLASSES) + 1 + len(GAMES) <= 46


def test_the_generated_pages_have_every_id_and_gymnasiums_sections(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT / "docs")
    importlib.import_module("pages").write_pages(tmp_path)
    pages = {path.stem: path.read_text(encoding="utf-8") for path in (tmp_path / "generated").iterdir()}
    assert [name for name in ENVIRONMENTS if not any(f"`{name}`" in text for text in pages.values())] == []
    for name in [*CLASSES, "TracksEnv", *GAMES]:
        assert "|".join(re.findall(rf"^## ({SECTIONS})$", pages[name.removesuffix("Env")], re.MULTILINE)) == SECTIONS


@pytest.mark.parametrize("name", CLASSES)
def test_a_docstring_lists_the_arguments_with_their_defaults(name):
    kind = getattr(usnet_env.envs, name)
    section = inspect.getdoc(kind).partition("## Arguments")[2].partition("## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([^`|]+?)`? \|", section, re.MULTILINE))
    defaults = {key: option.default for key, option in inspect.signature(kind).parameters.items()}
    texts = {key: repr(value).replace("'", '"') for key, value in defaults.items()}
    assert rows == {key: f"{value:g}" if type(value) in (int, float) else texts[key] for key, value in defaults.items()}
