"""Which sentences are hard to read? `python benchmarks/words.py [FOLDER OR FILE ...] [--worst N]`.

A sentence scores a point for every five words beyond twenty, for every relative clause beyond one,
and for every phrase that hides its point (``HIDING``). Two points or more are hard. Read are
Markdown, docstrings, comments and texts of errors, not code.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parent.parent
FOLDERS: Final = (
    *("README.md", "CONTRIBUTING.md", "docs", "examples", "benchmarks"),
    *("phase_ppl", "phase_study", "phase_people", "phase_films"),
)
HARD: Final = 2

HIDING: Final = re.compile(
    r"\bof which\b|\bbut for\b|\bthere (?:is|are|was|were) to\b|\bthat of\b|\bthose of\b"
    r"|\bso many\b"
    r"|\bwhat is [^.,;]{3,40} is\b|\bbe it\b|\bwhatever\b|\bas (?:it|they) (?:is|are) not\b"
    r"|\bfor want of\b|\bgone on with\b|\bcome to the same\b|\bin one word\b|\bof one's own\b",
    re.IGNORECASE,
)
_CLAUSE: Final = re.compile(
    r"\b(?:which|that|whose|whom|who|where|what|whether|while|because|although|unless)\b", re.I
)
_ERRORS: Final = re.compile(r"(?:Error|Interrupted|Cancelled)$")


class Sentence(NamedTuple):
    """A sentence, where it stands, and how hard it is."""

    place: str
    text: str

    @property
    def score(self) -> int:
        """Points: long, nested, or the point hidden."""
        n_words = len(re.findall(r"[A-Za-z][\w'-]*", self.text))
        nested = max(0, len(_CLAUSE.findall(self.text)) - 1)
        return max(0, (n_words - 20) // 5) + nested + len(HIDING.findall(self.text))


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text in Markdown or of a docstring; no code, tables, headings."""
    text = re.sub(r"```.*?```|^---\n.*?^---\n", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"`+[^`]*`+", "code", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    for block in re.split(r"\n\s*\n|\n\s*(?=[-*|#\d] )|\n(?=\s*\w[\w, ]*: )", text):
        if block.lstrip().startswith(("|", "#", ">", "!")):
            continue
        for one in re.split(r"(?<=[.!?:;])\s+(?=[A-Z\"'(`])", " ".join(block.split())):
            if len(one.split()) > 3:
                yield one


def of_code(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of what a file of code says: docstrings, comments, errors."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for part in body if isinstance(body, list) else ():
            value = part.value if isinstance(part, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield part.lineno, value.value
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for text in node.exc.args:
                yield node.lineno, "".join(_said(text))
    comment: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment.append(token.string.lstrip("# "))
        elif comment and token.type not in (tokenize.NL, tokenize.NEWLINE):
            yield token.start[0], " ".join(comment)
            comment = []


def _said(node: ast.AST) -> Iterator[str]:
    """Yield the parts of a text that is put together."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        for part in node.values:
            yield from _said(part) if isinstance(part, ast.Constant) else ("it",)
    elif isinstance(node, ast.BinOp):
        yield from (*_said(node.left), *_said(node.right))


def read(path: Path) -> Iterator[Sentence]:
    """Yield the sentences of a file."""
    name = path.relative_to(ROOT)
    if path.suffix == ".md":
        yield from (Sentence(str(name), one) for one in sentences(path.read_text("utf-8")))
        return
    for line, text in of_code(path):
        yield from (Sentence(f"{name}:{line}", one) for one in sentences(text))


def main() -> None:
    """Print how many sentences of each folder are hard, and the hardest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("places", nargs="*", default=FOLDERS)
    parser.add_argument("--worst", type=int, default=0, help="print the N hardest sentences")
    options = parser.parse_args()
    everything: list[Sentence] = []
    print(f"{'':<28}{'sentences':>10}{'hard':>8}{'share':>8}{'words':>8}")
    for place in options.places:
        path = (ROOT / place).resolve()
        files = [path] if path.is_file() else sorted((*path.rglob("*.md"), *path.rglob("*.py")))
        found = [one for file in files for one in read(file)]
        hard = [one for one in found if one.score >= HARD]
        n_words = sum(len(one.text.split()) for one in found)
        mean = n_words / max(1, len(found))
        share = len(hard) / max(1, len(found))
        print(f"{place:<28}{len(found):>10}{len(hard):>8}{share:>8.0%}{mean:>8.1f}")
        everything += hard
    for one in sorted(everything, key=lambda one: -one.score)[: options.worst]:
        print(f"\n{one.score:>3}  {one.place}\n     {one.text}")


if __name__ == "__main__":
    main()
