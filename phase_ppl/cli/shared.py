"""What the commands have in common: options, folders, one-line errors."""

from __future__ import annotations

import argparse
import contextlib
import inspect
import json
import runpy
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, existing_file, locked, writable_folder
from phase_ppl.world.scene import TURNINGS

if TYPE_CHECKING:
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Exit codes."""

POSTERIOR: Final = "posterior.nc"
"""The file in the folder of results that holds the posterior."""


def one_line(error: BaseException) -> str:
    """Return what an error says, in one line."""
    return " ".join(str(error).split())


def load(options: argparse.Namespace) -> Event:
    """Return the event that the options name."""
    return phase_ppl.load_event(options.event, video=options.video, turning=options.turning)


def prior_named(text: str) -> Any:
    """Return the name of a ready-made prior, or of ``FILE.py:NAME`` what that file calls so.

    The file is run, which is said on stderr.

    Raises:
        InvalidEventError: there is no such file.
        InvalidSettingError: it cannot be run.
        UnknownNameError: nothing in it is called so.
    """
    file, _, name = text.rpartition(":")
    if not file.endswith(".py"):
        return text
    path = existing_file(file)
    print(f"phase-ppl: running {path} for its prior {name}", file=sys.stderr)
    try:
        found = runpy.run_path(str(path))
    except Exception as error:  # whatever a user's file does
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise InvalidSettingError(f"{path} cannot be run: {reason}") from error
    if name not in found:
        known = [key for key, value in found.items() if inspect.isfunction(value)]
        raise unknown_name(f"prior in {path}", name, known)
    return found[name]


def posterior(path: Path, weights: str | None = None) -> Posterior | StepwisePosterior:
    """Return the posterior of a file, or of the folder of results that holds posterior.nc.

    Raises:
        InvalidEventError: there is no such file, or none in the folder.
    """
    if not as_path(path).is_dir():
        return phase_ppl.load_posterior(path, weights)
    if not (path / POSTERIOR).is_file():
        kept = min(path.glob(f"events/*/{POSTERIOR}"), default=None)
        hint = f"; it holds an evaluation, with one such as {kept}" if kept else ""
        raise InvalidEventError(f"{path} holds no {POSTERIOR}{hint}")
    return phase_ppl.load_posterior(path / POSTERIOR, weights)


def report_hint(out: Path) -> str:
    """Return how to make a page of what is in the folder ``out``."""
    return f"For one page of it all: phase-ppl report {shlex.quote(str(out))}"


def check_suffix(out: Path, suffixes: Sequence[str]) -> str:
    """Return the ending of ``out``, in lower case (OutputError: it is none of ``suffixes``)."""
    suffix = out.suffix.lower()
    if suffix not in suffixes:
        raise OutputError(f"--out {out}: expected a file ending in {' or '.join(suffixes)}")
    return suffix


class Parser(argparse.ArgumentParser):
    """Reports a usage error in one line, exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def whole(minimum: int) -> Any:
    """Return a parser of whole numbers that are at least ``minimum``."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number") from None
        if value < minimum:
            raise argparse.ArgumentTypeError(f"{text} is too small, expected at least {minimum}")
        return value

    return parse


def command(
    commands: Any, name: str, run: Any, description: str, example: str
) -> argparse.ArgumentParser:
    """Add a command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=description, description=description, epilog=f"example: {example}"
    )
    parser.set_defaults(run=run)
    return parser


def event_command(
    commands: Any, name: str, run: Any, description: str, example: str
) -> argparse.ArgumentParser:
    """Add a command on an event, with the options that all of them have."""
    parser = command(commands, name, run, description, example)
    parser.add_argument("event", metavar="EVENT", help="an event file, or a bundled event's name")
    parser.add_argument("--video", metavar="ID", help="one event of a file with many")
    parser.add_argument("--seed", metavar="N", type=whole(0), default=0, help="default 0")
    parser.add_argument(
        "--turning", choices=TURNINGS, help="which way agents can turn; default: as observed"
    )
    return parser


def add_planner(parser: argparse.ArgumentParser) -> None:
    """Add the option of whoever plans the agents' actions."""
    parser.add_argument("--planner", choices=("fast", "paper"), default="fast")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the option of the number of processes."""
    parser.add_argument(
        "--workers", metavar="N", type=whole(1), help="processes; default one per usable core"
    )


PRESET: Final = (
    "as_printed, as_intended or default: kernel, proposal, planner, weights, prior and thresholds "
    "in one word; what else is given goes before it"
)
"""What ``--preset`` does."""

BUDGET: Final = "simulations, as in 500, simulated frames, as in 20000f, or seconds, as in 60s"
"""What a budget is given in."""


def budget(text: str) -> Any:
    """Return the budget that an option gives; :data:`BUDGET` says in what."""
    try:
        if text.endswith("f"):
            return phase_ppl.frames(int(text[:-1]))
        if text.endswith("s"):
            return phase_ppl.seconds(float(text[:-1]))
        return phase_ppl.simulations(int(text))
    except ValueError:  # of ours too
        raise argparse.ArgumentTypeError(f"{shown(text)} is no budget; expected {BUDGET}") from None


def add_progress(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`shows_progress` reads."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--quiet", action="store_true", help="no progress bar")
    either.add_argument(
        "--progress",
        action="store_true",
        help="a progress bar also where the errors go to a file; default: only in a terminal",
    )


def add_other_versions(parser: argparse.ArgumentParser) -> None:
    """Add the option of commands that go on with what was begun."""
    parser.add_argument(
        "--other-versions",
        action="store_true",
        help="go on although it was begun by other versions; both are recorded",
    )


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add the option that :func:`results_folder` reads."""
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the results that are in DIR"
    )


@contextlib.contextmanager
def results_folder(
    out: Path | None, names: Sequence[str], overwrite: bool
) -> Iterator[Path | None]:
    """Keep the folder of results to this process, from before any work is done.

    Args:
        out: the folder; None: nothing is kept.
        names: of files that are results.
        overwrite: whether it may hold some, which are then deleted.

    Raises:
        OutputError: it cannot be written, another process is at work in it, or it holds results.
    """
    if out is None:
        yield None
        return
    with locked(writable_folder(out)):
        there = [name for name in names if (out / name).exists()]
        if there and not overwrite:
            raise OutputError(
                f"{out} holds results already ({', '.join(there)}): name another folder, or "
                "--overwrite"
            )
        yield out


def shows_progress(options: argparse.Namespace) -> bool | None:
    """Return whether to show a bar; None: where stderr is a terminal."""
    return True if options.progress else False if options.quiet else None


def option_value(text: str) -> Any:
    """Return numbers, true and false as such, anything else as text."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def named_value(text: str) -> tuple[str, Any]:
    """Return name and value of NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    return name, option_value(value)
