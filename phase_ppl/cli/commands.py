"""The way to all commands, and what they share: options, folders, one-line errors."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import inspect
import json
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.agents.config import PLANNERS
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    shown,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, locked, writable_folder
from phase_ppl.world.scene import TURNINGS

if TYPE_CHECKING:
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

COMMANDS: Final = {
    "infer": ("infer", "print, draw and save the posterior over goals, relation and strengths of "
              "an event"),
    "resume": ("infer", "go on with an interrupted run, or extend one"),
    "goals": ("events", "list the goals that an agent can have, 36 in PHASE"),
    "simulate": ("events", "run the joint simulator from an event's start under a hypothesis"),
    "render": ("events", "film an event, or draw a frame or a film strip of it"),
    "compare": ("infer", "compare kernels on an event: same budget, several seeds, against a "
                "reference"),
    "query": ("results", "ask a saved posterior, as in 'P(relation=friendly | goal_red=get to "
              "green agent)'"),
    "evaluate": ("evaluate", "ask a model about many events, and score what it answers"),
    "compare-models": ("evaluate", "compare evaluations of several models, and people, on the same "
                       "events"),
    "reproduce": ("evaluate", "the paper's tables and figures, cell by cell"),
    "report": ("results", "make one self-contained HTML page of a run, an evaluation or a "
               "comparison"),
    "diagnose": ("results", "say whether the chains of a posterior can be trusted"),
    "generate": ("generate", "make a data set of simulated social events"),
    "verify": ("generate", "compare a generated data set with its checksums"),
    "describe": ("events", "print and draw the statistics of a set of events beside those of "
                 "PHASE"),
    "train": ("generate", "train a model of social perception on a generated data set"),
    "export": ("events", "write events in another format"),
}  # fmt: skip
"""Command -> the module that adds it, which is imported where it is asked for; what it does."""

APPLICATIONS: Final = "phase_ppl.commands"
"""Group of entry points with the commands of applications, which are loaded where one of them, or
the list of all, is asked for. Each is a function ``add_to(commands, cli)`` that adds the command of
its name to argparse's ``commands``, with the help of ``cli``, this module."""

FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Exit codes."""

_DASK_SECONDS: Final = 10  # that a scheduler may take to answer

POSTERIOR: Final = "posterior.nc"  # the file in the folder of results that holds the posterior


def run(arguments: Sequence[str] | None) -> int:
    """Run a command; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = Parser(
        prog="phase-ppl",
        description="Who wants what? Social perception grounded in intuitive physics.",
        epilog="example: phase-ppl infer collaborate --out out",
    )
    parser.add_argument("--version", action="version", version=phase_ppl.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    try:
        _add_commands(commands, given[0] if given else "")
        options: argparse.Namespace = parser.parse_args(given)
        with _executor(getattr(options, "dask", None)) as options.executor:
            code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT


def _add_commands(commands: Any, name: str) -> None:
    """Add the command of that name; all, as far as their list says of them, where there is none."""
    if name in COMMANDS:
        importlib.import_module(f"phase_ppl.cli.{COMMANDS[name][0]}").add_to(commands)
        return
    offered = importlib.metadata.entry_points(group=APPLICATIONS)
    asked = offered.select(name=name)
    if not asked:
        for ours, (_, does) in COMMANDS.items():
            commands.add_parser(ours, help=does)
    for entry in asked or offered:
        try:
            entry.load()(commands, sys.modules[__name__])
        except Exception as error:  # it must not break the others
            problem = f"command {entry.name!r} cannot be loaded: {one_line(error)}"
            if asked:
                raise InvalidSettingError(problem) from error
            print(f"phase-ppl: note: {problem}", file=sys.stderr)


def one_line(error: BaseException) -> str:
    """Return what an error says, in one line."""
    return " ".join(str(error).split())


def load(options: argparse.Namespace) -> Event:
    """Return the event that the options name."""
    return phase_ppl.load_event(options.event, video=options.video, turning=options.turning)


def posterior(path: Path, weights: str | None = None) -> Posterior | StepwisePosterior:
    """Return the posterior of a file, or of the folder of results that holds posterior.nc."""
    if not as_path(path).is_dir():
        return phase_ppl.load_posterior(path, weights)
    if not (path / POSTERIOR).is_file():
        kept = min(path.glob(f"events/*/{POSTERIOR}"), default=None)
        hint = ""
        if kept is not None:
            hint = f"; it holds an evaluation, with one such as {shlex.quote(str(kept))}"
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
    commands: Any, name: str, run: Any, example: str, says: str = ""
) -> argparse.ArgumentParser:
    """Add a command; what it says of itself is what :data:`COMMANDS` says, or ``says``."""
    says = says or COMMANDS[name][1]
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=says, description=says, epilog=f"example: {example}"
    )
    parser.set_defaults(run=run)
    return parser


