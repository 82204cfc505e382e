"""Reading and writing events: the package's own files, the authors' videos, bundled events."""

from phase_ppl.dataset.load import (
    bundled_events,
    export_events,
    load_bundled,
    load_event,
    load_events,
    save_event,
    save_events,
)

__all__ = [
    "bundled_events",
    "export_events",
    "load_bundled",
    "load_event",
    "load_events",
    "save_event",
    "save_events",
]
