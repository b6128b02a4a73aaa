"""How the pages are built: ``make docs``."""

from __future__ import annotations

import ast
import re
import sys
from contextlib import suppress
from functools import cached_property
from importlib.metadata import metadata
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from docutils import nodes
from pages import write_pages

project = "USNET"
author = "the USNET maintainers"
copyright = "2026, the USNET maintainers"
release = version = installed_version("usnet")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",  # equations are drawn without a network
]
# Parts that docs/field.md and docs/probing.md include; they are no pages.
PARTS = ("field_models", "controls", "kinematics", "probing")
templates_path = ["_templates"]
exclude_patterns = ["_build", "_templates", *(f"generated/{part}.md" for part in PARTS)]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

sphinx_gallery_conf = {  # each notebook is run, and shown with its outputs
    "examples_dirs": "../examples/notebooks",
    "gallery_dirs": "generated/notebooks",
    "filename_pattern": r"\d_",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("matplotlib", "pages.keep_picture"),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
}

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
# Arrays; docs/api.md
autodoc_type_aliases = {name: name for name in ("Floats", "Singles", "Mask", "Indices", "ArrayLike", "Observation")}
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_numpy_docstring = False

_ARRAY = "https://numpy.org/doc/stable/reference/generated/numpy.ndarray.html"
#: Where the classes of other packages are documented, by the beginnings of their names.
ELSEWHERE = {
    **dict.fromkeys(("numpy.ndarray", "Floats", "Singles", "Mask", "Indices"), _ARRAY),
    "ArrayLike": "https://numpy.org/doc/stable/reference/typing.html#numpy.typing.ArrayLike",
    "numpy.random": "https://numpy.org/doc/stable/reference/random/generator.html",
    "gymnasium.core.Env": "https://gymnasium.farama.org/api/env/",
    "gymnasium.spaces": "https://gymnasium.farama.org/api/spaces/",
    "pandas": "https://pandas.pydata.org/docs/reference/api/pandas.DataFrame.html",
    "torch.Tensor": "https://docs.pytorch.org/docs/stable/tensors.html",
    "torch.nn": "https://docs.pytorch.org/docs/stable/generated/torch.nn.Module.html",
    "Figure": "https://matplotlib.org/stable/api/figure_api.html#matplotlib.figure.Figure",
    "collections.abc": "https://docs.python.org/3/library/collections.abc.html#{}",
    "os.PathLike": "https://docs.python.org/3/library/os.html#{}",
    "pathlib.Path": "https://docs.python.org/3/library/pathlib.html#{}",
}

html_theme = "furo"
html_title = f"USNET {release}"
html_static_path = ["_static"]
html_additional_pages = dict.fromkeys(("leaderboard", "results/suites"), "moved.html")  # old addresses
html_css_files = ["usnet.css"]
html_js_files = ["usnet.js"]
html_logo = html_favicon = "_static/logo.svg"
html_theme_options: dict[str, Any] = {"navigation_with_keys": True, "sidebar_hide_name": False}
for _url in metadata("usnet").get_all("Project-URL") or ():
    if _url.startswith("Repository, "):  # then every page has a link to edit it
        html_theme_options |= {"source_repository": _url.partition(", ")[2], "source_branch": "main"}
        html_theme_options |= {"source_directory": "docs/"}


def _keep_bars(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """In our docstrings, |C| is the size of a set; in reStructuredText it would be a substitution."""
    for number, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "".join(parts)


class _PlainTypes(ast.NodeTransformer):
    """Writes ``float`` for ``Annotated[float, Field(ge=0)]``: docstrings have limits, shapes and types of arrays."""

    def visit_Subscript(self, node: ast.Subscript) -> Any:
        self.generic_visit(node)
        name = ast.unparse(node.value).rpartition(".")[2]
        if name == "Annotated" and isinstance(node.slice, ast.Tuple):
            return node.slice.elts[0]
        return node.value if name == "ndarray" else node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:  # Sphinx marks a name that it shortens by ~
        self.generic_visit(node)
        return node.operand if isinstance(node.operand, ast.BinOp) else node

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        like = ast.unparse(node).partition(" | ")[0].endswith("_Buffer")
        return ast.Name("ArrayLike") if like else self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> Any:
        self.generic_visit(node)
        return ast.Name(ast.literal_eval(node.args[0])) if ast.unparse(node.func) == "TypeAliasForwardRef" else node

    def visit_Name(self, node: ast.Name) -> Any:
        return ast.Name({"Count": "int", "Lags": "int"}.get(node.id, node.id))


def _shorten(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, signature: str | None, back: Any) -> Any:
    """Shorten the types of a signature, if it can be read."""
    with suppress(SyntaxError):
        given = re.sub("<[^<>]*>", "...", signature or "()")  # defaults without a literal
        plain = _PlainTypes().visit(ast.parse(f"def f{given} -> {back or None}: ..."))
        written, _, returned = ast.unparse(plain).partition("\n")[0].rpartition(" -> ")
        return signature and written.removeprefix("def f"), back and returned.removesuffix(":")
    return signature, back


def _link_elsewhere(_app: Any, _env: Any, node: Any, shown: nodes.TextElement) -> nodes.reference | None:
    """A link to the documentation of another package; intersphinx would fetch its inventory from the network."""
    target = node.get("reftarget", "")
    place = next((url for name, url in ELSEWHERE.items() if target == name or target.startswith(f"{name}.")), None)
    return place and nodes.reference("", "", shown, internal=False, refuri=place.format(target))


def _link_pages(_app: Any, name: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """Code leads back to a page, not to a place in it: viewcode errs where a module's objects have two prefixes."""
    if name.startswith("_modules/"):
        context["body"] = re.sub(r'(class="viewcode-back" href="[^"#]*)#[^"]*', r"\1", context["body"])


def _skip_fields(_app: Any, what: str, _name: str, obj: Any, skip: bool, _options: Any) -> bool:
    """Fields are in the docstring of their class."""
    shown = callable(obj) or isinstance(obj, property | cached_property | classmethod)
    return skip or (what == "class" and not shown)


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx looks for them."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir)))
    app.connect("autodoc-process-docstring", _keep_bars)
    app.connect("autodoc-skip-member", _skip_fields)
    app.connect("autodoc-process-signature", _shorten)
    app.connect("html-page-context", _link_pages)
    app.connect("missing-reference", _link_elsewhere)
