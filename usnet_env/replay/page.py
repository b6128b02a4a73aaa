"""A page of an episode that any browser opens without a network: an animation, and what happened in each round."""

from __future__ import annotations

import json
import os
import re
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from usnet_env import drawing
from usnet_env.config import format_count, instance_of
from usnet_env.files import write_html
from usnet_env.replay.animate import BESIDE, list_scenes, write_frames
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import annotated_uavs, describe_outcome, describe_round, name_game, name_round, name_uav

_FRAMES, _DPI = 3, 75  # frames of a growing window, pixels per inch
_MAX_ROUNDS = 12  # of the animation; the text has all of them
#: Characters in place of the icons of matplotlib's page, whose font would be fetched from the network.
_ICONS = {
    "minus": "−", "plus": "+", "fast-backward": "|◀", "fast-forward": "▶|", "step-backward": "◁", "step-forward": "▷",
    "play fa-flip-horizontal": "◀", "play": "▶", "pause": "||",
}  # fmt: skip
#: Says below the animation which UAV is under the pointer: the nearest one in either map of the frame that is shown.
_POINTER = """
<p id="pointed" role="status">Point at a dot to read its name.</p>
<script>
const names = NAMES, frames = FRAMES;
document.querySelector(".animation img").onmousemove = (event) => {
  const {width, height} = event.target, x = event.offsetX / width, y = 1 - event.offsetY / height;
  let nearest = 12, name = "\u00a0";  // pixels
  frames[PLAYER.current_frame].forEach(([left, up], i) => {
    const across = Math.min(Math.abs(x - left), Math.abs(x - left - BESIDE));
    const away = Math.hypot(across * width, (y - up) * height);
    if (away < nearest) [nearest, name] = [away, names[i]];
  });
  document.getElementById("pointed").textContent = name;
};
</script>
"""


def _animate(record: EpisodeRecord) -> tuple[str, dict[int, str]]:
    """The animation of the first rounds with its controls, and for each round a button that goes there."""
    from matplotlib.animation import HTMLWriter

    drawing.new_figure(1, 1)  # refuses without matplotlib

    scenes = [scene for scene in list_scenes(record, _FRAMES) if scene.round <= _MAX_ROUNDS]
    writer = HTMLWriter(fps=1, embed_frames=True, default_mode="once", embed_limit=200)
    with TemporaryDirectory() as folder:
        path = Path(folder, "animation.html")
        painter = write_frames(record, scenes, writer, path, _DPI, rate=0)
        text = re.sub("<link[^>]*>", "", path.read_text(encoding="utf-8"))
    text = text.replace("<img id", '<img alt="animation of the episode" id')
    text = re.sub(r'<i class="fa fa-([^"]*)"></i>', lambda icon: _ICONS[icon[1]], text)
    player = re.findall(r"(anim\w+) = new Animation", text)[0]
    numbers = [scene.round for scene in scenes]
    button = ' <button onclick="{0}.pause_animation(); {0}.set_frame({1}); return false">show</button>'
    names = json.dumps([name_uav(record, i) for i in range(record.uavs)]).replace("<", r"\u003c")
    positions = [painter.locate(scene).round(3).tolist() for scene in scenes]
    values = {"NAMES": names, "FRAMES": json.dumps(positions), "PLAYER": player, "BESIDE": str(BESIDE)}
    text += re.sub("|".join(values), lambda key: values[key[0]], _POINTER)
    return text, {number: button.format(player, numbers.index(number)) for number in numbers}


def write_page(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write a page of an episode in place of an existing file; the file appears whole.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    instance_of("record", record, EpisodeRecord)
    note = f" The animation shows the first {format_count(_MAX_ROUNDS, name_round(record).lower())}."
    animation, buttons = _animate(record)
    rounds = []
    for number in range(1, record.rounds + 1):
        rows = [(name_uav(record, i), mark, reason) for i, mark, reason in annotated_uavs(record, number)]
        lines = "".join(f"<li><b>{escape(uav)}</b> {mark}, {escape(reason)}</li>" for uav, mark, reason in rows)
        title = escape(f"{name_round(record)} {number}: {describe_round(record, number)}") + buttons.get(number, "")
        rounds.append(f"<details{' open' * (number == 1)}><summary>{title}</summary><ul>{lines}</ul></details>")
    outcome = f"<p>{escape(describe_outcome(record))}{note * (record.rounds > _MAX_ROUNDS)}</p>"
    write_html(path, name_game(record), f"{outcome}\n{animation}{''.join(rounds)}\n")
    return Path(path)
