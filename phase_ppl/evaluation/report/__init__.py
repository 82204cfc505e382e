"""Pages that hold everything about a run, an evaluation, a comparison of models or an event."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from phase_ppl.evaluation.folder import COMPARISON, POSTERIOR, SETTINGS
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.files import as_path, check_output, write_bytes

NAME: Final = "report.html"


def report(
    folder: str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    videos: bool = False,
    progress: bool | None = None,
) -> Path:
    """Write one self-contained HTML page about what a folder holds; return its path.

    The page holds its pictures, films, style and script, and fetches nothing.

    Args:
        folder: of a run, with posterior.nc, of an evaluation, or of a comparison of models.
        path: of the page, ending in .html; default ``report.html`` in the folder.
        videos: film every event of an evaluation as well, some seconds and 0.1 MB each. A film
            that a run has is always there.
        progress: whether to show a bar over the events on stderr; by default where that is a
            terminal.

    Raises:
        InvalidEventError: the folder is none of these, or a file in it is damaged.
        OutputError: the page cannot be written there, or its name does not end in .html.
    """
    source = as_path(folder)
    target = source / NAME if path is None else as_path(path)
    if not source.is_dir():
        raise InvalidEventError(f"{source}: no such folder")
    of_evaluation = (source / SETTINGS).is_file()
    of_comparison = (source / COMPARISON).is_file()
    if not (of_evaluation or of_comparison or (source / POSTERIOR).is_file()):
        raise InvalidEventError(
            f"{source} holds neither a run (it has no {POSTERIOR}) nor an evaluation (it has no "
            f"{SETTINGS}) nor a comparison (it has no {COMPARISON})"
        )
    check_output(target, (".html",))
    from phase_ppl.evaluation.evaluation import Evaluation
    from phase_ppl.evaluation.report import contents

    if of_evaluation:
        text = contents.evaluation_page(Evaluation.load(source), videos, progress)
    elif of_comparison:
        from phase_ppl.evaluation.comparison import ModelComparison

        text = contents.comparison_page(ModelComparison.load(source), progress=progress)
    else:
        text = contents.run_page(source)
    return write_page(text, target)


def write_page(text: str, path: str | os.PathLike[str]) -> Path:
    """Write a page, whole or not at all; return its path."""
    write_bytes(path, (".html",), text.encode())
    return Path(path)
