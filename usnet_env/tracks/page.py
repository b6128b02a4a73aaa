"""A page of the leaders that were found: sentences, a table, and the pictures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from pathlib import Path

from usnet_env.config import printable
from usnet_env.files import write_html
from usnet_env.tracks.leaders import FoundLeaders

_PICTURES = {
    "network": "Who follows whom: an arrow leads to the one that is followed",
    "timeline": "Whom each id follows in each window",
    "picture": "Windows from above",
    "delays": "The delay of each follower",
}


def write_page(found: FoundLeaders, path: Path, title: str, facts: Sequence[str]) -> None:
    """Write a page that any browser opens without a network.

    Args:
        found: the leaders, which sentences and a table tell.
        path: of the page; pictures beside it, such as ``network.png``, become parts of it.
        title: what the tracks are.
        facts: sentences about the tracks.
    """
    pictures = [
        f'<figure><img alt="{text}" src="data:image/png;base64,{b64encode(image.read_bytes()).decode()}"></figure>'
        for name, text in _PICTURES.items()
        if (image := path.with_name(f"{name}.png")).exists()
    ]
    told, about = (
        "".join(f"<li>{escape(printable(line))}</li>" for line in lines) for lines in (str(found).splitlines(), facts)
    )
    table = f"{found._repr_html_()}<p>By {escape(found.detector)}.</p>"
    write_html(path, f"Leaders in {title}", f"<ul>{told}</ul>{''.join(pictures)}{table}<ul>{about}</ul>")
