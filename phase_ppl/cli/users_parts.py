"""Parts of a model from options: ready-made ones by name, user-defined ones from a file."""

from __future__ import annotations

import dataclasses
import functools
import runpy
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli.commands import Options, one_line, option_value
from phase_ppl.world.errors import InvalidSettingError, check_name, unknown_name
from phase_ppl.world.files import existing_file

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig

PARTS: Final = ("prior", "simulator", "likelihood")  # options of a model
_SUFFIX: Final = ".py"


def model(
    options: Options, planner: str | PlannerConfig | None = None, **settings: Any
) -> phase_ppl.Model:
    """Return the model of the options; ``settings`` are of its likelihood."""
    given = options.given(*PARTS)
    if "prior" in given:
        given["prior"] = taken(options.prior, "prior")
    if "simulator" in given:
        given["simulator"] = taken(options.simulator, "simulator", named=False)
    if "likelihood" in given or settings:
        given["likelihood"] = _likelihood(options.likelihood or "radial", settings)
    return phase_ppl.Model(planner=planner, **given)


def taken(text: str, what: str, named: bool = True) -> Any:
    """Return the object NAME of ``FILE.py:NAME``, or the text itself if it has another form.

    The file is run, which is announced on stderr.

    Args:
        text: of the option.
        what: "prior", "simulator" and so on, for messages.
        named: whether ready-made ones by name exist as well.
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
    """Return what a file defines; it is run once unless it changes."""
    try:
        return runpy.run_path(str(path), run_name=path.stem)
    except Exception as error:  # a user's file can raise anything
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise InvalidSettingError(f"{path} cannot be run: {reason}") from error


def with_settings(text: str, option: str) -> tuple[str, dict[str, Any]]:
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
            raise InvalidSettingError(f"{option}: {one!r} in {text!r} is no OPTION=VALUE")
        settings[key] = option_value(value)
    return name, settings


def _likelihood(text: str, more: Mapping[str, Any]) -> Any:
    """Return the likelihood of an option such as ``radial:beta=0.1``, with more settings."""
    name, settings = with_settings(text, "--likelihood")
    if twice := settings.keys() & more:
        raise InvalidSettingError(f"--option {min(twice)}: --likelihood {text} has it too")
    settings |= more
    if ":" in name:
        kind = taken(name, "likelihood")
        if not (isinstance(kind, type) or settings):
            return kind
    else:
        check_name("likelihood", name, ["radial", "closed_loop", "FILE.py:NAME"])
        kind = phase_ppl.RadialLikelihood if name == "radial" else phase_ppl.ClosedLoopLikelihood
    if kind is phase_ppl.ClosedLoopLikelihood:
        of_tracking = {f.name for f in dataclasses.fields(phase_ppl.Tracking)} & settings.keys()
        if of_tracking:
            tracking = {setting: settings.pop(setting) for setting in of_tracking}
            settings["tracking"] = phase_ppl.Tracking(**tracking)
    if not callable(kind):
        raise InvalidSettingError(f"--likelihood {name} is an object, which takes no settings")
    try:
        return kind(**settings)
    except TypeError as error:
        raise InvalidSettingError(f"--likelihood {name}: {error}") from None


def closed_loop_settings() -> set[str]:
    """Return the names of the settings of the closed loop's likelihood."""
    kinds = phase_ppl.ClosedLoopLikelihood, phase_ppl.Tracking
    return {field.name for kind in kinds for field in dataclasses.fields(kind)}
