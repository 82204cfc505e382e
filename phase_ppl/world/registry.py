"""Named entries, such as planners: this package's and other packages'."""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
import pkgutil
import warnings
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.identity import qualified_name

Entry = TypeVar("Entry")
Function = TypeVar("Function", bound=Callable[..., Any])


class Registry(Generic[Entry]):
    """Name -> entry. All are loaded when an unknown name is asked for.

    Modules of ``package`` register our entries; they are imported to find them, if it is given.
    Other packages offer theirs by ``entry_points``.
    """

    def __init__(
        self, what: str, *, package: str | None = None, entry_points: str | None = None
    ) -> None:
        self.entries: dict[str, Entry] = {}
        self._what, self._package, self._entry_points = what, package, entry_points
        self._registered_by: dict[str, str] = {}
        self._loaded = False

    def register(
        self, name: str, entry: Callable[[Function, str], Entry]
    ) -> Callable[[Function], Function]:
        """Return a decorator that keeps ``entry(function, summary)`` under ``name``.

        The summary is the first line of the function's documentation.
        """

        def decorate(function: Function) -> Function:
            source = qualified_name(function)  # equal if its module is loaded again
            if name in self.entries and self._registered_by[name] != source:
                raise InvalidSettingError(
                    f"a {self._what} named {name!r} exists: {self._registered_by[name]}"
                )
            self._registered_by[name] = source
            self.entries[name] = entry(function, (inspect.getdoc(function) or "").split("\n")[0])
            return function

        return decorate

    def names(self) -> list[str]:
        """Return all names, sorted."""
        if not self._loaded:
            self._load()
            self._loaded = True
        return sorted(self.entries)

    def __getitem__(self, name: str) -> Entry:
        """Return the entry of that name."""
        if name not in self.entries and name not in self.names():
            raise unknown_name(self._what, name, self.names())
        return self.entries[name]

    def items(self) -> list[tuple[str, Entry]]:
        """Return all names, sorted, with their entries."""
        return [(name, self.entries[name]) for name in self.names()]

    def _load(self) -> None:
        if self._package is not None:
            for module in pkgutil.iter_modules(importlib.import_module(self._package).__path__):
                importlib.import_module(f"{self._package}.{module.name}")
        if self._entry_points is None:
            return
        for entry in importlib.metadata.entry_points(group=self._entry_points):
            try:
                entry.load()
            except Exception as error:  # a broken package must not break ours
                warnings.warn(
                    f"{self._what} {entry.name!r} cannot be loaded: {error}", stacklevel=3
                )
