"""Reading an event from a film: :func:`read_video`."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import phase_ppl as ppl
from phase_films.bodies import REACH, SEEN, Bodies
from phase_films.film import FilmFile
from phase_films.still import Colours, Still
from phase_films.view import FloatArray, Pixels, View

_PANELS: Final = 6
_COLUMNS: Final = 3
_PALE: Final = 0.55
_CAPTION: Final = 30  # pixels below a panel
_GAP: Final = 4
_DARKER: Final = 0.7  # colour of a body's path, in colours of the body
_OUTLINE: Final = (20, 20, 20)
_TEXT: Final = (70, 70, 70)
_DOUBTED: Final = (230, 0, 230)

_MIN_FRAMES: Final = 2  # of an event
_MOST_LOST: Final = 0.25  # share of the frames in which a body may be lost
_OTHER_START: Final = 0.5  # units from a scene's start that exceed errors of reading
_SIZED_IN: Final = 7  # frames from which a size is estimated
_ROUNDS: Final = 2  # of sizes and places


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class VideoReading:
    """An event read from a film, and how well the reading matches the pictures.

    Attributes:
        event: the event. It has a scene and an observation, and no truth.
        confidence: (time, entity) numbers from 0 to 1: how far the body as read and the pixels of
            its colour agree. A body that is mostly covered gets a lower one. 0: the body was lost
            in that frame, and its place is interpolated.
    """

    event: ppl.Event
    confidence: FloatArray
    _pictures: dict[int, Image.Image]

    def __repr__(self) -> str:
        frame, entity = np.unravel_index(self.confidence.argmin(), self.confidence.shape)
        lost = int((self.confidence == 0).sum())
        return (
            f"<{self.event.id}: {len(self.confidence)} frames read, "
            f"confidence {np.median(self.confidence):.2f}, "
            f"least {self.confidence.min():.2f} ({self.event.scene.world.entities[entity]}, "
            f"frame {frame}), {lost} place{'s' * (lost != 1)} interpolated>"
        )

    def picture(self, path: str | os.PathLike[str]) -> None:
        """Write a PNG to ``path`` to check the reading by eye: film frames, bodies drawn on them.

        Outlines are the bodies as read, in magenta if the confidence is below 0.5. Lines are the
        bodies' paths since the frame of the panel before. The text below a panel names the frame,
        and the body with the least confidence in it.

        Raises:
            OutputError: the file cannot be written, or its name does not end in .png.
        """
        painter, frames = ppl.render.Painter(self.event.scene), sorted(self._pictures)
        with ppl.files.atomic_output(path, (".png",)) as part:
            panels = [
                self._panel(painter, frame, before)
                for before, frame in zip([0, *frames[:-1]], frames, strict=True)
            ]
            width, height = panels[0].width, panels[0].height + _GAP
            columns = min(_COLUMNS, len(panels))
            size = width * columns, height * -(-len(panels) // columns)
            sheet = Image.new("RGB", size, ppl.render.Painter.background)
            for place, one in enumerate(panels):
                sheet.paste(one, (width * (place % columns), height * (place // columns)))
            sheet.save(part, "PNG")

    def _panel(self, painter: ppl.render.Painter, frame: int, before: int) -> Image.Image:
        drawn = self._pictures[frame]
        drawn = Image.blend(
            drawn, Image.new("RGB", drawn.size, ppl.render.Painter.background), _PALE
        )
        draw = ImageDraw.Draw(drawn)
        scene, track = self.event.scene, self.event.observation.trajectory
        for entity, colour in enumerate(scene.world.entity_colours):
            way = painter.pixel(track[before : frame + 1, entity, :2]) - 0.5
            dark = tuple(round(_DARKER * part) for part in colour)
            draw.line([tuple(at) for at in way.tolist()], fill=dark, width=2)
            sure = self.confidence[frame, entity] >= 0.5
            pose, size = track[frame, entity], float(scene.radius[entity])
            turns = np.linspace(0, 2 * np.pi, 40)
            shape = np.column_stack([np.cos(turns), np.sin(turns)])
            if entity < len(scene.world.agents):
                cos, sin = np.cos(pose[2]), np.sin(pose[2])
                shape = painter.corners @ np.array([[cos, sin], [-sin, cos]])
            line = [tuple(at) for at in (painter.pixel(pose[:2] + size * shape) - 0.5).tolist()]
            draw.line([*line, line[0]], fill=_OUTLINE if sure else _DOUBTED, width=1)
        # the arena with an equal margin on all sides
        x0, _, _, y1 = scene.arena
        left, top = painter.pixel([x0, y1])
        beside = round(left - top)
        least = int(self.confidence[frame].argmin())
        words = (
            f"frame {frame}: least {self.confidence[frame, least]:.2f}, "
            f"{scene.world.entities[least]}"
        )
        width, height = drawn.width - 2 * beside, drawn.height + _CAPTION
        result = Image.new("RGB", (width, height), ppl.render.Painter.background)
        result.paste(drawn.crop((beside, 0, beside + width, drawn.height)))
        place, font = (width / 2, height - _CAPTION * 3 / 4), ImageFont.load_default(18)
        ImageDraw.Draw(result).text(place, words, fill=_TEXT, font=font, anchor="mm")
        return result


def read_video(
    path: str | os.PathLike[str],
    scene: ppl.Scene | None = None,
    *,
    layout: str | ppl.World | None = None,
    frames_per_step: float | None = None,
    start: float = 0.0,
    max_gap: int = 6,
    progress: bool | None = None,
) -> VideoReading:
    """Read an event from a film that looks like the package's own films (:func:`render.video`).

    Colours identify the bodies; fitting their shapes to the pixels gives the poses. The film may be
    compressed, of any size, cut, or have bars beside the arena, as long as the arena's border
    shows. An item's angle cannot be seen: it is the scene's angle at the start, or 0 without a
    scene.

    Args:
        path: an .mp4, a .gif, or any other file that ffmpeg reads.
        scene: the scene that the film shows: its world, walls and sizes. It is kept as given.
        layout: a world or its name, such as "phase", if the scene is unknown. Walls, landmarks,
            sizes and starts are then read from the picture. In PHASE the scene's ``turning`` (which
            way agents can turn) is inferred from the turns seen: "both" unless they clearly go one
            way (:func:`phase_ppl.observed_turning`).
        frames_per_step: frames of the film per frame of the event, which is a planner step (1/12 s
            of simulated time). Default: the number of film frames in a quarter of a second, as in
            the package's films. Bodies are taken to move straight between two frames of the film.
        start: seconds of the film before the event begins, such as those of a still picture. For
            the films of PHASE's authors use 0.1. They show five pictures a step, 0.05 s apart.
            The event's frame is the mean over the step, which the third picture shows best.
        max_gap: largest number of successive frames of the event in which a body may be lost; its
            places there are interpolated.
        progress: whether to show a progress bar; None: if stderr is a terminal.

    Returns:
        A :class:`VideoReading`: the ``event``, and the ``confidence`` (time, entity) in each pose,
        from 0 (not seen, interpolated) to 1.

    Raises:
        InvalidEventError: the file is missing or no video; the arena, a colour or a body is not
            found; or the film shows another scene. The message names what and where.
        InvalidSettingError: neither or both of ``scene`` and ``layout`` are given, colours are
            indistinguishable, or a number is out of range.
        UnknownNameError: no ready-made world has the name in ``layout``.
    """
    assumed, world = _scene_or_layout(scene, layout)
    ppl.errors.nonnegative_number("start", start)
    ppl.errors.whole_number("max_gap", max_gap, 0)
    if (
        frames_per_step is not None
        and not 1 <= ppl.errors.number_or_nan(frames_per_step) < math.inf
    ):
        raise ppl.errors.InvalidSettingError(
            f"frames_per_step={ppl.errors.shown(frames_per_step)}, expected a number >= 1"
        )
    colours = Colours(assumed.world)
    film = FilmFile(path)
    moments = _film_frame_of(film, frames_per_step, start)
    view = View(film, assumed)
    samples = [view(frame) for frame in film.samples]
    still, drawn = Still(samples, colours, ppl.render.Painter(assumed)), assumed
    if scene is None:
        centres, halves = still.landmarks()
        drawn = dataclasses.replace(
            assumed,
            walls=still.walls(),
            landmark_centres=centres,
            landmark_half_width=halves[0] if len({*halves}) == 1 else halves,
        )
    else:
        still.check(scene)
    bodies = Bodies(ppl.render.Painter(drawn), still, colours, softness=1 / view.scale)
    radius = drawn.radius if scene is not None else _sizes(bodies, samples, colours)
    found, pictures = _followed(film, view, bodies, radius, moments, progress)
    known = scene.start if scene is not None else None
    drawn = dataclasses.replace(drawn, radius=radius)
    track, confidence = _gaps_filled(found, drawn, moments / (film.fps or math.nan), max_gap, known)
    if scene is None:
        scene = dataclasses.replace(drawn, start=track[0], world=world)
        if scene.world == ppl.worlds.PHASE:
            scene = dataclasses.replace(scene, turning=ppl.observed_turning(track, scene.radius))
    else:
        _check_start(scene, track)
    event = ppl.Event(scene, ppl.Observation(track), id=film.path.stem)
    return VideoReading(event, confidence, pictures)


def _scene_or_layout(
    scene: ppl.Scene | None, layout: str | ppl.World | None
) -> tuple[ppl.Scene, ppl.World]:
    """Return the scene, and the world; the scene of a layout has no places of bodies yet.

    User-defined goals may be about rooms, which are unknown before walls are found. So a
    layout's scene has none of these goals.
    """
    if (scene is None) == (layout is None):
        raise ppl.errors.InvalidSettingError(
            "give either the scene= that the film shows, or its layout="
        )
    if scene is not None:
        ppl.errors.instance_of("scene", scene, ppl.Scene, "a phase_ppl.Scene")
        return scene, scene.world
    if isinstance(layout, str):
        known = {name.lower(): world for name, world in ppl.worlds.available().items()}
        if layout.lower() not in known:
            raise ppl.errors.unknown_name("layout", layout, ppl.worlds.available())
        layout = known[layout.lower()]
    ppl.errors.instance_of("layout", layout, ppl.World, "a phase_ppl.World or the name of one")
    assert isinstance(layout, ppl.World)
    x0, x1, y0, y1 = layout.arena
    start = np.tile([(x0 + x1) / 2, (y0 + y1) / 2, 0.0], (len(layout.entities), 1))
    size = min(x1 - x0, y1 - y0) / 16
    radius, plain = np.full(len(start), size), dataclasses.replace(layout, predicates=())
    return ppl.Scene(start, radius, [], world=plain), layout  # type: ignore[arg-type]


def _film_frame_of(film: FilmFile, frames_per_step: float | None, start: float) -> FloatArray:
    """Return (time,) the number, perhaps fractional, of the film's frame for each event frame."""
    name = film.path.name
    if frames_per_step is None:
        if not film.fps > 0:
            raise ppl.errors.InvalidEventError(
                f"{name} does not say how fast it is: give frames_per_step="
            )
        frames_per_step = film.fps * ppl.SHOWN_SECONDS_PER_FRAME
        if frames_per_step < 1:
            raise ppl.errors.InvalidEventError(
                f"{name} has {film.fps:g} frames per second, at least "
                f"{1 / ppl.SHOWN_SECONDS_PER_FRAME:g} were expected: give frames_per_step="
            )
    if start and not film.fps > 0:
        raise ppl.errors.InvalidEventError(
            f"{name} does not say how fast it is: start= cannot be found"
        )
    first = round(start * film.fps)
    steps = (film.n_frames - 1 - first) / frames_per_step
    if steps < _MIN_FRAMES - 1:
        raise ppl.errors.InvalidEventError(
            f"{name} has {film.n_frames} frames, {film.fps:g} a second: with start={start:g} and "
            f"frames_per_step={frames_per_step:g} fewer than {_MIN_FRAMES} frames of an event"
        )
    return np.asarray(first + np.arange(math.floor(steps + 1e-6) + 1) * float(frames_per_step))


