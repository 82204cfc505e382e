"""How large is the package, folder by folder? Files, lines, lines of code, and `raise`.

A line of code is one on which a statement's tokens stand: no comment, docstring or empty line.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
COLUMNS = ("files", "lines", "code", "raise")
_EMPTY = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
)


def count(path: Path) -> Counter[str]:
    """Return the figures of a file of Python."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    with path.open("rb") as file:
        tokens = [each for each in tokenize.tokenize(file.readline) if each.type not in _EMPTY]
    code = {line for each in tokens for line in range(each.start[0], each.end[0] + 1)}
    for node in ast.walk(tree):  # texts that stand alone: docstrings, and those of constants
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            code -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    raises = sum(isinstance(node, ast.Raise) for node in ast.walk(tree))
    return Counter({"files": 1, "lines": text.count("\n"), "code": len(code), "raise": raises})


def by_folder(root: Path, depth: int) -> dict[str, Counter[str]]:
    """Return the figures of each folder, down to ``depth`` folders below ``root``."""
    found: dict[str, Counter[str]] = {}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).parent.parts[: depth + 1]
        found.setdefault("/".join(parts), Counter()).update(count(path))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, default=[ROOT / "phase_ppl"])
    parser.add_argument("--depth", type=int, default=1, help="folders below that are told apart")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
    options = parser.parse_args()
    found: dict[str, Counter[str]] = {}
    for folder in options.folders:
        if not folder.is_dir():
            sys.exit(f"{folder} is no folder")
        parts = by_folder(folder.resolve(), options.depth)
        found |= parts
        found[f"{folder.name}, all"] = sum(parts.values(), Counter())
    width = max(map(len, found))
    print(f"{'':{width}}", *(f"{name:>7}" for name in (*COLUMNS, "mean")))
    for name, figures in found.items():
        mean = round(figures["lines"] / figures["files"])
        print(f"{name:{width}}", *(f"{figures[column]:7}" for column in COLUMNS), f"{mean:7}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
