"""What ``usnet detect`` says of the files of examples/make_tracks.py, which a change of structure must keep.

python tests/golden/test_golden.py    # writes detect.json anew
"""

import io
import json
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

from usnet_env.cli import main

FILE = Path(__file__).parent / "detect.json"
SCRIPT = Path(__file__).parents[2] / "examples" / "make_tracks.py"
DETECTOR = "lagged-network"  # the default's weights may change


def detect_all(folder):
    """The answers by the name of the file."""
    subprocess.run([sys.executable, SCRIPT], cwd=folder, check=True, capture_output=True)
    answers = {}
    for file in sorted(Path(folder).glob("*.csv")):
        with redirect_stdout(io.StringIO()) as printed:
            assert main(["detect", str(file), "--detector", DETECTOR, "--json"]) == 0
        answers[file.name] = read_answers(printed.getvalue())
    return answers


def read_answers(text):
    """Answers from JSON without their last digits, which depend on the processor."""
    return json.loads(text, parse_float=lambda number: round(float(number), 8))


def test_detect_says_what_the_recorded_build_said(tmp_path):
    answers = detect_all(tmp_path)
    assert len(answers) == 4
    assert answers == read_answers(FILE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        FILE.write_text(json.dumps(detect_all(name), indent=1, sort_keys=True) + "\n", encoding="utf-8")