def _sizes(bodies: Bodies, samples: Sequence[Pixels], colours: Colours) -> FloatArray:
    """Return (entity,) sizes, units, with which bodies explain the samples best."""
    labels = [colours.labels(frame) for frame in samples]
    n = len(bodies.painter.scene.world.entities)
    pixels = np.array([[(one == entity).sum() for entity in range(n)] for one in labels])
    areas = np.array([bodies.area(entity) for entity in range(n)])
    # from frames in which a body has most pixels, as it is covered at times
    radius = np.sqrt(np.quantile(pixels, 0.8, axis=0) / areas) / bodies.painter.scale
    found = [bodies.find(frame, None, radius) for frame in samples]
    for again in range(_ROUNDS):
        if again:
            found = [bodies.find(*pair, radius) for pair in zip(samples, found, strict=True)]
        for entity in range(n):
            sure = np.nan_to_num([one[entity, 3] for one in found])
            best = [i for i in np.argsort(-sure)[:_SIZED_IN] if sure[i] >= SEEN]
            if best:
                radius[entity] = np.median(
                    [bodies.size(samples[i], found[i], radius, entity) for i in best]
                )
    return np.asarray(radius)


def _followed(
    film: FilmFile,
    view: View,
    bodies: Bodies,
    radius: FloatArray,
    moments: FloatArray,
    progress: bool | None,
) -> tuple[FloatArray, dict[int, Image.Image]]:
    """Return (time, entity, 4) poses and confidence, and pictures of some frames."""
    first = np.floor(moments + 1e-3).astype(int)  # rates are rounded
    weight = np.where(moments - first < 1e-3, 0.0, moments - first)
    wanted = {*first.tolist(), *(first[weight > 0] + 1).tolist()}
    shown_at = np.linspace(0, len(moments) - 1, min(_PANELS, len(moments))).round().astype(int)
    kept = {int(first[step]): int(step) for step in shown_at}
    poses: dict[int, FloatArray] = {}
    pictures: dict[int, Image.Image] = {}
    before: FloatArray | None = None
    frames = ppl.counted(film.frames(wanted), progress, "frame", film.path.name, len(wanted))
    for number, frame in frames:
        picture = view(frame)
        if number in kept:
            pictures[kept[number]] = Image.fromarray(picture)
        found = bodies.find(picture, before, radius)
        seen = found[:, 3] >= SEEN
        poses[number] = np.where(seen[:, None], found, np.nan)
        last = np.full((len(found), 3), np.nan) if before is None else before
        before = np.where(seen[:, None], found[:, :3], last)
    rows = []
    for at, part in zip(first.tolist(), weight.tolist(), strict=True):
        pose = poses[at].copy()
        if part:
            step = poses[at + 1] - pose
            step[:, 2] = (step[:, 2] + np.pi) % (2 * np.pi) - np.pi  # the shorter way
            pose[:, :3] += part * step[:, :3]
            pose[:, 3] = np.minimum(pose[:, 3], poses[at + 1][:, 3])
        rows.append(pose)
    return np.array(rows), pictures


