"""Print the size of the project: ``python tests/packaging/count.py``, or ``make count``."""

import ast
import re
import subprocess
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
PARTS = ("usnet_env", "detectors", "benchmarks", "examples", "tests")
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
LONGEST_FILE = 400  # lines


def code_lines(path: Path) -> int:
    """Number of lines with a token that is neither a comment nor of a docstring."""
    with tokenize.open(path) as file:
        tokens = [token for token in tokenize.generate_tokens(file.readline) if token.type not in NO_CODE]
    lines = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            lines -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def main() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for path in (ROOT / name for name in listed.splitlines()) if path.is_file()]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.suffix in (".py", ".md")}
    sources = {
        part: [path for path in texts if path.is_relative_to(ROOT / part) and path.suffix == ".py"] for part in PARTS
    }
    print(f"{'':12}{'lines':>8}{'code':>8}")
    for part, paths in sources.items():
        lines = sum(texts[path].count("\n") for path in paths)
        print(f"{part:12}{lines:8}{sum(map(code_lines, paths)):8}")
    pages = [path for path in texts if path.suffix == ".md" and path.is_relative_to(ROOT / "docs")]
    words, shown = (
        sum(len(re.findall(r"\S*\w\S*", re.sub(hidden, "", texts[path]))) for path in pages)  # no bars of tables
        for hidden in (r"(?!)", r"(?s)<details>.*?</details>")
    )
    packages = [texts[path] for part in PARTS[:2] for path in sources[part]]
    print(f"words of pages: {shown}, and {words - shown} that a click opens")
    print(f"raise ArgumentError: {sum(text.count('raise ArgumentError') for text in packages)}")
    print(f"checkout: {sum(path.stat().st_size for path in files) / 1e6:.1f} MB")
    long = [path for path, text in texts.items() if path.suffix == ".py" and text.count("\n") > LONGEST_FILE]
    print(f"files over {LONGEST_FILE} lines: {', '.join(str(path.relative_to(ROOT)) for path in long) or 0}")


if __name__ == "__main__":
    main()
