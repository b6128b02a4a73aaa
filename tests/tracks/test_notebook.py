"""The notebook runs, in the order of its cells, and its texts are those that it shows."""

import ast
import contextlib
import io
import json
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_notebook_shows_what_its_cells_give(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    cells = json.loads((EXAMPLES / "my_own_tracks.ipynb").read_text(encoding="utf-8"))["cells"]
    names, pictures = {}, 0
    for cell in (each for each in cells if each["cell_type"] == "code"):
        *before, last = ast.parse("".join(cell["source"])).body
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(ast.Module(before, []), "cell", "exec"), names)
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        (shown,) = cell["outputs"]
        if "image/png" in shown.get("data", {}):
            pictures += len(value.axes) > 0
        elif printed.getvalue():
            assert printed.getvalue() == "".join(shown["text"])
    assert pictures == 3
