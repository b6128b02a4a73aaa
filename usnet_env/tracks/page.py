"""A page of the leaders that were found: sentences, a table, and the pictures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from html import escape
from pathlib import Path

from usnet_env.config import printable
from usnet_env.files import write_html

_PICTURES = {
    "network": "Who follows whom: an arrow leads to the one that is followed",
    "timeline": "Whom each id follows in each window",
    "picture": "Windows from above",
    "delays": "The delay of each follower",
}


def write_page(path: Path, title: str, sentences: Iterable[str], table: str, facts: Iterable[str]) -> None:
    """Write a page that any browser opens without a network.

    Args:
        path: of the page; pictures beside it, such as ``network.png``, become parts of it.
        title: what the tracks are.
        sentences: about the leaders.
        table: HTML.
        facts: sentences about the tracks.
    """
    pictures = [
        f'<figure><img alt="{text}" src="data:image/png;base64,{b64encode(image.read_bytes()).decode()}"></figure>'
        for name, text in _PICTURES.items()
        if (image := path.with_name(f"{name}.png")).exists()
    ]
    found, about = ("".join(f"<li>{escape(printable(line))}</li>" for line in lines) for lines in (sentences, facts))
    write_html(path, f"Leaders in {title}", f"<ul>{found}</ul>{''.join(pictures)}{table}<ul>{about}</ul>")
