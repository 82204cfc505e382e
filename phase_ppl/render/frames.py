"""Pictures in the look of the PHASE animations: a frame, a strip of frames, a sheet of events.

PHASE has pictures of 640 x 480 pixels, 20 per unit, on white; other worlds as large as their arena
needs. Landmarks are filled squares, walls black lines 5 pixels wide, items discs. Agents are
trapezoids with two eyes at the short side, their front. y points up.
"""

from __future__ import annotations

import functools
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont, ImageOps

from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, whole_number
from phase_ppl.world.event import FRAMES_PER_SECOND, Event, Observation, Truth
from phase_ppl.world.files import atomic_output
from phase_ppl.world.geometry import UNIT_TRAPEZOID, centre_of_mass, is_agent, rotation, unwrapped
from phase_ppl.world.picture import SCENARIO_COLOURS, Colour, trail_colour
from phase_ppl.world.progress import counted
from phase_ppl.world.scene import Scene

_RAYS: Final = 361
"""Rays at equal angles; others go to both sides of every wall's end and disc's edge."""

_ASIDE: Final = 1e-7  # how far beside an edge its two rays pass, rad


def field_of_view(scene: Scene, poses: FloatArray, agent: int) -> FloatArray:
    """Return the corners (n, 2) of the area that an agent has in view, units; the eye comes first.

    The area can go beyond the arena.

    Args:
        scene: walls and sizes.
        poses: (entity, coord) x, y [units], angle [rad] of all entities.
        agent: index of the agent.
    """
    from phase_ppl.agents.vision import HALF_ANGLE  # imports numba, which is slow

    radius = scene.radius
    centres = np.array(
        [
            centre_of_mass(p[:2], p[2], r, e, len(scene.world.agents))
            for e, (p, r) in enumerate(zip(poses, radius, strict=True))
        ]
    )
    eye = centres[agent]
    others = [entity for entity in range(len(poses)) if entity != agent]
    discs, sizes = centres[others] - eye, radius[others]
    walls = scene.walls - eye

    ahead = poses[agent, 2] + np.pi / 2
    edges = np.concatenate([_directions(walls.reshape(-1, 2)), _disc_edges(discs, sizes)])
    edges = np.concatenate([edges - _ASIDE, edges + _ASIDE]) - ahead
    edges = (edges + np.pi) % (2 * np.pi) - np.pi  # -180..180 degrees from the heading
    turns = np.concatenate([np.linspace(-HALF_ANGLE, HALF_ANGLE, _RAYS), edges])
    turns = np.sort(turns[np.abs(turns) <= HALF_ANGLE])
    rays = np.stack([np.cos(ahead + turns), np.sin(ahead + turns)], axis=1)

    x0, x1, y0, y1 = scene.arena
    beyond = 4 * max(x1 - x0, y1 - y0)
    reach = np.minimum(_to_walls(rays, walls), _to_discs(rays, discs, sizes)).clip(max=beyond)
    return np.concatenate([eye[None], eye + reach[:, None] * rays])


def _directions(points: FloatArray) -> FloatArray:
    return np.arctan2(points[:, 1], points[:, 0])


