"""All commands: each is a function whose docstring is its help and defines its options.

A line of the docstring's section ``Args:`` is an option or a positional argument, with its help::

    EVENT: a positional one; ``[EVENT]`` may be left out, of ``EVENTS...`` there can be several
    --seed N: N is a whole number, X or S any number, FILE and DIR are paths, B is a budget
    --world NAME: anything else is text
    --model NAME...: may be given several times; of NAME=VALUE pairs are collected in a dict
    --turning both|ccw|cw: one of these
    --quiet: on or off
    --n N: a number
    | --preset NAME: not together with the one before
    --out DIR: one whose text ends so must be given: required

``$name`` stands for a text of :data:`SHARED`: whole lines, or words within a line. ``--help``
begins with the text before the section, and ends with the text after it.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import inspect
import json
import re
import string
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import phase_ppl
from phase_ppl.world.errors import (
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    QueryError,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder

MODULES: Final = ("infer", "results", "evaluate", "events")
"""Other modules whose public functions are commands."""

APPLICATIONS: Final = "phase_ppl.commands"
"""Group of entry points for commands of applications: a function as here, or a module with one for
each of its parts. They are loaded only for such a command, or for the list of all."""

FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Exit codes that functions can return, beside 0 or None."""

POSTERIOR: Final = "posterior.nc"  # the file in the folder of results that holds the posterior

_DASK_SECONDS: Final = 10  # seconds to wait for a scheduler's answer

SHARED: Final = {
    "FILE": "FILE.py:NAME takes one of your own, and runs that file",
    "WORLDS": f"{', '.join(phase_ppl.worlds.available())} (default PHASE)",
    "BUDGET": "simulations, as in 500, simulated frames, as in 20000f, or seconds, as in 60s",
    "PRESET": "simple, guided, as_printed or as_intended: kernel, proposal, planner, weights, "
    "prior and thresholds in one word; what else is given goes before it",
    "planner": "--planner paper|fast|as_printed|as_printed_fast: of the agents; default fast",
    "seed": "--seed N: default 0",
    "event": """
EVENT: an event file, or a bundled event's name
--video ID: one event of a file with many
--seed N: default 0
--turning both|ccw|cw: which way agents can turn; default: as observed""",
    "workers": """
--workers N: processes; default one per usable core""",
    "cluster": """
--workers N: processes; default one per usable core
--dask ADDRESS: a dask scheduler, as in machine:8786, whose workers do the work; --workers then says
    how much they are given at a time""",
    "progress": """
--quiet: no progress bar
| --progress: a progress bar also where the errors go to a file; default: only in a terminal""",
    "overwrite": "--overwrite: replace the results that are in DIR",
    "versions": "--other-versions: go on although it was begun by other versions; both are "
    "recorded",
    "model": """
--prior NAME: default uniform; $FILE
--simulator FILE.py:NAME: instead of the joint one; runs that file
--likelihood L: radial or closed_loop, with settings as in radial:beta=0.1 and
    closed_loop:weight=1:planner_seeds=8; $FILE""",
    "run": """
--iterations N: default 6, or as before
| --budget B: $BUDGET
$cluster
--keep-checkpoint: keep run.ckpt when the run is complete, to extend it
$progress""",
    "posterior": """
FILE: a posterior's .nc file, or the folder of infer
--weights NAME: count or stratified; default: the file's""",
}
"""Help texts that several commands share."""


