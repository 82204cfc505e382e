"""Parts of a model by options: ready-made ones by name, a user's own out of a file of theirs."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import inspect
import runpy
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.world.errors import InvalidSettingError, check_name, unknown_name
from phase_ppl.world.files import existing_file

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig

FILE: Final = "FILE.py:NAME takes one of your own, and runs that file"
"""What options say that :func:`taken` reads."""

LIKELIHOODS: Final = ("radial", "stepwise")
PARTS: Final = ("prior", "simulator", "likelihood", "noise")  # options of :func:`add_model`
_SUFFIX: Final = ".py"


def add_model(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`model` reads."""
    cli.add(parser, "--prior NAME", f"default uniform; {FILE}")
    cli.add(parser, "--simulator FILE.py:NAME", "instead of the joint one; runs that file")
    says = (
        "radial or stepwise, with settings as in radial:beta=0.1 and "
        f"stepwise:weight=1:planner_seeds=8; {FILE}"
    )
    cli.add(parser, "--likelihood L", says)
    says = "of simulations: fresh for every proposal (the default), or fixed by hypothesis"
    cli.add(parser, "--noise", says, choices=("fresh", "fixed"))


def model(
    options: argparse.Namespace,
    planner: str | PlannerConfig | None = None,
    **settings: Any,
) -> phase_ppl.Model:
    """Return the model of the options.

    Args:
        options: those of :func:`add_model`.
        planner: of the joint simulator.
        **settings: of the likelihood, beside those that ``--likelihood`` has.
    """
    given: dict[str, Any] = cli.given(options, "noise")
    if options.likelihood is not None or settings:
        given["likelihood"] = likelihood(options.likelihood or "radial", settings)
    if options.prior is not None:
        given["prior"] = taken(options.prior, "prior")
    if options.simulator is not None:
        given["simulator"] = taken(options.simulator, "simulator", named=False)
    return phase_ppl.Model(planner=planner, **given)


def given_again(options: argparse.Namespace) -> str:
    """Return the options that ``resume`` needs again, where a file cannot hold all of a run."""
    found = cli.given(options, *PARTS, "kernel")
    if not any(".py:" in text or "stepwise" in text for text in found.values()):
        return ""
    return "".join(f" --{name} {shlex.quote(text)}" for name, text in found.items())


def taken(text: str, what: str, named: bool = True) -> Any:
    """Return of ``FILE.py:NAME`` what that file calls so; of another text the text.

    The file is run, which is said on stderr.

    Args:
        text: of the option.
        what: "prior", "simulator" and so on, for messages.
        named: whether there are such by name as well.
    """
    file, _, name = text.rpartition(":")
    if not file.endswith(_SUFFIX):
        if text.endswith(_SUFFIX) or not named:
            example = f"{text if text.endswith(_SUFFIX) else 'FILE.py'}:NAME"
            raise InvalidSettingError(f"--{what} {text}: expected {example}")
        return text
    path = existing_file(file)
    print(f"phase-ppl: running {path} for its {what} {name}", file=sys.stderr)
    state = path.stat()
    found = _run(path, state.st_mtime_ns, state.st_size)
    if name not in found:
        known = [key for key, value in found.items() if callable(value) and key[0] != "_"]
        raise unknown_name(f"{what} in {path}", name, known)
    return found[name]


@functools.cache
def _run(path: Path, *_: int) -> dict[str, Any]:
    """Return what a file defines; as long as it stays the same it is run once."""
    try:
        return runpy.run_path(str(path), run_name=path.stem)
    except Exception as error:  # whatever a user's file does
        reason = f"{type(error).__name__}: {cli.one_line(error)}"
        raise InvalidSettingError(f"{path} cannot be run: {reason}") from error


def with_settings(text: str, where: str) -> tuple[str, dict[str, Any]]:
    """Return name and settings of ``name:setting=value:setting=value``.

    The name may be ``FILE.py:NAME``.
    """
    name, *given = text.split(":")
    if name.endswith(_SUFFIX) and given:
        name = f"{name}:{given.pop(0)}"
    settings: dict[str, Any] = {}
    for one in given:
        key, equals, value = one.partition("=")
        if not (key and equals and value):
            raise InvalidSettingError(f"{where}: {one!r} in {text!r} is no OPTION=VALUE")
        settings[key] = cli.option_value(value)
    return name, settings


def likelihood(text: str, more: Mapping[str, Any]) -> Any:
    """Return the likelihood of an option such as ``radial:beta=0.1``, with more settings."""
    name, settings = with_settings(text, "--likelihood")
    for setting, value in more.items():
        if setting in settings:
            raise InvalidSettingError(f"--option {setting}: --likelihood {text} has it too")
        settings[setting] = value
    if ":" in name:
        found = taken(name, "likelihood")
        if isinstance(found, type) or settings:
            return _made(name, found, settings)
        return found
    check_name("likelihood", name, [*LIKELIHOODS, "FILE.py:NAME"])
    if name == "radial":
        return _made(name, phase_ppl.RadialLikelihood, settings)
    tracking = {key: settings.pop(key) for key in _fields(phase_ppl.Tracking) if key in settings}
    if tracking:
        settings["tracking"] = phase_ppl.Tracking(**tracking)
    return _made(name, phase_ppl.StepwiseLikelihood, settings)


def _made(name: str, kind: Any, settings: Mapping[str, Any]) -> Any:
    if not callable(kind):
        raise InvalidSettingError(f"--likelihood {name} is an object, which takes no settings")
    try:
        inspect.signature(kind).bind(**settings)
    except TypeError as error:
        raise InvalidSettingError(f"--likelihood {name}: {error}") from None
    return kind(**settings)


def _fields(kind: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))  # type: ignore[arg-type]


def stepwise_settings() -> tuple[str, ...]:
    """Return the names of the settings of the closed loop's likelihood."""
    return (*_fields(phase_ppl.StepwiseLikelihood), *_fields(phase_ppl.Tracking))


def is_stepwise(text: str | None) -> bool:
    """Return whether ``--likelihood`` names the closed loop's."""
    return text is not None and with_settings(text, "--likelihood")[0] == LIKELIHOODS[1]