def _disc_edges(discs: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return directions of rays that touch the discs; inside a disc, square to its centre."""
    distance = np.maximum(np.hypot(discs[:, 0], discs[:, 1]), 1e-9)
    half = np.arcsin(np.minimum(sizes / distance, 1.0))
    return np.concatenate([_directions(discs) - half, _directions(discs) + half])


def _to_walls(rays: FloatArray, walls: FloatArray) -> FloatArray:
    """Return (rays,) the distance along each ray to the first wall, inf if there is none."""
    start, along = walls[:, 0], walls[:, 1] - walls[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = _cross(rays[:, None], along)
        distance = _cross(start, along) / facing
        part = _cross(start, rays[:, None]) / facing
    met = (distance >= 0) & (part >= 0) & (part <= 1)
    return np.where(met, distance, np.inf).min(axis=1, initial=np.inf)


def _to_discs(rays: FloatArray, discs: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return (rays,) the distance along each ray at which the first disc ends sight."""
    along = rays @ discs.T
    aside = np.abs(_cross(rays[:, None], discs))
    return np.where((along > 0) & (aside < sizes), along, np.inf).min(axis=1, initial=np.inf)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


# --- one frame ---------------------------------------------------------------------------------

Pixels = NDArray[np.uint8]
Points = list[tuple[float, float]]

WIDTH: Final = 640
HEIGHT: Final = 480
"""Size of a picture in PHASE."""

ARENA_PIXELS: Final = (800, 400)
"""Largest width and height of the arena: 20 pixels per unit in the original 20 units."""

MARGINS: Final = (120, 40)  # pixels left and right of the arena, and above and below
TRAIL_PIXELS: Final = 3

SIGHT_COLOURS: Final[dict[Colour, Colour]] = {(255, 0, 0): (215, 0, 0), (0, 255, 0): (0, 150, 0)}
"""Colours of fields of view, by agents' colours; others have the colour of their trails."""

SIGHT_OPACITY: Final = 0.16
SIGHT_EDGE_OPACITY: Final = 0.45
"""The edge shows a field of view even on a landmark of its colour."""

SIGHT_EDGE_PIXELS: Final = 1.25

FINE: Final = 8  # subpixels per pixel and axis
_FAINT: Final = 0.7  # how much of the floor shows through faint shapes
_SIGHT_FINE = 4  # subpixels for fields of view, which are large


class Painter:
    """Draws frames of one scene; what does not move is drawn once.

    Args:
        scene: arena, walls, landmarks and sizes.
        fields_of_view: whether to show what all agents can see, or the indices of some agents.
        fine: number of subpixels per pixel and axis, averaged at the end. Fewer are faster, and
            enough for a picture that is made smaller.
        pale: share of white, 0 to 1, in the landmarks' colours, so that more can be seen on them.

    Attributes:
        scene: the scene.
        size: width and height of the pictures, pixels.
        scale: pixels per unit.
        background, wall_colour, eye_colour: (red, green, blue), each from 0 to 255.
        wall_pixels: width of a wall, pixels.
        corners: (4, 2) corners of an agent of size 1, clockwise from the back left, in the agent's
            frame, whose y axis points ahead.
        eyes, eye_radius: (2, 2) centres and the radius of the eyes, in the agent's frame.
    """

    background: ClassVar[Colour] = (255, 255, 255)
    wall_colour: ClassVar[Colour] = (0, 0, 0)
    wall_pixels: ClassVar = 5
    corners: ClassVar = UNIT_TRAPEZOID
    eyes: ClassVar = np.array([[-0.24, 0.62], [0.24, 0.62]])
    eye_colour: ClassVar[Colour] = (0, 0, 0)
    eye_radius: ClassVar = 0.14

    def __init__(
        self,
        scene: Scene,
        fields_of_view: bool | Sequence[int] = False,
        *,
        fine: int = FINE,
        pale: float = 0.0,
    ) -> None:
        self.scene = scene
        n_agents, n = len(scene.world.agents), len(scene.world.entities)
        whose = range(n_agents) if fields_of_view is True else (fields_of_view or ())
        self._looking: Sequence[int] = whose
        self._colours = scene.world.entity_colours
        self._order = (*range(n_agents, n), *range(n_agents))
        self._fine, self._pale = fine, pale
        x0, x1, y0, y1 = scene.arena
        sides = np.array([x1 - x0, y1 - y0])
        self.scale = float((ARENA_PIXELS / sides).min())
        # even, as films need it
        width, height = 2 * np.ceil(self.scale * sides / 2 - 1e-9).astype(int) + 2 * np.array(
            MARGINS
        )
        self.size = int(width), int(height)

    def draw(
        self, poses: ArrayLike, trail: FloatArray | None = None, faint: FloatArray | None = None
    ) -> Image.Image:
        """Return the frame with the entities at ``poses``.

        Args:
            poses: (entity, coord) x, y [units], angle [rad]. A body that was not seen, NaN, is not
                drawn; an agent whose angle was not seen is drawn as a disc.
            trail: (time, entity, coord) earlier poses, drawn as thin lines.
            faint: (entity, coord) further poses, drawn faintly below all else.
        """
        pose = finite_array("poses", poses, (len(self._colours), 3), unseen=True)
        picture = self.floor.copy()
        for agent in self._looking:
            if np.isnan(pose[agent]).any():
                continue
            area = field_of_view(self.scene, pose, agent)
            colour = self._colours[agent]
            self._tint(picture, SIGHT_COLOURS.get(colour, trail_colour(colour)), self.pixel(area))
        if faint is not None:
            for entity in self._order:
                self._draw_entity(picture, entity, faint[entity])
            picture = Image.blend(picture, self.floor, _FAINT)

        def line(draw: ImageDraw.ImageDraw, at: Points) -> None:
            draw.line(at, fill=255, width=TRAIL_PIXELS * self._fine, joint="curve")

        if trail is not None and len(trail) > 1:
            for entity in self._order:
                points = self.pixel(trail[:, entity, :2])
                colour = trail_colour(self._colours[entity])
                for part in _seen_parts(points):
                    _paste(picture, colour, part, line, self._fine, margin=TRAIL_PIXELS)
        for entity in self._order:
            self._draw_entity(picture, entity, pose[entity])
        picture.paste(self.wall_colour, mask=self.walls)
        return picture

    def pixel(self, points: ArrayLike) -> FloatArray:
        """Return the pixel coordinates (column, row from the top), (..., 2), of points in units."""
        offset = (np.asarray(points, float) - self.scene.centre) * self.scale
        # pixel (i, j) covers [i, i + 1) x [j, j + 1): half a pixel more keeps odd lines sharp
        return np.array(self.size) / 2 + 0.5 + offset * np.array([1.0, -1.0])

    def units(self, pixels: ArrayLike) -> FloatArray:
        """Return the points x, y [units], (..., 2), at pixel coordinates (the inverse of pixel)."""
        offset = np.asarray(pixels, float) - np.array(self.size) / 2 - 0.5
        return np.asarray(self.scene.centre + offset / self.scale * np.array([1.0, -1.0]))

    @functools.cached_property
    def floor(self) -> Image.Image:
        """Picture of background and landmarks."""
        picture = Image.new("RGB", self.size, self.background)
        scene = self.scene
        for centre, half, one in zip(
            scene.landmark_centres, scene.half_widths, scene.world.landmarks, strict=True
        ):
            corners = self.pixel(centre + half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]))
            self._polygon(picture, one.colour, corners)
        if self._pale:
            return Image.blend(picture, Image.new("RGB", picture.size, self.background), self._pale)
        return picture

    @functools.cached_property
    def walls(self) -> Image.Image:
        """Mask of the outer and inner walls."""
        mask = Image.new("L", self.size, 0)
        half = self.wall_pixels / 2
        for wall in (*self.scene.border, *self.scene.walls):
            ends = self.pixel(wall)
            # walls run along an axis; where they meet, they overlap, so no corner is open
            low, high = ends.min(axis=0) - half, ends.max(axis=0) + half
            corners = np.array([low, (low[0], high[1]), high, (high[0], low[1])])
            self._polygon(mask, 255, corners)
        return mask

    def _tint(self, picture: Image.Image, colour: Colour, corners: FloatArray) -> None:
        """Lay a translucent colour over the part of an area inside the arena."""

        def paint(draw: ImageDraw.ImageDraw, at: Points) -> None:
            draw.polygon(at, fill=round(255 * SIGHT_OPACITY))
            edge = round(SIGHT_EDGE_PIXELS * _SIGHT_FINE)
            draw.line([*at, at[0]], fill=round(255 * SIGHT_EDGE_OPACITY), width=edge)

        x0, x1, y0, y1 = self.scene.arena
        arena = self.pixel([[x0, y1], [x1, y0]]).astype(int)  # walls cover what this rounds off
        _paste(picture, colour, corners, paint, _SIGHT_FINE, margin=1, within=arena)

    def _draw_entity(self, picture: Image.Image, entity: int, pose: FloatArray) -> None:
        if np.isnan(pose[0]):
            return
        radius, colour = float(self.scene.radius[entity]), self._colours[entity]
        if not is_agent(entity, len(self.scene.world.agents)) or np.isnan(pose[2]):
            self._disc(picture, colour, self.pixel(pose[:2]), radius)
            return
        turn = radius * rotation(pose[2]).T
        self._polygon(picture, colour, self.pixel(pose[:2] + self.corners @ turn))
        for eye in self.pixel(pose[:2] + self.eyes @ turn):
            self._disc(picture, self.eye_colour, eye, self.eye_radius * radius)

    def _polygon(self, picture: Image.Image, colour: Colour | int, corners: FloatArray) -> None:
        _paste(picture, colour, corners, lambda draw, at: draw.polygon(at, fill=255), self._fine)

    def _disc(self, picture: Image.Image, colour: Colour, centre: FloatArray, size: float) -> None:
        box = centre + size * self.scale * np.array([[-1.0, -1.0], [1.0, 1.0]])
        _paste(picture, colour, box, lambda draw, at: draw.ellipse(at, fill=255), self._fine)


