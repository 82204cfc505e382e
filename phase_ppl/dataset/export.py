"""Writing events in formats that other programs read."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from phase_ppl.dataset import events_json, phase_test
from phase_ppl.dataset.load import PathLike, check_ids, naming, save_events
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.files import atomic_output, check_output

EXPORTS: Final[Mapping[str, tuple[str, ...]]] = {
    "json": (".json",),
    "netcdf": (".nc",),
    "phase-test": (".json",),
    "phase-processed": (".pkl", ".pickle", ".pik"),
}
"""Format -> endings of the names of its files."""


def export_events(events: Sequence[Event], path: PathLike, format: str) -> None:
    """Write events to a file in a given format.

    Args:
        events: with different ids.
        path: a name that ends as the format's files do, see ``EXPORTS``.
        format: "json" or "netcdf", as :func:`~phase_ppl.dataset.load.save_events` writes them;
            "phase-test", the authors' test videos as JSON (:mod:`phase_ppl.dataset.phase_test`);
            "phase-processed", a pickle of plain data and arrays as the authors have them
            (:mod:`phase_ppl.dataset.authors.videos`), which
            ``load_events(path, format="phase-pickle")`` reads. The first two keep everything, the
            others what they have a place for.

    Raises:
        UnknownNameError: there is no such format.
        OutputError: the file cannot be written, or its name ends otherwise.
        InvalidEventError: no events, an id given twice, or an event has something that the format
            has no place for.
    """
    if format not in EXPORTS:
        raise unknown_name("format", format, EXPORTS)
    suffixes = EXPORTS[format]
    check_output(path, suffixes)
    if format in ("json", "netcdf"):
        save_events(events, path)
        return
    with naming(path):
        check_ids([event.id for event in events])
    content = (_phase_test if format == "phase-test" else _phase_processed)(events, path)
    with atomic_output(path, suffixes) as part:
        part.write_bytes(content)


def _phase_test(events: Sequence[Event], path: PathLike) -> bytes:
    videos = _each(events, path, functools.partial(phase_test.video, like=events[0].scene))
    with naming(path):
        return events_json.to_text(phase_test.document(videos, events[0].scene)).encode()


def _phase_processed(events: Sequence[Event], path: PathLike) -> bytes:
    # brings the simulator, by way of the reflections
    from phase_ppl.dataset.authors import videos

    return videos.pickled(_each(events, path, videos.video))


def _each(
    events: Sequence[Event], path: PathLike, video: Callable[[Event], dict[str, Any]]
) -> list[dict[str, Any]]:
    videos = []
    for event in events:
        with naming(path, event.id):
            videos.append(video(event))
    return videos
