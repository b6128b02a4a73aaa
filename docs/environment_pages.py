"""The environments' pages: each is its class's docstring, with the registered ids in a table."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import usnet_env.envs
from usnet_env.envs import ENVIRONMENTS

__all__ = ["environment_pages", "write_environment_pages"]


def environment_pages() -> dict[str, str]:
    """Markdown by file name (without suffix), one page a class."""
    kinds = dict.fromkeys(kind for kind, _ in ENVIRONMENTS.values())
    return {re.sub(r"(?<!^)(?=[A-Z])", "_", kind).lower(): _page(kind) for kind in kinds}


def _page(kind: str) -> str:
    docstring = inspect.getdoc(getattr(usnet_env.envs, f"{kind}Env")) or ""
    summary, _, sections = docstring.partition("\n")
    ids = {name: arguments for name, (of, arguments) in ENVIRONMENTS.items() if of == kind}
    rows = "\n".join(f"| `{name}` | {_arguments(arguments)} |" for name, arguments in ids.items())
    first = next(iter(ids))
    return f"""# {kind}

{summary}

| id | arguments that it sets |
| --- | --- |
{rows}

`gym.make("usnet_env:{first}")` makes it; `gym.make_vec("{first}", num_envs=64)` makes the batched
{{class}}`usnet_env.envs.{kind}VectorEnv`, whose game b equals the single environment with the seed s + b.

{sections.strip()}
"""


def _arguments(arguments: dict[str, object]) -> str:
    return ", ".join(f"`{name}={value!r}`" for name, value in arguments.items()) or "none"


def write_environment_pages(folder: Path) -> None:
    """Write the pages; a file that is right already stays as it is, so that Sphinx need not read it again."""
    folder.mkdir(exist_ok=True)
    pages = environment_pages()
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