def draw_frame(scene: Scene, poses: ArrayLike, fields_of_view: bool = False) -> Pixels:
    """Return a picture of a scene: (height, width, 3) RGB values, 480 x 640 x 3 in PHASE.

    Args:
        scene: arena, walls, landmarks and sizes.
        poses: (entity, coord) x, y [units], angle [rad]; NaN: not seen.
        fields_of_view: whether to show what each agent can see.

    Raises:
        InvalidEventError: the poses have the wrong shape, or are infinite.
    """
    return np.asarray(Painter(scene, fields_of_view).draw(poses), np.uint8)


def _seen_parts(points: FloatArray) -> list[FloatArray]:
    """Return the stretches of two points or more, (n, 2), between points that are NaN."""
    unseen = np.flatnonzero(np.isnan(points[:, 0]))
    parts = np.split(points, np.unique([unseen, unseen + 1]))
    return [part for part in parts if len(part) > 1 and not np.isnan(part).any()]


def _paste(
    picture: Image.Image,
    colour: Colour | int,
    points: FloatArray,
    paint: Callable[[ImageDraw.ImageDraw, Points], None],
    fine: int,
    margin: float = 0.0,
    within: NDArray[np.int64] | None = None,
) -> None:
    """Let ``paint`` draw a shape through ``points``, (n, 2) pixels, and paste it smoothly.

    Only the box around the points, cut to ``within``, is drawn finely and averaged. ``within`` is
    the top left and bottom right pixel of the picture or of a part of it.
    """
    first, last = ((0, 0), picture.size) if within is None else within
    low = np.floor(points.min(axis=0) - margin).clip(first, last).astype(int)
    high = np.ceil(points.max(axis=0) + margin).clip(first, last).astype(int)
    if (low >= high).any():
        return
    mask = Image.new("L", (int(high[0] - low[0]) * fine, int(high[1] - low[1]) * fine), 0)
    # the index of a fine pixel is its corner; its centre lies half a fine pixel further
    at = [(float(x), float(y)) for x, y in (points - low) * fine - 0.5]
    paint(ImageDraw.Draw(mask), at)
    picture.paste(colour, (int(low[0]), int(low[1])), mask.reduce(fine))