def _gaps_filled(
    found: FloatArray, scene: ppl.Scene, seconds: FloatArray, max_gap: int, known: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return (time, entity, 3) poses with gaps filled, and the confidence.

    ``found`` is (time, entity, 4), NaN if a body is lost, at (time,) ``seconds`` of the film. Its
    first frame, (entity, 3), may be known.
    """
    world = scene.world
    track, confidence = found[..., :3].copy(), np.nan_to_num(found[..., 3])
    times = np.arange(len(track))
    for entity, name in enumerate(world.entities):
        lost = np.isnan(track[:, entity, 0])
        edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
        for begin, end in edges.reshape(-1, 2).tolist():
            if end - begin > max_gap:
                raise ppl.errors.InvalidEventError(
                    f"the {name} is not found in frames {begin} to {end - 1}, "
                    f"{seconds[begin]:.2f} to {seconds[end - 1]:.2f} s of the film; gaps of up to "
                    f"max_gap={max_gap} frames are bridged"
                )
        if lost.mean() > _MOST_LOST:
            raise ppl.errors.InvalidEventError(
                f"the {name} is not found in {lost.sum()} of {len(lost)} frames, in gaps; at most "
                f"{_MOST_LOST:.0%} are bridged"
            )
        if lost[0]:
            first = known[entity] if known is not None else _hidden_at_start(found, scene, entity)
            if first is not None:
                track[0, entity], lost[0] = first, False
        if entity >= len(world.agents):
            track[:, entity, 2] = 0.0 if known is None else known[entity, 2]
        turned = np.unwrap(track[~lost, entity, 2])
        if known is not None:  # among angles that look alike, take the scene's
            turned += 2 * np.pi * round((known[entity, 2] - turned[0]) / (2 * np.pi))
        track[~lost, entity, 2] = turned
        for coord in range(3):
            seen = track[~lost, entity, coord]
            track[:, entity, coord] = np.interp(times, times[~lost], seen)
    return track, confidence


def _hidden_at_start(found: FloatArray, scene: ppl.Scene, entity: int) -> FloatArray | None:
    """Return the place of a body that is hidden at first: below the one from which it appears."""
    n_agents = len(scene.world.agents)
    first = int(np.isfinite(found[:, entity, 0]).argmax())
    above = [a for a in range(n_agents) if a > entity or entity >= n_agents]
    apart = np.linalg.norm(found[0, above, :2] - found[first, entity, :2], axis=1)
    reach = REACH * (scene.radius[above] + scene.radius[entity])
    if not (apart < reach).any():
        return None
    nearest = above[int(np.where(apart < reach, apart, np.inf).argmin())]
    return np.append(found[0, nearest, :2], found[first, entity, 2])


def _check_start(scene: ppl.Scene, track: FloatArray) -> None:
    """Raise InvalidEventError unless the film begins as its scene does."""
    off = np.linalg.norm(track[0, :, :2] - scene.start[:, :2], axis=1)
    worst = int(off.argmax())
    if off[worst] > _OTHER_START:
        x, y = track[0, worst, :2]
        raise ppl.errors.InvalidEventError(
            f"the {scene.world.entities[worst]} starts at {scene.start[worst, :2].tolist()} in the "
            f"scene, but at [{x:.2f}, {y:.2f}] in the film: it is of another scene, or start= is "
            "not when the event begins"
        )
