"""The events that come with the package, made by its own simulator."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable

from phase_ppl.dataset.documents import parse_document
from phase_ppl.dataset.events_json import event_from_record
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.event import Event

_SUFFIX = ".json"


def bundled_events() -> list[str]:
    """Return the names of the bundled events, sorted."""
    folder = _folder()
    if not folder.is_dir():
        return []
    names = (file.name for file in folder.iterdir())
    return sorted(name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX))


def load_bundled(name: str) -> Event:
    """Return the bundled event ``name``.

    Raises:
        UnknownNameError: there is no such event; the message names those that there are.
    """
    names = bundled_events()
    if name not in names:
        raise unknown_name("bundled event", name, names)
    return event_from_record(parse_document((_folder() / f"{name}{_SUFFIX}").read_bytes()))


def _folder() -> Traversable:
    return resources.files("phase_ppl.dataset") / "events"
