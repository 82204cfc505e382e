"""How large is the package, folder by folder? Files, lines, code and docstrings."""

from __future__ import annotations

import argparse
import ast
import json
from collections import Counter
from pathlib import Path


def count(path: Path) -> Counter[str]:
    """Return the figures of a file; lines of code are neither empty, comments nor docstrings."""
    text = path.read_text("utf-8")
    nodes = (n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Expr))
    texts = [n for n in nodes if isinstance(n.value, ast.Constant)]
    docs = {i for n in texts for i in range(n.lineno, (n.end_lineno or n.lineno) + 1)}
    lines = [line.strip() for line in text.splitlines()]
    code = sum(line[:1] not in ("", "#") and i not in docs for i, line in enumerate(lines, 1))
    return Counter({"files": 1, "lines": len(lines), "code": code, "docs": len(docs)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    package = Path(__file__).parents[1] / "phase_ppl"
    parser.add_argument("folder", nargs="?", type=Path, default=package)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")
    options = parser.parse_args()
    found: dict[str, Counter[str]] = {}
    for path in sorted(options.folder.rglob("*.py")):
        found.setdefault(path.relative_to(options.folder).parts[0], Counter()).update(count(path))
    found["all"] = sum(found.values(), Counter())
    for name, figures in found.items():
        print(f"{name:12}", *(f"{n:7} {what}" for what, n in figures.items()))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
