"""How the pages are built: ``make docs``."""

from __future__ import annotations

import re
import sys
from importlib.metadata import metadata
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from pages import write_pages

project = "USNET"
author = "the USNET maintainers"
copyright = "2026, the USNET maintainers"
release = version = installed_version("usnet")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # equations are drawn without a network
]
# Parts that docs/field.md and docs/probing.md include; they are no pages.
PARTS = ("field_models", "controls", "kinematics", "probing")
exclude_patterns = ["_build", *(f"generated/{part}.md" for part in PARTS)]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
autodoc_type_aliases = {name: name for name in ("Floats", "Singles", "Mask", "Indices")}  # arrays; docs/api.md
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"USNET {release}"
html_static_path = ["_static"]
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


def _drop_limits(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, signature: str | None, back: str) -> Any:
    """Write ``float`` for ``Annotated[float, Field(ge=0)]``; the docstring has the limits."""
    return signature and re.sub(r"Annotated\[(.*?), Field\([^)]*\)\]", r"\1", signature), back


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx looks for them."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir)))
    app.connect("autodoc-process-docstring", _keep_bars)
    app.connect("autodoc-process-signature", _drop_limits)