# --- frames put beside each other, with words -----------------------------------------------------

PANEL: Final = HEIGHT  # side of a panel in PHASE, pixels: the arena and its margin
_TEXT_COLOUR: Final = (70, 70, 70)


def panel(frame: Image.Image) -> Image.Image:
    """Return the middle of a frame: the arena with an equal margin on all sides."""
    beside = MARGINS[0] - MARGINS[1]
    return frame.crop((beside, 0, frame.width - beside, frame.height))


def side_by_side(panels: list[Image.Image], below: int = 0) -> Image.Image:
    """Return ``panels`` from left to right, with ``below`` blank rows under them."""
    width, height = (max(sizes) for sizes in zip(*(part.size for part in panels), strict=True))
    picture = Image.new("RGB", (width * len(panels), height + below), Painter.background)
    for index, part in enumerate(panels):
        x = index * width + (width - part.width) // 2
        picture.paste(part, (x, (height - part.height) // 2))
    return picture


def write_centred(picture: Image.Image, text: str, x: float, y: float, size: float) -> None:
    """Write ``text`` around the pixel (x, y), ``size`` pixels high."""
    font = ImageFont.load_default(size)
    ImageDraw.Draw(picture).text((x, y), text, fill=_TEXT_COLOUR, font=font, anchor="mm")


Drawable = Event | Observation | ArrayLike
"""Anything with trajectories; all except an event need a scene."""


def scene_and_trajectory(what: Drawable, scene: Scene | None) -> tuple[Scene, FloatArray]:
    """Return the scene, by default the event's own, and the (time, entity, coord) trajectory."""
    if isinstance(what, Event):
        return scene or what.scene, what.observation.trajectory
    if scene is None:
        raise InvalidSettingError("a trajectory alone does not say what to draw: give its scene=")
    given = what.trajectory if isinstance(what, Observation) else what
    trajectory = finite_array("trajectory", given, (None, len(scene.world.entities), 3))
    if len(trajectory) == 0:
        raise InvalidEventError("trajectory has no frames")
    return scene, trajectory


def between_frames(trajectory: FloatArray, frames_per_step: int) -> FloatArray:
    """Return the poses of every drawn frame, on straight lines between the trajectory's frames.

    Angles turn the shorter way. The result has (T - 1) * frames_per_step + 1 frames; NaN beside
    frames in which a body is.
    """
    smooth = np.array(trajectory)
    smooth[..., 2] = unwrapped(smooth[..., 2])
    moments = np.arange((len(smooth) - 1) * frames_per_step + 1) / frames_per_step
    before = np.minimum(moments.astype(int), len(smooth) - 1)
    after = np.minimum(before + 1, len(smooth) - 1)
    weight = (moments - before)[:, None, None]
    between = (1 - weight) * smooth[before] + weight * smooth[after]
    return np.asarray(np.where(weight == 0, smooth[before], between))


# --- stills ---------------------------------------------------------------------------------------

_STRIP_PANEL: Final = 300
_STRIP_CAPTION: Final = 36
_STRIP_TEXT_SIZE: Final = 22


def image(
    what: Drawable,
    frame: int,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write one frame as a PNG, of 640 x 480 pixels in PHASE.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y, angle.
        frame: number of the frame, from 0; -1 is the last one.
        path: the file, ending in ".png".
        scene: walls, landmarks and sizes; required unless ``what`` is an event.
        fields_of_view: whether to show what each agent can see.

    Raises:
        InvalidSettingError: there is no such frame, or a trajectory comes without a scene.
        InvalidEventError: the trajectory has the wrong shape, or no frames.
        OutputError: the file cannot be written.
    """
    scene, trajectory = scene_and_trajectory(what, scene)
    n_frames = len(trajectory)
    if not -n_frames <= frame < n_frames:
        raise InvalidSettingError(f"frame={frame}, expected one of 0..{n_frames - 1}")
    picture = Painter(scene, fields_of_view).draw(trajectory[frame])
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def strip(
    what: Drawable,
    path: str | os.PathLike[str],
    n: int = 6,
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write a film strip as PNG: frames from first to last, evenly spaced.

    Lines show the paths since the picture before. The times below are simulated seconds.

    Args:
        what, scene, fields_of_view: as in :func:`phase_ppl.render.image`.
        path: the file, ending in ".png".
        n: number of frames in the strip.

    Raises:
        InvalidSettingError: there are fewer than ``n`` frames, or a trajectory comes without a
            scene.
        InvalidEventError: the trajectory has the wrong shape, or no frames.
        OutputError: the file cannot be written.
    """
    picture = draw_strip(what, n, scene, fields_of_view)
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def draw_strip(
    what: Drawable, n: int = 6, scene: Scene | None = None, fields_of_view: bool = False
) -> Image.Image:
    """Return the picture that :func:`strip` writes: panels 300 pixels high, 36 rows below."""
    scene, trajectory = scene_and_trajectory(what, scene)
    if not 1 <= n <= len(trajectory):
        raise InvalidSettingError(f"n={n}, expected one of 1..{len(trajectory)}")
    painter = Painter(scene, fields_of_view)
    chosen = np.linspace(0, len(trajectory) - 1, n).round().astype(int)
    panels: list[Image.Image] = []
    for before, frame in zip([0, *chosen[:-1]], chosen, strict=True):
        drawn = painter.draw(trajectory[frame], trail=trajectory[before : frame + 1])
        middle = panel(drawn)
        size = (round(_STRIP_PANEL * middle.width / middle.height), _STRIP_PANEL)
        panels.append(middle.resize(size, Image.Resampling.LANCZOS))
    picture = side_by_side(panels, below=_STRIP_CAPTION)
    for index, frame in enumerate(chosen):
        x, y = (index + 0.5) * size[0], _STRIP_PANEL + _STRIP_CAPTION / 3
        write_centred(picture, f"{frame / FRAMES_PER_SECOND:.1f} s", x, y, _STRIP_TEXT_SIZE)
    return picture


# --- a whole set of events as one picture ---------------------------------------------------------

UNKNOWN_COLOUR: Final[Colour] = (170, 170, 170)  # of events without truth
THUMBNAIL: Final = 192

_GAP: Final = 10
_MARGIN: Final = 18
_LINE: Final = 5
_CAPTION: Final = 25
_TEXT_SIZE: Final = 13
_LEGEND_TEXT_SIZE: Final = (17, 2)
"""Least text size of the legend, pixels, and its growth per column: large sheets look small."""

_CAPTION_COLOUR: Final[Colour] = (60, 60, 60)
_SHEET_FINE: Final = 3
_SHEET_PALE: Final = 0.55
_TRIM: Final = 36
"""Pixels of a panel's margin around the arena that a thumbnail leaves out, of 40."""


def contact_sheet(
    events: Sequence[Event],
    path: str | os.PathLike[str],
    columns: int | None = None,
    *,
    progress: bool | None = None,
) -> Path:
    """Write one picture of many events.

    Each event is shown by its last frame, the paths that led there and, faintly, its start. Below
    are its id and a line in the colour of its scenario. A legend above explains the colours. A
    sheet of 500 events takes some 60 MB while it is drawn.

    Args:
        events: the events, shown in this order, row by row.
        path: the file, ending in ".png".
        columns: number of events per row; by default the sheet is about square.
        progress: whether to show a progress bar; None: if stderr is a terminal.

    Returns:
        Path of the file.

    Raises:
        InvalidEventError: there are no events.
        InvalidSettingError: ``columns`` is no whole number >= 1.
        OutputError: the file cannot be written.
    """
    if not events:
        raise InvalidEventError("there are no events to draw")
    if columns is None:
        columns = math.ceil(math.sqrt(len(events)))
    columns = min(whole_number("columns", columns), len(events))
    with atomic_output(path, (".png",)) as part:
        drawn = counted(events, progress, "event", "contact sheet")
        _sheet(events, drawn, columns).save(part, "PNG")
    return Path(path)


def _sheet(events: Sequence[Event], drawn: Iterator[Event], columns: int) -> Image.Image:
    """Return the sheet; ``drawn`` are the events once more, counted as they are drawn."""
    text_size = max(_LEGEND_TEXT_SIZE[0], _LEGEND_TEXT_SIZE[1] * columns)
    found = Counter(map(_scenario, events))
    colours = {name: colour for name, colour in _COLOURS.items() if found[name]}
    top = _MARGIN + 3 * text_size * len(colours) // 2
    across, down = THUMBNAIL + _GAP, THUMBNAIL + _CAPTION + _GAP
    rows = math.ceil(len(events) / columns)
    size = 2 * _MARGIN - _GAP + columns * across, top + _MARGIN - _GAP + rows * down
    picture = Image.new("RGB", size, Painter.background)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(text_size)
    for line, (name, colour) in enumerate(colours.items()):
        text = f"{found[name]} {name or 'of no known scenario'}"
        draw.text((_MARGIN, _MARGIN + 3 * text_size * line // 2), text, fill=colour, font=font)
    for index, event in enumerate(drawn):
        row, column = divmod(index, columns)
        x, y = _MARGIN + column * across, top + row * down
        picture.paste(thumbnail(event), (x, y))
        _write_caption(draw, event, x, y + THUMBNAIL)
    return picture


def thumbnail(event: Event, side: int = THUMBNAIL) -> Image.Image:
    """Return a small square picture of an event."""
    track = event.observation.trajectory
    painter = Painter(event.scene, fine=_SHEET_FINE, pale=_SHEET_PALE)
    drawn = panel(painter.draw(track[-1], trail=track, faint=track[0]))
    arena = ImageOps.crop(drawn, _TRIM)
    return ImageOps.pad(arena, (side, side), Image.Resampling.LANCZOS, Painter.background)


_COLOURS: Final = {**SCENARIO_COLOURS, "": UNKNOWN_COLOUR}


def _scenario(event: Event) -> str:
    """Return the scenario of an event of PHASE with truth; "" for others."""
    return event.truth.scenario if isinstance(event.truth, Truth) else ""


def _write_caption(draw: ImageDraw.ImageDraw, event: Event, x: int, y: int) -> None:
    """Write a caption below a thumbnail whose lower left corner is (x, y)."""
    font = ImageFont.load_default(_TEXT_SIZE)
    draw.rectangle((x, y, x + THUMBNAIL - 1, y + _LINE - 1), fill=_COLOURS[_scenario(event)])
    text = " ".join(event.id.split())
    while font.getlength(text) > THUMBNAIL:
        text = f"{text[:-4]}..."
    middle = y + (_LINE + _CAPTION) // 2
    draw.text((x, middle), text, fill=_CAPTION_COLOUR, font=font, anchor="lm")
