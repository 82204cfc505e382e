"""A study: a folder with its settings, its films and people's answers."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib.util
import os
import secrets
import socket
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np

import phase_ppl as ppl
from phase_study import exports
from phase_study import settings as settings_module
from phase_study import store as store_module
from phase_study.clips import clips_of, make_clips
from phase_study.exports import Status
from phase_study.settings import KINDS, Settings, template
from phase_study.store import Stimulus, Store

EVENTS: Final = "events.json"
VIDEOS: Final = "videos"
CLIPS_FOLDER: Final = "clips"
_ANY: Final = ("0.0.0.0", "::")
_LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_NEEDS: Final = ("starlette", "uvicorn", "websockets", "markdown_it")
_PLACEHOLDER: Final = "[who is responsible"

PathLike = str | os.PathLike[str]


def check_extra() -> None:
    """Raise InvalidSettingError if the extra ``study`` is not installed."""
    missing = [name for name in _NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ppl.errors.InvalidSettingError(
            f"a study needs {', '.join(missing)}, which is not installed: "
            "pip install 'phase_ppl[study]'"
        )


class Served:
    """What is served to browsers: a study, or a live game."""

    _locked: Path | None = None  # folder that is this process's meanwhile

    def app(self, url: str = "", host: str = "127.0.0.1") -> Any:
        """Return the application; functions in ``state.opening`` are awaited before people come."""
        raise NotImplementedError

    def check(self) -> list[str]:
        """Return what should still be looked at before people come."""
        return []

    def run(
        self,
        port: int = 8000,
        host: str = "127.0.0.1",
        url: str = "",
        *,
        ready: Callable[[str], object] = print,
        keep: Callable[[Any], object] = lambda server: None,
    ) -> None:
        """Serve the study or game to browsers until it is interrupted.

        Args:
            port: port at which to listen; 0: a free one.
            host: address at which to listen. Any other than this machine's needs TLS in front of
                it.
            url: address by which people reach the server, such as "https://study.example.org".
            ready: function that is called with the address once people can come.
            keep: function that is called with uvicorn's server before it runs; setting the server's
                ``should_exit`` ends it.

        Raises:
            InvalidEventError: a film of a study is missing or was changed.
            InvalidSettingError: the extra ``study`` is missing; or ``url`` is invalid, or missing
                for a host such as 0.0.0.0.
            OutputError: another server uses the port, or the study's folder.
        """
        check_extra()
        import uvicorn

        from phase_study.server import MOST_MESSAGE

        _check_host(host, url)
        for warning in self.check():
            print(f"phase-ppl: note: {warning}", file=sys.stderr)
        app = self.app(url, host)
        with ppl.files.locked(self._locked), _listening(host, port) as listener:
            config = uvicorn.Config(
                app, access_log=False, log_level="warning", server_header=False,
                proxy_headers=False, ws_max_size=MOST_MESSAGE, ws_ping_interval=2,
                ws_ping_timeout=5, lifespan="on", timeout_graceful_shutdown=5,
            )  # fmt: skip
            shown = f"[{host}]" if ":" in host else host
            address = url or f"http://{shown}:{listener.getsockname()[1]}/"

            async def tell() -> None:
                ready(address)  # people who come before the first request is answered wait

            app.state.opening.append(tell)
            server = uvicorn.Server(config)
            keep(server)
            server.run(sockets=[listener])
            if not server.started:
                raise ppl.errors.OutputError("the server did not start")


class Study(Served):
    """A study of people in the browser, kept in a folder; :meth:`new` makes one.

    Args:
        folder: folder of the study.

    Raises:
        InvalidEventError: the folder holds no study.
        InvalidSettingError, UnknownNameError: its ``study.toml`` is invalid.
    """

    def __init__(self, folder: PathLike) -> None:
        self.folder = self._locked = ppl.files.as_path(folder)
        file = ppl.files.existing_file(self.folder / settings_module.FILE)
        self.settings = Settings.read(file, _world_of(self.events.values()))
        with self.store() as store:
            kind = store.fact("kind")
            if self.settings.kind != kind:
                raise ppl.errors.InvalidSettingError(
                    f"{self.folder}: kind = {self.settings.kind!r}, but the study is one of {kind}"
                )
            known = [stimulus.event for stimulus in store.stimuli().values()]
        for event in self.settings.checks:
            ppl.errors.check_name("video in [checks]", event, known)

    @classmethod
    def new(
        cls,
        folder: PathLike,
        events: PathLike | ppl.Event | Sequence[ppl.Event],
        kind: str = "judgment",
        *,
        generated: PathLike | ppl.Event | Sequence[ppl.Event] | None = None,
        title: str = "What are they doing?",
        trials: int | None = None,
        raters: int | None = None,
        workers: int | None = None,
        progress: bool | None = None,
    ) -> Study:
        """Make a study: ``study.toml``, films with meaningless names, and the database.

        Args:
            folder: folder for the study, empty or not yet existing.
            events: the events to show, all of one world. For a study of play, the events whose
                scenes, goals and strengths are played; for likeness, the events that people played.
            kind: "judgment" (of goals and relation), "tagging" (with labels), "likeness" (ratings
                of how likely people are to behave like this) or "play" (of pairs who steer the
                agents).
            generated: for likeness, the counterparts of ``events``: simulated events with the same
                scene, goals and strengths. By default they are simulated now.
            title: title of the pages.
            trials: number of videos that a person sees, by default 10; for play, of sessions that a
                pair plays, by default 3.
            raters: number of people per video, by default 20; for play, of sessions per scene, by
                default 5.
            workers: number of processes that make films; by default one per usable core.
            progress: whether to show a bar; None: if stderr is a terminal.

        Raises:
            UnknownNameError: there is no such kind.
            InvalidSettingError: events are of several worlds, or of another world than PHASE in a
                study of play.
            InvalidEventError: events lack a truth that is needed, or a counterpart.
            OutputError: the folder is not empty, or cannot be written.
        """
        ppl.errors.check_name("kind", kind, KINDS)
        usual = (3, 5) if kind == "play" else (10, 20)
        trials = usual[0] if trials is None else ppl.errors.whole_number("trials", trials)
        raters = usual[1] if raters is None else ppl.errors.whole_number("raters", raters)
        if generated is not None and kind != "likeness":
            raise ppl.errors.InvalidSettingError(
                f"generated: only for a study of likeness, not of {kind}"
            )
        shown, stimuli = _stimuli(kind, events, generated)
        target = ppl.files.writable_folder(folder)
        if any(target.iterdir()):
            raise ppl.errors.OutputError(f"{target} is not empty: a study gets a folder of its own")
        with ppl.files.locked(target):
            target.chmod(0o700)
            world = shown[0].scene.world
            make_clips(target / CLIPS_FOLDER, world)
            if kind != "play":
                names = [secrets.token_hex(12) for _ in shown]
                hidden = [dataclasses.replace(e, id=n) for e, n in zip(shown, names, strict=True)]
                films = ppl.render.videos(
                    hidden, target / VIDEOS, workers=workers, progress=progress
                )
                stimuli = [
                    one._replace(file=film.name, sha256=_digest(film))
                    for one, film in zip(stimuli, films, strict=True)
                ]
            ppl.save_events(shown, target / EVENTS)
            Store.create(target / store_module.FILE, kind, stimuli).close()
            if kind != "play":  # a person sees one group, and one of several copies
                alike = {s.copies or s.event for s in stimuli if s.grp in (None, "played")}
                trials = min(trials, len(alike))
            text = template(
                kind, title, trials=trials, raters=raters, n_videos=len(stimuli), world=world
            )
            ppl.files.write_bytes(target / settings_module.FILE, (".toml",), text.encode())
        return cls(target)

    def store(self) -> contextlib.closing[Store]:
        """Open the study's database, for a ``with``; the server may be using it meanwhile."""
        return contextlib.closing(Store(self.folder / store_module.FILE))

    @functools.cached_property
    def events(self) -> Mapping[str, ppl.Event]:
        """Event id -> event, for the videos that people see or the scenes that they play."""
        return {event.id: event for event in ppl.load_events(self.folder / EVENTS)}

    def events_by_digest(self) -> dict[str, str]:
        """Return SHA-256 of a film -> id of its event."""
        with self.store() as store:
            return {s.sha256: s.event for s in store.stimuli().values() if s.sha256}

    # --- serving ----------------------------------------------------------------------------------

    def check(self) -> list[str]:
        """Check that the study can be run; return warnings that a researcher should look at.

        Raises:
            InvalidEventError: a film is missing or was changed.
        """
        with self.store() as store:
            for stimulus in store.stimuli().values():
                film = self.folder / VIDEOS / (stimulus.file or "")
                if stimulus.file and (not film.is_file() or _digest(film) != stimulus.sha256):
                    why = "has changed" if film.is_file() else "is missing"
                    raise ppl.errors.InvalidEventError(
                        f"{film}, of event {stimulus.event!r}, {why}"
                    )
        for name in clips_of(self.settings.world):
            clip = self.folder / CLIPS_FOLDER / f"{name}.mp4"
            if not clip.is_file():
                raise ppl.errors.InvalidEventError(f"{clip} is missing")
        warnings = []
        if _PLACEHOLDER in self.settings.texts["consent"]:
            warnings.append("the text of consent in study.toml does not yet say who is responsible")
        if self.settings.kind == "play":
            from phase_study import room

            warnings += room.warnings(self.events.values(), self.settings.play)
        return warnings

    def app(self, url: str = "", host: str = "127.0.0.1") -> Any:
        """Return the application, for an ASGI server of your own, which must be one process.

        Args:
            url: address by which people reach the server; with ``https``, cookies are for TLS only.
            host: address at which the server listens.
        """
        check_extra()
        from phase_study.server import Site, create_app

        names, is_secure = names_of(url, host)
        site = Site(self.folder, self.settings, self.events, secure=is_secure)
        if self.settings.kind == "play":
            from phase_study.play import routes

            return create_app(site, names, routes(site))
        return create_app(site, names)

    # --- results ----------------------------------------------------------------------------------

    def status(self) -> Status:
        """Return how many people came, how far they got, and how often each video was judged."""
        with self.store() as store:
            return exports.status(store, self.settings)

    def export(
        self, out: PathLike, *, include: Sequence[str] = ("flagged",), demographics: bool = False
    ) -> Path:
        """Write all answers so far into a folder; the study may go on meanwhile.

        Args:
            out: the folder; files of an earlier export in it are replaced.
            include: which people to export beside those who finished: "unfinished", "excluded" and
                "flagged" (by attention checks).
            demographics: whether to write age and gender of each participant, not totals only.

        Returns:
            The folder.

        Raises:
            UnknownNameError: ``include`` has another value.
            OutputError: the folder cannot be written, or holds other files.
        """
        for name in include:
            ppl.errors.check_name("people to include", name, exports.INCLUDE)
        target = ppl.files.writable_folder(out)
        exports.check_folder(target)
        with ppl.files.locked(target), tempfile.TemporaryDirectory(dir=self.folder) as folder:
            with self.store() as live:
                snapshot = live.snapshot(Path(folder) / store_module.FILE)
            with contextlib.closing(snapshot) as store:
                exports.write(store, self.settings, self.events, target, include, demographics)
        return target

    def withdraw(self, participant: str) -> None:
        """Delete all data of a participant.

        Raises:
            UnknownNameError: there is no such participant.
        """
        with self.store() as store:
            store.withdraw(participant)

    def exclude(self, participant: str, reason: str) -> None:
        """Exclude a participant from exports, and give that person's videos to others.

        ``reason`` is a text that is kept.

        Raises:
            UnknownNameError: there is no such participant.
        """
        with self.store() as store:
            store.exclude(participant, reason)

    def __repr__(self) -> str:
        return f"<Study of {self.settings.kind} in {self.folder}>"


