"""The events of a NetCDF file as a sequence that reads each when it is asked for."""

from __future__ import annotations

import contextlib
import copy
import importlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final, overload

from phase_ppl.dataset.load import check_ids, naming, turned
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from phase_ppl.world.scene import Turning

if TYPE_CHECKING:
    from phase_ppl.dataset.events_netcdf import Listing

_AT_ONCE: Final = 32
"""Events that are read before the file is closed again, when all are gone through."""


class StoredEvents(Sequence[Event]):
    """Events of a file of several, of which an event is read each time it is asked for.

    The file is open only while something is read, so that any number of processes and threads can
    have the same events, and they can be pickled. Slices are of the same kind, and read nothing.

    Args:
        path: a file as :func:`phase_ppl.dataset.load.save_events` writes it, ending in ".nc".
        turning: "both", "ccw" or "cw" instead of what the file says.

    Raises:
        InvalidEventError: it cannot be read, now or when an event is asked for, or it was changed
            since.
    """

    def __init__(self, path: str | os.PathLike[str], turning: Turning | None = None) -> None:
        self.path = Path(path)
        self._turning = turning
        with naming(self.path):
            self._state = _state(self.path)
            self._listed: Listing = _netcdf().listing(self.path)
            check_ids(self._listed.ids)
        self._places: Sequence[int] = range(len(self._listed.ids))

    @property
    def ids(self) -> list[str]:
        """The ids of the events, in their order."""
        return [self._listed.ids[place] for place in self._places]

    def chosen(self, indices: Sequence[int]) -> StoredEvents:
        """Return some of the events, in the order of the indices."""
        found = copy.copy(self)
        found._places = [self._places[index] for index in indices]
        return found

    def read(self, indices: Sequence[int]) -> list[Event]:
        """Return events in one go.

        Raises:
            InvalidEventError: the file cannot be read, or an event is damaged; it is named.
        """
        netcdf = _netcdf()
        with naming(self.path):
            if _state(self.path) != self._state:
                raise InvalidEventError("was changed since its events were listed; load it again")
        events = []
        with contextlib.ExitStack() as stack:
            with naming(self.path):
                file = stack.enter_context(netcdf.opened(self.path))
            for place in (self._places[index] for index in indices):
                with naming(self.path, self._listed.ids[place]):
                    events.append(netcdf.event_at(file, self._listed, place))
        return events if self._turning is None else [turned(e, self._turning) for e in events]

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> StoredEvents: ...

    def __getitem__(self, index: int | slice) -> Event | StoredEvents:
        if isinstance(index, slice):
            return self.chosen(range(len(self))[index])
        return self.read([range(len(self))[index]])[0]

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[Event]:
        for start in range(0, len(self), _AT_ONCE):
            yield from self.read(range(start, min(start + _AT_ONCE, len(self))))


def _state(path: Path) -> tuple[int, int]:
    """Return what tells a file from another that was put in its place."""
    try:
        found = path.stat()
    except OSError as error:
        raise InvalidEventError(f"cannot be read: {error.strerror or error}") from None
    return found.st_mtime_ns, found.st_size


def _netcdf() -> ModuleType:
    """Return the module for NetCDF, which brings xarray: only where it is needed."""
    return importlib.import_module("phase_ppl.dataset.events_netcdf")