def event_command(commands: Any, name: str, run: Any, example: str) -> argparse.ArgumentParser:
    """Add a command on an event, with the options that all of them have."""
    parser = command(commands, name, run, example)
    add(parser, "event EVENT", "an event file, or a bundled event's name")
    add(parser, "--video ID", "one event of a file with many")
    share(parser, "seed")
    add(parser, "--turning", "which way agents can turn; default: as observed", choices=TURNINGS)
    return parser


def add(
    to: argparse._ActionsContainer,
    name: str,
    says: str | None = None,
    type: Any = None,
    default: Any = None,
    **more: Any,
) -> None:
    """Add an argument or option, such as ``--seed N``; one without a value is on or off."""
    name, _, metavar = name.partition(" ")
    if metavar:
        more["metavar"] = metavar
    elif name.startswith("--") and not more and type is default is None:
        more["action"] = "store_true"
    if type is not None:
        more["type"] = type
    if default is not None:
        more["default"] = default
    to.add_argument(name, help=says, **more)


SHARED: Final[Mapping[str, Mapping[str, Any]]] = {
    "seed": {"name": "--seed N", "says": "default 0", "type": whole(0), "default": 0},
    "planner": {"name": "--planner", "default": "fast", "choices": PLANNERS},
    "workers": {"name": "--workers N", "says": "processes; default one per usable core",
                "type": whole(1)},
    "dask": {"name": "--dask ADDRESS", "says": "a dask scheduler, as in machine:8786, whose "
             "workers do the work; --workers then says how much they are given at a time"},
    "other_versions": {"name": "--other-versions", "says": "go on although it was begun by other "
                       "versions; both are recorded"},
    "overwrite": {"name": "--overwrite", "says": "replace the results that are in DIR"},
}  # fmt: skip
"""Options that several commands have."""


def share(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add some of :data:`SHARED`, and with "progress" the two that :func:`shows_progress` reads.

    With "dask", ``options.executor`` is the executor to work in, or None.
    """
    for name in names:
        if name != "progress":
            add(parser, **SHARED[name])
            continue
        either = parser.add_mutually_exclusive_group()
        add(either, "--quiet", "no progress bar")
        says = "a progress bar also where the errors go to a file; default: only in a terminal"
        add(either, "--progress", says)


@contextlib.contextmanager
def _executor(address: str | None) -> Iterator[Executor | None]:
    """Yield the executor of a dask cluster; None where there is none."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InvalidSettingError("--dask needs pip install 'phase_ppl[cluster]'") from None
    try:
        client = Client(address, timeout=_DASK_SECONDS)
    except (OSError, ValueError) as error:
        raise InvalidSettingError(
            f"--dask {address}: no scheduler answers ({one_line(error)})"
        ) from None
    with client:
        yield client.get_executor()


def add_options(parser: argparse._ActionsContainer, says: str, type: Any = None) -> None:
    """Add the option that takes options of something else, several times."""
    pairs = type or named_value
    add(parser, "--option NAME=VALUE", says, pairs, [], action="append")


def once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return name -> value of ``--option`` (InvalidSettingError: a name is given twice)."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InvalidSettingError(f"--option {name}: given twice")
        found[name] = value
    return found


def given(options: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Return those of the options that were given, by name."""
    found = {name: getattr(options, name) for name in names}
    return {name: value for name, value in found.items() if value is not None}


def arguments(
    function: Callable[..., Any], options: argparse.Namespace, /, **own: Any
) -> dict[str, Any]:
    """Return arguments of a function: what the options of the same names give, and ``own`` ones."""
    names = [name for name in inspect.signature(function).parameters if name in options]
    found = given(options, *names)
    if "progress" in names:
        found["progress"] = shows_progress(options)
    return {**found, **own}


PRESET: Final = (
    "simple, guided, as_printed or as_intended: kernel, proposal, planner, weights, prior "
    "and thresholds in one word; what else is given goes before it"
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


@contextlib.contextmanager
def results_folder(
    out: Path | None, names: Sequence[str], overwrite: bool
) -> Iterator[Path | None]:
    """Keep the folder of results to this process, from before any work is done."""
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