class Options(argparse.Namespace):
    """The options of a command: ``--on-failure`` as ``on_failure``, and so on.

    Options that were not given are None, or empty. ``progress`` combines ``--quiet`` and
    ``--progress``, as functions take it; ``executor`` is the one of ``--dask``, if any.
    """

    def given(self, *names: str) -> dict[str, Any]:
        """Return the named options that were given."""
        found = {name: getattr(self, name, None) for name in names}
        return {name: v for name, v in found.items() if not (v is None or v in ([], {}))}

    def of(self, function: Callable[..., Any], /, **more: Any) -> dict[str, Any]:
        """Return a function's arguments: given options of the same names, and ``more``."""
        return {**self.given(*inspect.signature(function).parameters), **more}

    def call(self, function: Callable[..., Any], /, **more: Any) -> Any:
        """Call a function with given options of the names of its arguments, and ``more``."""
        return function(**self.of(function, **more))

    def load(self) -> Event:
        """Return the event of ``$event``."""
        return phase_ppl.load_event(self.event, video=self.video, turning=self.turning)

    def suffix(self, *allowed: str) -> str:
        """Return the ending of ``--out``, and make its folder.

        Raises:
            OutputError: the ending is not allowed, or the folder cannot be made.
        """
        if self.out.suffix.lower() not in allowed:
            raise OutputError(f"--out {self.out}: expected a file ending in {' or '.join(allowed)}")
        writable_folder(self.out.parent)
        return str(self.out.suffix.lower())


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
    options = Options()
    try:
        _add_commands(commands, given[0] if given else "")
        parser.parse_args(given, options)
        with _executor(getattr(options, "dask", None)) as options.executor:
            return options.run(options) or 0
    except PhasePPLError as error:
        # the lines of a question show the place
        text = str(error) if isinstance(error, QueryError) else one_line(error)
        print(f"phase-ppl: error: {text}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt as stopped:
        again = getattr(options, "out", None) is not None and hasattr(options, "resume")
        how = "; go on with the same command and --resume" if again else ""
        print(f"phase-ppl: {one_line(stopped) or 'interrupted'}{how}", file=sys.stderr)
        return INTERRUPTED


def _add_commands(commands: Any, asked: str) -> None:
    """Add our commands; also applications', if one of them, or the list, is asked for."""
    names = set()
    for module in MODULES:
        for name, function in _functions(importlib.import_module(f"phase_ppl.cli.{module}")):
            names.add(name)
            _add(commands, name, function)
    if asked in names:
        return
    offered = importlib.metadata.entry_points(group=APPLICATIONS)
    chosen = offered.select(name=asked)
    for entry in chosen or offered:
        try:
            _add(commands, entry.name, entry.load())
        except Exception as error:  # a broken application must not break other commands
            problem = f"command {entry.name!r} cannot be loaded: {one_line(error)}"
            if chosen:
                raise InvalidSettingError(problem) from error
            print(f"phase-ppl: note: {problem}", file=sys.stderr)


def _functions(module: ModuleType) -> Iterator[tuple[str, Callable[[Options], int | None]]]:
    for name, value in vars(module).items():
        if inspect.isfunction(value) and value.__module__ == module.__name__ and name[0] != "_":
            yield name.replace("_", "-"), value


def _add(commands: Any, name: str, command: Any) -> None:
    """Add a command as its docstring defines it."""
    if not command.__doc__:  # Python may have been told to leave docstrings out
        raise InvalidSettingError(
            f"command {name!r} has no docstring to make its options of (-OO?)"
        )
    says, _, rest = inspect.cleandoc(command.__doc__).partition("\nArgs:\n")
    entries, _, ending = rest.partition("\n\n")
    if not rest and "\n\n" in says:
        says, _, ending = says.rpartition("\n\n")
    found = list(_entries(textwrap.dedent(entries)))
    parser = commands.add_parser(
        name,
        help=says.splitlines()[0].rstrip("."),
        description=says.strip(),
        epilog=ending,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if inspect.ismodule(command):
        parts = parser.add_subparsers(metavar="COMMAND", required=True)
        for part in _functions(command):
            _add(parts, *part)
        return
    parser.set_defaults(run=command)
    for place, (instead, entry, says) in enumerate(found):
        required = says.endswith("required")
        if not instead:
            to: Any = parser
            if found[place + 1 : place + 2] and found[place + 1][0]:
                to = parser.add_mutually_exclusive_group(required=required)
        _add_entry(to, entry, says, required and to is parser)


_ENTRY: Final = re.compile(r"(\| )?([^\s:]+(?: \S+)?):(?:\s+(.*))?", re.DOTALL)


def _entries(text: str) -> Iterator[tuple[str, str, str]]:
    """Yield "| " or "", name and value, and help of a section's lines, with shared texts."""
    for entry in re.split(r"\n(?=\S)", text.strip()):
        if entry.startswith("$"):
            yield from _entries(SHARED[entry[1:]])
        elif (match := _ENTRY.fullmatch(entry)) is not None:
            instead, name, says = match.groups(default="")
            yield instead, name, string.Template(" ".join(says.split())).substitute(SHARED)
        elif entry:
            raise ValueError(f"no option and no argument: {entry!r}")


def _add_entry(to: Any, entry: str, says: str, required: bool) -> None:
    name, _, value = entry.partition(" ")
    option = name.startswith("--")
    shows = (value or name).removesuffix("...").strip("[]")
    several = entry.endswith("...")
    more: dict[str, Any] = {"metavar": shows, "type": _TYPES.get(shows)}
    more |= {"action": _Once} if option else {}
    if name in ("--quiet", "--progress"):
        more = {"dest": "progress", "action": "store_const", "const": name == "--progress"}
    elif option and not value:
        more = {"action": "store_const", "const": True}
    elif "|" in value:
        more = {"action": _Once, "choices": value.split("|")}
    elif option and several and shows.count("=") == 1:
        more |= {"action": _Pairs, "default": {}}
    elif option and several:
        more |= {"action": "append", "default": []}
    elif not option:
        more["nargs"] = "+" if several else "?" if name.startswith("[") else None
        name = shows.lower()
    if required:
        more["required"] = True
    to.add_argument(name, help=says or None, **more)


class Parser(argparse.ArgumentParser):
    """Reports a usage error in one line, with close names; exit code 2."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, str(unknown_name("choice", value, action.choices)))

    def error(self, message: str) -> Any:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


class _Once(argparse.Action):
    """A value; argparse itself would take the last of several."""

    def __call__(self, parser: Any, options: Any, value: Any, option: Any = None) -> None:
        if (given := getattr(options, self.dest)) is not None:
            raise argparse.ArgumentError(self, f"given twice, {given!r} and {value!r}")
        setattr(options, self.dest, value)


class _Pairs(argparse.Action):
    """NAME=VALUE pairs; the option may be given several times."""

    def __call__(self, parser: Any, options: Any, text: Any, option: Any = None) -> None:
        name, equals, value = (part.strip() for part in text.partition("="))
        found = getattr(options, self.dest)
        if not (equals and name):
            raise argparse.ArgumentError(self, f"{text!r} is not of the form {self.metavar}")
        if name in found:
            raise InvalidSettingError(f"{option} {name}: given twice")
        setattr(options, self.dest, {**found, name: option_value(value)})


def option_value(text: str) -> Any:
    """Return numbers, true and false as such, other values as text."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number") from None


def _budget(text: str) -> Any:
    try:
        if text.endswith("f"):
            return phase_ppl.frames(int(text[:-1]))
        if text.endswith("s"):
            return phase_ppl.seconds(float(text[:-1]))
        return phase_ppl.simulations(int(text))
    except ValueError:  # of ours too
        expected = SHARED["BUDGET"]
        raise argparse.ArgumentTypeError(
            f"{shown(text)} is no budget; expected {expected}"
        ) from None


_TYPES: Final = {
    **{"N": _whole, "X": float, "S": float, "B": _budget},
    **{"FILE": Path, "DIR": Path, "FOLDER": Path},
}


@contextlib.contextmanager
def _executor(address: str | None) -> Iterator[Executor | None]:
    """Yield the executor of a dask cluster; None: no cluster."""
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


def one_line(error: BaseException) -> str:
    """Return an error's message in one line."""
    return " ".join(str(error).split())