def names_of(url: str, host: str) -> tuple[list[str], bool]:
    """Return the names by which people reach a server, and whether they come over TLS.

    Raises:
        InvalidSettingError: the url is invalid.
    """
    parts = urlsplit(url)
    if url and (
        parts.scheme not in ("http", "https") or not parts.hostname or parts.path.strip("/")
    ):
        raise ppl.errors.InvalidSettingError(
            f"url {url!r}: expected one such as https://study.example.org"
        )
    names = [name for name in (parts.hostname, host) if name and name not in _ANY]
    return names, parts.scheme == "https"


def _check_host(host: str, url: str) -> None:
    """Say on stderr that others can come without TLS.

    Raises:
        InvalidSettingError: nobody can come, as the name that they would use is not known.
    """
    if host in _ANY and not url:
        raise ppl.errors.InvalidSettingError(
            f"host {host} needs url, the address by which people come"
        )
    if host not in _LOOPBACK and not url.startswith("https:"):
        print(
            f"phase-ppl: note: {host} can be reached by others without TLS; put a proxy before it",
            file=sys.stderr,
        )


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=2048)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ppl.errors.OutputError(f"cannot listen at {host}, port {port}: {reason}") from None


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


# --- which videos ---------------------------------------------------------------------------------


def _stimuli(kind: str, events: Any, generated: Any) -> tuple[list[ppl.Event], list[Stimulus]]:
    """Return the events of a study in its order, and the data to store of each."""
    is_path = isinstance(events, str | os.PathLike)
    is_generated = is_path and (ppl.files.as_path(events) / "manifest.json").is_file()
    source = ppl.load_events(events) if is_generated else events
    found = ppl.all_events(source)
    world = _world_of(found)
    if kind == "play" and world != ppl.worlds.PHASE:
        raise ppl.errors.InvalidSettingError(
            f"a study of play knows the world PHASE only, not {world.name!r}"
        )
    if kind in ("likeness", "play"):
        for event in found:
            _check_truth(event, kind)
    if kind == "likeness":
        partners = counterparts(found, None if generated is None else ppl.all_events(generated))
        return [*found, *partners], [
            Stimulus(event.id, group, pair)
            for group, part in (("played", found), ("generated", partners))
            for pair, event in enumerate(part)
        ]
    groups: dict[str, str] = {}
    if isinstance(source, ppl.GeneratedEvents):
        groups = {entry["id"]: str(entry.get("group", entry["id"])) for entry in source.entries}
    several = [groups.get(event.id, event.id) for event in found]
    size = Counter(several)
    return found, [
        Stimulus(event.id, copies=group if size[group] > 1 else None)
        for event, group in zip(found, several, strict=True)
    ]


