"""Write the pages of the environments, games and detectors, docs/envs and docs/detector, from the docstrings.

``python docs/pages.py`` writes the pages that differ. With ``--check`` it writes nothing, names the pages that differ,
and exits with 1.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from detector_pages import detector_pages
from environment_pages import environment_pages, game_pages

__all__ = ["find_differing", "write_pages"]

DOCS = Path(__file__).parent
NOTICE = "<!-- Written by `python docs/pages.py` from the docstrings. Do not edit. -->\n\n"


def find_differing(docs: Path | None = None) -> dict[Path, str | None]:
    """The pages that are not what the docstrings say, and their text; ``None`` for a page that should not exist."""
    docs = docs or DOCS
    folders = {"envs": environment_pages() | game_pages(), "detector": detector_pages()}
    wanted = {
        docs / folder / f"{name}.md": NOTICE + text for folder, pages in folders.items() for name, text in pages.items()
    }
    known = [path for folder in folders for path in (docs / folder).glob("*.md")]
    differing: dict[Path, str | None] = {path: None for path in known if path not in wanted}
    for path, text in wanted.items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            differing[path] = text
    return differing


def write_pages(docs: Path | None = None) -> None:
    """Write the pages. Unchanged files are not touched, so that Sphinx does not read them again."""
    for path, text in find_differing(docs).items():
        if text is None:
            path.unlink()
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def main() -> int:
    """Write or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a page differs")
    if not parser.parse_args().check:
        write_pages()
        return 0
    differing = find_differing()
    for path in differing:
        print(f"{path.relative_to(DOCS.parent)} differs from the docstrings: run python docs/pages.py", file=sys.stderr)
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
