"""The look that all figures share: colours, markers, axes, a title with a caption, and the files of a figure."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from usnet_env.config import unknown_name
from usnet_env.files import as_path, atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The colours of Okabe and Ito, which colour-blind readers can distinguish, without their yellow. A series also has a
#: marker of its own, so that figures can be read without colours.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_SAVED: dict[str, dict[str, Any]] = {  # without the date and the versions, so that equal figures have equal bytes
    "png": {"dpi": 200, "metadata": {"Software": None}},
    "pdf": {"dpi": 200, "metadata": {"Creator": None, "Producer": None, "CreationDate": None}},
}
FORMATS = tuple(_SAVED)
_MISSING_GLYPH = "missing from font"  # in matplotlib's warnings
_MOST_FONTS = 4  # that texts fall back to
_LAST_RESORT = "Last Resort"  # fonts with a box for each character
_SIGNS_AN_INCH = 12.5  # of a caption


def escape_math(text: str) -> str:
    """Text that matplotlib shows as it is: a dollar sign begins no formula."""
    return text.replace("$", r"\$")


def style_axes(axes: Axes) -> None:
    """Give axes the look that all figures share: a faint grid behind the data, and no frame at the top and right."""
    axes.grid(color="#e3e3e3", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9, color="#888888")
    for side, spine in axes.spines.items():
        spine.set_color("#888888")
        spine.set_visible(side in ("left", "bottom"))


def caption_figure(figure: Figure, title: str, caption: str) -> None:
    """Write a title above a figure, and below it a caption: what is shown, n, and the meaning of intervals."""
    width = int(figure.get_figwidth() * _SIGNS_AN_INCH)
    figure.suptitle(f"{title}\n{fill(caption, width)}", x=0.01, ha="left", fontsize=10.5)


@contextmanager
def _name_missing_glyphs() -> Iterator[None]:
    """Replace matplotlib's warnings of missing glyphs, one for each, by one sentence."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    glyphs = [each for each in caught if _MISSING_GLYPH in str(each.message)]
    for each in caught:
        if each not in glyphs:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    if glyphs:
        text = "The fonts of this machine lack some characters of the figure; it shows boxes in their place."
        warnings.warn(text, UserWarning, stacklevel=4)


def _add_fonts(figure: Figure) -> None:
    """Let the texts of a figure fall back to installed fonts that have the characters that their own font lacks.

    Fonts are tried in the order of how many of these characters they have.
    """
    from matplotlib.font_manager import FontProperties, findfont, fontManager
    from matplotlib.ft2font import FT2Font
    from matplotlib.text import Text

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        figure.draw_without_rendering()  # labels of ticks have their texts from then on
    if not any(_MISSING_GLYPH in str(each.message) for each in caught):
        return
    texts: list[Any] = figure.findobj(Text)
    signs = {ord(sign) for text in texts for sign in text.get_text() if not sign.isspace()}
    lacking = signs - FT2Font(findfont(FontProperties())).get_charmap().keys()
    covered: dict[str, set[int]] = {}
    for entry in fontManager.ttflist if lacking else ():
        if not entry.name.startswith(_LAST_RESORT):
            with suppress(OSError, RuntimeError):  # the font was removed, or is damaged
                known = lacking & FT2Font(entry.fname).get_charmap().keys()
                covered[entry.name] = covered.get(entry.name, set()) | known
    families: list[str] = []
    while lacking and len(families) < _MOST_FONTS:
        best = max(sorted(covered), key=lambda name: len(covered[name] & lacking), default="")
        if not best or not covered[best] & lacking:
            break
        families.append(best)
        lacking -= covered[best]
    for text in texts if families else ():
        text.set_fontfamily([*text.get_fontfamily(), *families])


def write_figure(figure: Figure, path: str | os.PathLike[str], formats: Sequence[str] = ("png",)) -> list[Path]:
    """Write a figure in some formats; the same figure gives the same bytes, and each file appears whole.

    Characters that the font of a text lacks, such as Chinese ones, are written in an installed font that has them.

    Args:
        figure: the figure.
        path: the file; its suffix is replaced by that of each format.
        formats: ``"png"`` (200 pixels per inch), ``"pdf"`` (vectors, fonts embedded as TrueType), or both.

    Returns:
        The files.

    Raises:
        ArgumentError: an unknown format, or the place can't be written to.
    """
    from matplotlib import rc_context

    for kind in formats:
        if kind not in FORMATS:
            raise unknown_name("formats", kind, FORMATS)
    files = []
    _add_fonts(figure)
    for kind in formats:
        file = as_path("path", path).with_suffix(f".{kind}")
        with atomic_write(file) as aside, rc_context({"pdf.fonttype": 42}), _name_missing_glyphs():
            figure.savefig(aside, format=kind, **_SAVED[kind])  # fonttype: publishers refuse Type 3
        files.append(file)
    return files