def _world_of(events: Iterable[ppl.Event]) -> ppl.World:
    worlds = list(dict.fromkeys(event.scene.world for event in events)) or [ppl.worlds.PHASE]
    if len(worlds) > 1:
        names = [world.name for world in worlds]
        differing = "" if len({*names}) == len(names) else " (alike in name only)"
        raise ppl.errors.InvalidSettingError(
            f"the events are of the worlds {', '.join(map(repr, names))}{differing}, expected "
            "those of one world"
        )
    return worlds[0]


def _check_truth(event: ppl.Event, kind: str) -> None:
    truth = event.truth
    strengths = (getattr(truth, f"strength_{name}", None) for name in ("red", "green"))
    if not isinstance(truth, ppl.Hypothesis) and None in strengths:
        raise ppl.errors.InvalidEventError(
            f"event {event.id!r} does not say its goals and strengths; a study of {kind} needs them"
        )


# --- pairs of played and generated events, for a study of likeness --------------------------------


def counterparts(
    played: Sequence[ppl.Event], generated: Sequence[ppl.Event] | None
) -> list[ppl.Event]:
    """Return for each played event the generated one of the same scene, goals and strengths.

    By default the agents' planner simulates them, as long as the played ones, in a world whose
    agents keep their velocities.
    """
    if generated is None:
        return [_simulated(event, seed) for seed, event in enumerate(played)]
    left, ids = list(generated), {event.id for event in played}
    return [
        dataclasses.replace(event, id=f"{event.id}-generated") if event.id in ids else event
        for event in (_counterpart(one, left) for one in played)
    ]


