"""Hashes and versions that tell whether events, functions and settings of a file are the same."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import inspect
import json
import platform
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from phase_ppl import __version__
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.scene import Scene, world_in_files

LIBRARIES: Final = ("numpyro", "jax", "numpy", "xarray", "pymunk", "numba")
"""Libraries whose versions can change a number."""

_PACKAGE: Final = Path(__file__).resolve().parent.parent
_FOLDERS: Final = (
    *("world", "physics", "agents", "simulator", "closed_loop"),
    *("data", "models", "inference", "evaluation/models"),
)
"""Folders of the package whose code, or weights of networks, results depend on."""

_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")


def event_digest(event: Event) -> str:
    """Return a hash of all that inference sees of an event."""
    scene = event.scene
    digest = hashlib.sha256(physics_rules(scene))
    for values in (
        *(scene.start, scene.radius, scene.walls, np.array(scene.arena)),
        *(scene.landmark_centres, np.array(scene.landmark_half_width)),
        event.observation.trajectory,
    ):
        digest.update(np.ascontiguousarray(values, np.float64).tobytes())
    return digest.hexdigest()


def physics_rules(scene: Scene) -> bytes:
    """Return a world's rules beyond its numbers, as bytes for a hash."""
    world = f" {scene.world.entities} {scene.world.landmark_names}"
    if world_in_files(scene.world) is None:
        world = ""
    resets = " resets velocity" if scene.resets_velocity else ""
    return f"{scene.turning}{resets}{world}".encode()


def source_hash(thing: Callable[..., Any] | None) -> str | None:
    """Return a hash of the source of a function or of an object's class; None without source."""
    thing = thing.func if isinstance(thing, functools.partial) else thing
    try:
        source = inspect.getsource(thing if hasattr(thing, "__qualname__") else type(thing))  # type: ignore[arg-type]
    except (OSError, TypeError):
        return None
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def qualified_name(thing: Any) -> str:
    """Return module and name of a function, or of an object's class."""
    if isinstance(thing, functools.partial):
        given = [*map(repr, thing.args), *(f"{k}={v!r}" for k, v in thing.keywords.items())]
        return f"{qualified_name(thing.func)}({', '.join(given)})"
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return f"{named.__module__}.{named.__qualname__}"


def source_stamp(files: Iterable[Path]) -> str:
    """Return a hash of the names and contents of ``files``, in any order."""
    digest = hashlib.sha256()
    for file in sorted(files):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{file.name} {content}\n".encode())
    return digest.hexdigest()


@functools.cache
def code_stamp() -> str:
    """Return a hash of all of this package's code that results depend on."""
    return source_stamp(_stamped())[:16]


def code_changed_since(time: float) -> bool:
    """Whether a file that :func:`code_stamp` covers was changed after a time, s since the epoch."""
    return any(file.stat().st_mtime > time for file in _stamped())


def _stamped() -> list[Path]:
    found = (file for name in _FOLDERS for file in (_PACKAGE / name).rglob("*"))
    return [file for file in found if file.suffix in (".py", ".npz")]


def versions() -> dict[str, str]:
    """Return the versions of Python, :data:`LIBRARIES` and this package, and its code stamp."""
    found = {name: importlib.metadata.version(name) for name in LIBRARIES}
    return {
        "phase_ppl": __version__,
        "source": code_stamp(),
        "python": platform.python_version(),
        **found,
    }


def versions_so_far(
    before: Sequence[Mapping[str, Any]], path: object, other_versions: bool | None = None
) -> list[dict[str, Any]]:
    """Return the code versions that produced a file, oldest first; the running version is last.

    ``other_versions`` says whether another version may continue it; None: the user cannot choose.
    """
    now = versions()
    last = before[-1] if before else {}
    found = differences(last if isinstance(last, Mapping) else {}, now)
    if before and found and not other_versions:
        choice = "; --other-versions (other_versions=True) goes on with these, and records both"
        raise InvalidSettingError(
            f"{path} was made with other versions: {'; '.join(found)}"
            f"{'' if other_versions is None else choice}"
        )
    return [*map(dict, before), *([now] if found or not before else [])]


def stable(value: Any, *, sort_keys: bool = True) -> Any:
    """Return ``value`` in JSON's types, without anything that differs between processes."""
    text = json.dumps(value, default=repr, sort_keys=sort_keys)
    return json.loads(_ADDRESS.sub("", text))


def differences(stored: Mapping[str, Any], given: Mapping[str, Any], within: str = "") -> list[str]:
    """Return in words where two identities differ, such as "kernel.name is 'a', was 'b'"."""
    found: list[str] = []
    for name in dict.fromkeys([*stored, *given]):
        old, new = stored.get(name), given.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            found += differences(old, new, f"{within}{name}.")
        elif old != new:
            hashed = name in ("event", "source") or name.endswith("_source")
            how = "differs" if hashed else f"is {shown(new)}, was {shown(old)}"
            found.append(f"{within}{name} {how}")
    return found
