"""phase_ppl: social perception grounded in intuitive physics, as a probabilistic program.

Everything a user needs is here; nothing is imported before it is used. Which names there are, and
from where, stands in ``__init__.pyi``, which type checkers read too.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

__version__ = "0.1.0"


def _places() -> dict[str, tuple[str, str]]:
    """Return public name -> (module, its name there, which may be that of a module).

    The name is empty where the module itself is meant: an application.
    """
    found: dict[str, tuple[str, str]] = {}
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body:
        match statement:
            case ast.ImportFrom(module=str(module), names=names):
                found |= {entry.asname or entry.name: (module, entry.name) for entry in names}
            case ast.Import(names=[ast.alias(name=module, asname=str(name))]):  # an application
                found[name] = (module, "")
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Name(id=other)):
                found[name] = found.pop(other)
    return found


_PLACES = _places()

__all__ = ["__version__", *sorted(_PLACES)]


def unsupported() -> str | None:
    """Return what to do where the package cannot run, in words; None where it can."""
    try:
        import fcntl  # noqa: F401  (which stands for all that systems of this kind have)
    except ImportError:
        return "phase_ppl runs on Linux and macOS; on Windows, install and use it in WSL"
    return None


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if problem := unsupported():
        raise ImportError(problem)
    module, original = _PLACES[name]
    source = importlib.import_module(module)
    if not original:
        value: Any = source
    elif module != __name__ and hasattr(source, original):
        value = getattr(source, original)
    else:
        value = importlib.import_module(f"{module}.{original}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
