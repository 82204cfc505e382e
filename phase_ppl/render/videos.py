"""Videos of a whole set of events, in parallel."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from phase_ppl.render.video import video
from phase_ppl.world.checks import number_of_workers
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder

_LONGEST_NAME: Final = 80


def videos(
    events: Sequence[Event],
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: bool | None = None,
) -> list[Path]:
    """Write an MP4 of each event, ID.mp4, in the look of the PHASE videos.

    A video that is there already is not made again, so an interrupted call is taken up by the
    next one. A video appears only once it is complete.

    Args:
        events: the set.
        folder: where the videos are to be; made if need be.
        workers: processes; default one per usable core.
        progress: whether to show a progress bar; None: where stderr is a terminal.

    Returns:
        The files, in the order of the events.

    Raises:
        InvalidEventError: two events have the same id.
        InvalidSettingError: ``workers`` is no positive number.
        OutputError: a file cannot be written.
    """
    import loky
    from tqdm import tqdm

    n_workers = number_of_workers(workers)
    target = writable_folder(folder)
    paths = [target / name for name in _names(events)]
    waiting = [pair for pair in zip(events, paths, strict=True) if not pair[1].is_file()]
    disable = None if progress is None else not progress
    done = len(events) - len(waiting)
    with tqdm(total=len(events), initial=done, disable=disable, unit="video") as bar:
        if min(n_workers, len(waiting)) < 2:
            for event, path in waiting:
                video(event, path)
                bar.update()
            return paths
        with loky.ProcessPoolExecutor(min(n_workers, len(waiting))) as pool:
            running = [pool.submit(video, event, path) for event, path in waiting]
            try:
                for future in loky.as_completed(running):
                    future.result()
                    bar.update()
            except BaseException:
                for future in running:  # those that have begun are finished
                    future.cancel()
                raise
    return paths


def _names(events: Sequence[Event]) -> list[str]:
    """Return a file name for each event: its id, where it is fit for one.

    Raises:
        InvalidEventError: two events have the same id.
    """
    ids = Counter(event.id for event in events)
    twice = next((name for name, n in ids.items() if n > 1), None)
    if twice is not None:
        raise InvalidEventError(f"two events have the id {shown(twice)}")
    lower = Counter(name.lower() for name in ids)  # one file to many a file system
    names = []
    for name in ids:
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name)[:_LONGEST_NAME]
        if plain != name or plain.startswith(".") or lower[name.lower()] > 1:
            code = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
            plain = f"{plain.lstrip('.')}-{code}"
        names.append(f"{plain}.mp4")
    return names
