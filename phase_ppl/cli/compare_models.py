"""The command ``compare-models``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import writable_folder

if TYPE_CHECKING:
    from phase_ppl.evaluation.comparison import ModelComparison

PAGES: Final = "pages"
"""The folder of the pages, one per event, in that of a comparison."""

_PAGE: Final = "[0-9][0-9][0-9][0-9]-*.html"
"""What pages are called (``entry_name``)."""


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "compare-models",
        _compare_models,
        "phase-ppl compare-models out/simple out/last_frame --out compared",
        "Compare evaluations of several models, and people, on the same events: "
        "accuracy, agreement with people, paired differences with Holm's correction, equivalence "
        "with people, cost.",
    )
    cli.add(
        parser,
        "folders DIR",
        "written by evaluate --out, of one model or of several; NAME=DIR gives it a name",
        nargs="+",
    )
    add_references(parser)
    cli.add(parser, "--against NAME", "differences from this model only; default: every pair")
    cli.add(parser, "--common", "compare on the events that all folders share")
    cli.add(
        parser,
        "--margin M",
        "difference of shares up to which a model and people are equivalent; default 0.1",
        float,
    )
    cli.add(parser, "--seed N", "of the resamples; default 0", cli.whole(0))
    cli.add(parser, "--resamples N", "of the events, default 10000", cli.whole(1))
    cli.add(parser, "--out DIR", "for tables, figures and pages", Path)
    cli.add(parser, "--no-figures", "draw no figures and pages")
    cli.add_progress(parser)


def add_references(parser: argparse.ArgumentParser) -> None:
    """Add the option that names reference models."""
    cli.add(
        parser,
        "--stored NAME",
        "a reference model, whose answers the events carry, to be compared too, or all; may "
        "be given several times",
        action="append",
        default=[],
    )


def _compare_models(options: argparse.Namespace) -> int:
    from phase_ppl.evaluation.folder import SETTINGS

    if options.out is not None:
        if (options.out / SETTINGS).is_file():
            raise InvalidSettingError(f"--out {options.out} holds an evaluation: name another")
        writable_folder(options.out)
    found = phase_ppl.compare_models(
        _sources(options.folders),
        stored=named_references(options.stored),
        against=options.against,
        common=options.common,
        **cli.given(options, "margin", "seed", "resamples"),
    )
    print(found)
    if options.out is None:
        print("\nNothing was saved; --out DIR keeps tables and figures.")
        return 0
    return keep(found, options.out, options)


def named_references(given: Sequence[str]) -> str | list[str]:
    """Return what ``compare_models`` takes for the reference models named by ``--stored``."""
    from phase_ppl.evaluation.entries import ALL

    return ALL if ALL in given else list(given)


def _sources(given: Sequence[str]) -> dict[str, Any] | list[str]:
    """Return the folders, with names where there are some."""
    pairs = [(text, "") if Path(text).exists() else text.partition("=")[::2] for text in given]
    named = {name: folder for name, folder in pairs if folder}
    if not named:
        return list(given)
    if len(named) < len(given) or "" in named:
        raise InvalidSettingError(
            f"{' '.join(given)}: expected a different name for each, as in one=DIR other=DIR"
        )
    return named


def keep(found: ModelComparison, out: Path, options: argparse.Namespace) -> int:
    """Write a comparison with its figures and pages; return the exit code."""
    from phase_ppl.evaluation.folder import entry_name
    from phase_ppl.evaluation.report import contents, write_page

    found.save(out)
    problems = []
    if not options.no_figures:
        pages = writable_folder(out / PAGES)
        for old in pages.glob(_PAGE):  # of an earlier comparison, perhaps of other events
            old.unlink(missing_ok=True)
        events = {event.id: (place, event) for place, event in enumerate(found.events)}

        def draw_page(event_id: str) -> None:
            place, event = events[event_id]
            page = contents.event_page(event, found.answers)
            write_page(page, pages / f"{entry_name(place, event_id)}.html")

        problems = drawn(found, out, list(events), draw_page, options)
    for problem in problems:
        print(f"phase-ppl: error: {problem}", file=sys.stderr)
    print(f"\nKept in {out}\n{cli.report_hint(out)}")
    return cli.FAILED if problems else 0


def drawn(
    source: Any,
    out: Path,
    events: Sequence[str],
    draw_page: Callable[[str], None],
    options: argparse.Namespace,
) -> list[str]:
    """Draw the figures of an evaluation or a comparison into ``out``, and the events' pages.

    The results are there, whatever becomes of their pictures: what could not be drawn is
    returned in words.
    """
    from phase_ppl.evaluation.figures import draw_figures
    from phase_ppl.inference.progress import counted

    problems = []
    try:
        draw_figures(source, out, progress=not options.quiet)
    except Exception as error:
        problems.append(f"the figures cannot be drawn: {cli.one_line(error)}")
    for event_id in counted(events, cli.shows_progress(options), "page", "drawing"):
        try:
            draw_page(event_id)
        except Exception as error:
            problems.append(f"the page of {event_id} cannot be drawn: {cli.one_line(error)}")
    return problems
