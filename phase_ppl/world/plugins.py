"""Loading what registers itself: a file each of ours, and of other packages."""

from __future__ import annotations

import importlib
import importlib.metadata
import pkgutil
import warnings


def load_registered(what: str, package: str | None, entry_points: str) -> None:
    """Import every module of a package of ours, then the entry points of other packages.

    Somebody else's that cannot be loaded is left out with a warning.

    Args:
        what: is registered, for the warning.
        package: of ours, by its full name; None where ours are known already.
        entry_points: their group.
    """
    if package is not None:
        for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
            importlib.import_module(f"{package}.{module.name}")
    for entry in importlib.metadata.entry_points(group=entry_points):
        try:
            entry.load()
        except Exception as error:  # it must not break ours
            warnings.warn(f"{what} {entry.name!r} cannot be loaded: {error}", stacklevel=3)
