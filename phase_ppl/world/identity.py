"""Whether something kept in a file is still the same: events, functions, settings."""

from __future__ import annotations

import hashlib
import importlib.metadata
import inspect
import json
import platform
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from phase_ppl import __version__
from phase_ppl.world.errors import shown
from phase_ppl.world.event import Event

LIBRARIES: Final = ("numpyro", "jax", "numpy", "xarray", "pymunk", "numba")
"""Those whose versions can change a number."""

_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")


def event_digest(event: Event) -> str:
    """Return a hash of all that inference sees of an event."""
    scene = event.scene
    digest = hashlib.sha256(scene.turning.encode())
    for values in (
        *(scene.start, scene.radius, scene.walls, np.array(scene.arena)),
        *(scene.landmark_centres, np.array(scene.landmark_half_width)),
        event.observation.trajectory,
    ):
        digest.update(np.ascontiguousarray(values, np.float64).tobytes())
    return digest.hexdigest()


def source_hash(thing: Callable[..., Any] | None) -> str | None:
    """Return a hash of the source of a function or of an object's class; None without source."""
    try:
        source = inspect.getsource(thing if hasattr(thing, "__qualname__") else type(thing))  # type: ignore[arg-type]
    except (OSError, TypeError):
        return None
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def qualified_name(thing: Any) -> str:
    """Return module and name of a function, or of an object's class."""
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return f"{named.__module__}.{named.__qualname__}"


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of :data:`LIBRARIES`."""
    found = {name: importlib.metadata.version(name) for name in LIBRARIES}
    return {"phase_ppl": __version__, "python": platform.python_version(), **found}


def stable(value: Any) -> Any:
    """Return ``value`` in JSON's types, without what differs from process to process."""
    text = json.dumps(value, default=repr, sort_keys=True)
    return json.loads(_ADDRESS.sub("", text))


def differences(stored: Mapping[str, Any], given: Mapping[str, Any], within: str = "") -> list[str]:
    """Return in words where two identities differ, such as "model.noise is 'a', was 'b'"."""
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