def _counterpart(event: ppl.Event, left: list[ppl.Event]) -> ppl.Event:
    """Take the counterpart of an event out of ``left``."""
    for place, other in enumerate(left):
        if other.truth is not None and _are_alike(event, other):
            return left.pop(place)
    raise ppl.errors.InvalidEventError(
        f"event {event.id!r} has no counterpart (any more) of the same scene, goals and strengths"
    )


def _are_alike(one: ppl.Event, other: ppl.Event) -> bool:
    return one.scene.world == other.scene.world and all(
        np.shape(first) == np.shape(second) and np.allclose(first, second)
        for first, second in zip(_setting(one), _setting(other), strict=True)
    )


def _setting(event: ppl.Event) -> list[Any]:
    """Return scene, goals and strengths of an event, in numbers."""
    scene, truth = event.scene, event.truth
    if isinstance(truth, ppl.Hypothesis):
        goals, strengths = truth.effective_goals, np.array(truth.strengths)
    else:
        goals = tuple(map(scene.world.goal_index, (truth.goal_red, truth.goal_green)))
        strengths = np.array([truth.strength_red, truth.strength_green], float)
    return [scene.start, scene.radius, scene.walls, scene.landmark_centres, scene.arena, goals,
            strengths]  # fmt: skip


def _simulated(event: ppl.Event, seed: int) -> ppl.Event:

    hypothesis = truth = event.truth
    if not isinstance(truth, ppl.Hypothesis):
        strengths = truth.strength_red, truth.strength_green
        try:
            hypothesis = ppl.Hypothesis(truth.goal_red, truth.goal_green, (0, 0), *strengths)
        except ppl.errors.InvalidSettingError as error:
            raise ppl.errors.InvalidEventError(f"event {event.id!r}: {error}") from None
    return ppl.simulate(
        dataclasses.replace(event.scene, resets_velocity=False),
        hypothesis,
        frames=event.observation.n_frames,
        seed=seed,
        id=f"{event.id}-generated",
        overlapping=True,
    )
