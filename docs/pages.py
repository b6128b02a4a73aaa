"""Write docs/generated: the docstring of each environment and game as a page, and the tables of docs/field.md."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

import usnet_env.envs
from usnet_env.envs import ENVIRONMENTS
from usnet_env.envs.probing import ProbingEnv
from usnet_env.multiagent import GAMES
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS
from usnet_env.swarm.kinematics import KINEMATICS
from usnet_env.tracks.env import TracksEnv

PICTURES = Path(__file__).parent / "images" / "environments"  # drawn by pictures.py


def write_pages(docs: Path) -> None:
    """Write the pages. Unchanged files are not touched, so that Sphinx does not read them again."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    for name, text in generate_pages().items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def generate_pages() -> dict[str, str]:
    """Markdown of all pages, by file name without suffix."""
    kinds = dict.fromkeys(kind for kind, _ in ENVIRONMENTS.values())
    pages = {kind: _environment_page(kind) for kind in kinds}
    pages["Tracks"] = _page("Tracks", TracksEnv, "It needs `path`, a file of tracks.")
    for game in GAMES:
        module = importlib.import_module(f"usnet_env.multiagent.{game}")
        use = f"After `from usnet_env.multiagent import {game}`, `{game}.parallel_env()` creates it."
        pages[game] = _page(game, module.parallel_env, use)
    return pages | {
        "probing": f"## Description{(inspect.getdoc(ProbingEnv) or '').partition('## Description')[2]}\n",
        "field_models": _models_page(FIELD_MODELS),
        "controls": _models_page(CONTROLS),
        "kinematics": _models_page({name: part for name, part in KINEMATICS.items() if dataclasses.is_dataclass(part)}),
    }


def keep_picture(_block: Any, variables: Mapping[str, Any], gallery: Mapping[str, Any]) -> str:
    """Show the figure that ends a cell of a notebook, as Jupyter does; sphinx-gallery calls this after each cell."""
    shown = variables["example_globals"].get("___")
    if not hasattr(shown, "_repr_png_"):
        return ""
    variables["example_globals"]["___"] = None  # its text is not shown, too
    path = Path(next(variables["image_path_iterator"]))
    path.write_bytes(shown._repr_png_())
    return str(figure_rst([str(path)], gallery["src_dir"]))


def _environment_page(kind: str) -> str:
    ids = {name: arguments for name, (of, arguments) in ENVIRONMENTS.items() if of == kind}
    rows = [(f"`{name}`", _list_values(arguments)) for name, arguments in ids.items()]
    ids_table = _table(("id", "arguments that it sets"), rows)
    create = f'`gym.make("usnet_env:{next(iter(ids))}")` creates one'
    use = f"{ids_table}\n\n{create}, `gym.make_vec` a batch, {{class}}`usnet_env.envs.{kind}VectorEnv`."
    return _page(kind, getattr(usnet_env.envs, f"{kind}Env"), use)


def _page(title: str, described: type, use: str) -> str:
    summary, _, sections = (inspect.getdoc(described) or "").partition("\n")
    found = [each for kind in ("*-moving", "-v*", "") for each in PICTURES.glob(f"{title}{kind}.webp")]
    shown = f"![A game, with the truth](../images/environments/{found[0].name})\n\n" if found else ""
    return f"# {title}\n\n{summary}\n\n{shown}{use}\n\n{sections.strip()}\n"


def _models_page(models: Mapping[str, Any]) -> str:
    """Two tables of parts of the simulator: what each breaks, and how it flies."""
    breaks = [(f"`{name}`", part.breaks, getattr(part, "citation", "") or part.source) for name, part in models.items()]
    flights = [(f"`{name}`", f"`{part.equation}`", _list_values(_parameters(part))) for name, part in models.items()]
    assumptions = _table(("name", "breaks the assumption", "source"), breaks)
    equations = _table(("name", "equation", "parameters"), flights)
    return f"{assumptions}\n\n<details><summary>The equations</summary>\n\n{equations}\n\n</details>\n"


def _parameters(part: Any) -> dict[str, object]:
    names = part.parameters if hasattr(part, "parameters") else [field.name for field in dataclasses.fields(part)]
    return {name: getattr(part, name) for name in names}


def _list_values(values: Mapping[str, object]) -> str:
    return ", ".join(f"`{name}={value!r}`" for name, value in values.items()) or "none"


def _table(headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [headings, ("---",) * len(headings), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |" for cells in lines)
