"""An event: a scene, what was seen in it, and perhaps what is known about it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray, finite_array
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_name,
    instance_of,
    nonnegative_number,
    number_or_nan,
    positive_number,
    shown,
)
from phase_ppl.world.goals import GOALS, goal_index
from phase_ppl.world.hypothesis import (
    RELATIONS,
    SCENARIOS,
    Hypothesis,
    checked_strength,
    relation,
    scenario,
)
from phase_ppl.world.names import AGENTS, NOTHING, Literal
from phase_ppl.world.picture import drawn
from phase_ppl.world.scene import PHASE, Scene, World, check_inside
from phase_ppl.world.tracks import FRAMES_PER_SECOND as FRAMES_PER_SECOND
from phase_ppl.world.tracks import (
    GAP,
    Clock,
    bridged,
    headings,
    in_order,
    read_array,
    read_table,
)


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """Poses, velocities and holds of all entities."""

    pose: NDArray[np.float64]  # (entity, 3) x, y of the body origin [units], angle [rad]
    # (entity, 2) velocity of the centre of mass, units per simulated second
    velocity: NDArray[np.float64]
    spin: NDArray[np.float64]  # (entity,) angular velocity, rad per simulated second
    held: NDArray[np.int64]  # (agent,) entity index of the item each agent holds, or ``NOTHING``
    # (agent, 3) while an agent holds an item: x, y of the item's centre in the agent's frame about
    # its centre of mass [units]; angle of the item relative to the agent [rad]
    weld: NDArray[np.float64]

    @classmethod
    def at_start(cls, scene: Scene) -> State:
        """Return the start state of ``scene``: at rest, holding nothing."""
        n, n_agents = len(scene.world.entities), len(scene.world.agents)
        return cls(
            pose=scene.start.copy(),
            velocity=np.zeros((n, 2)),
            spin=np.zeros(n),
            held=np.full(n_agents, NOTHING, np.int64),
            weld=np.zeros((n_agents, 3)),
        )


# --- what an observer sees: the entities' trajectories, and nothing else --------------------------

SHOWN_SECONDS_PER_FRAME: Final = 0.25
"""Playback time of one frame: three times slower than simulated time."""

MIN_FRAMES: Final = 2


def frame_shown(seconds: float) -> int:
    """Return the last frame, from 0, that the film has shown after so many of its seconds."""
    return math.floor(seconds / SHOWN_SECONDS_PER_FRAME + 1e-6)


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Observed trajectories of all entities of a world.

    Attributes:
        trajectory: (time, entity, coord) with coord = x, y [units], angle [rad, unwrapped].
            Frame 0 is the start. Frame k is the mean over the five substeps of planner step k,
            which takes a twelfth of a second. :meth:`at_rate` and :meth:`at_times` read other
            frames. NaN says that a body was not seen in a frame: all its three numbers, or its
            angle alone.
        said: what was done to tracks to make these, in words; "": nothing.

    Raises:
        InvalidEventError: fewer than 2 frames, a wrong shape, an infinite value, or a body of which
            one coordinate is NaN.
    """

    trajectory: NDArray[np.float64]
    said: str = ""

    if TYPE_CHECKING:  # what it can be made of

        def __init__(self, trajectory: ArrayLike, said: str = "") -> None: ...

    def __post_init__(self) -> None:
        trajectory = finite_array("trajectory", self.trajectory, (None, None, 3), unseen=True)
        if len(trajectory) < MIN_FRAMES:
            raise InvalidEventError(
                f"trajectory has {len(trajectory)} frame(s), expected at least {MIN_FRAMES}"
            )
        object.__setattr__(self, "trajectory", trajectory)

    @classmethod
    def at_rate(cls, trajectory: ArrayLike, fps: float) -> Observation:
        """Return the observation for frames at another rate, such as a tracker's or a game's.

        Bodies move straight between frames. At 60 a second, each frame here is the mean of five.

        Args:
            trajectory: (time, entity, coord) x, y [units], angle [rad]; frame 0 is the start.
            fps: frames per second of simulated time.

        Raises:
            InvalidEventError: as for the class, or the frames last less than a twelfth of a second.
            InvalidSettingError: ``fps`` is no positive number.
        """
        rate = positive_number("fps", fps)
        given = finite_array("trajectory", trajectory, (None, None, 3), unseen=True)
        if rate == FRAMES_PER_SECOND:
            return cls(given)
        return cls.at_times(given, np.arange(len(given)) / rate, gap=1 / rate)

    @classmethod
    def at_times(cls, trajectory: ArrayLike, times: ArrayLike, gap: float = GAP) -> Observation:
        """Return the observation for frames with time stamps, as sensors give them.

        The first frame is the start. After it there is a frame for every twelfth of a second, the
        mean over that time. Bodies move straight between two time stamps. A body is unseen where
        time stamps are more than ``gap`` apart, or where it is not seen at one of them.

        Args:
            trajectory: (time, entity, coord) x, y [units], angle [rad]; NaN: not seen.
            times: (time,) simulated seconds, ascending.
            gap: seconds. Default: 0.25.

        Raises:
            InvalidEventError: as for the class; or times do not ascend, are more than an hour
                apart, or their number is not that of the frames.
            InvalidSettingError: ``gap`` is no positive number.
        """
        given = finite_array("trajectory", trajectory, (None, None, 3), unseen=True)
        stamps = finite_array("times", times, (len(given),))
        clock, frames = Clock(positive_number("gap", gap)), list[FloatArray]()
        for seconds, pose in zip(stamps.tolist(), given, strict=True):
            frames += clock.put(seconds, pose)
        rate = f" ({(len(stamps) - 1) / np.ptp(stamps):.3g} a second)" if len(stamps) > 1 else ""
        return cls(
            np.array(frames) if frames else given,
            f"{len(stamps)} time stamps{rate} put on {FRAMES_PER_SECOND:g} frames a second",
        )

    @classmethod
    def from_tracks(
        cls,
        tracks: Any,
        *,
        world: World = PHASE,
        names: Mapping[Any, str] | None = None,
        fps: float | None = None,
        units: float = 1.0,
        y_down: bool = False,
        origin: tuple[float, float] | None = None,
        gap: float = GAP,
        angles: str = "unseen",
        ahead: tuple[str, str] | None = None,
        least_sure: float = 0.6,
    ) -> Observation:
        """Return the observation for tracks of another program; ``.said`` says what was done.

        If a body has several points, such as the parts that a pose tracker marks, their mean
        counts.

        Args:
            tracks: a pandas table, or an array (time, entity, [x, y] or [x, y, angle]) in the
                world's order of entities. A long table has columns track (or id), frame or time, x,
                y and perhaps angle. A wide table has x and y of each track, such as ``red_x`` or
                ``x1``, or columns with levels. Column names of TrackMate, idtracker.ai, DeepLabCut
                and SLEAP are known. Angles are radians, counter-clockwise on the screen; 0 looks
                up.
            world: the world; each of its entities must have a track.
            names: name of a track -> entity; by default tracks have the names of entities.
            fps: frames per second of simulated time; not needed if there are times.
            units: world units per unit of the tracks, such as per pixel.
            y_down: whether y grows downwards, as in pictures.
            origin: (x, y) of the tracks' origin in the world, units; by default (0, 0), or the
                arena's upper left corner if y grows downwards.
            gap: gaps of up to this many seconds are filled linearly; 0 fills none. Longer gaps
                stay. Default: 0.25.
            angles: angles of agents whose tracks have none: "unseen", or "heading", the direction
                of motion. Agents can move in any direction without turning, so a heading often
                jumps faster than an agent can turn, and no action explains it. With "unseen" the
                first frame gets the heading as a placeholder, which inference ignores.
            ahead: two parts of a body. Their line, from the first to the second, gives the angle.
            least_sure: points below this confidence count as not seen. It is the other program's
                own confidence, in a column "likelihood", "score" or "confidence". Default: 0.6.

        Raises:
            InvalidEventError: the table lacks something, or as for the class.
            InvalidSettingError, UnknownNameError: a value that cannot be used, or tracks and
                entities do not match.
        """
        check_name("angles", angles, ("unseen", "heading"))
        instance_of("world", world, World, "a phase_ppl.World")
        instance_of("names", names, (Mapping, type(None)), "names of tracks -> entities")
        if math.isnan(sure := number_or_nan(least_sure)):
            raise InvalidSettingError(f"least_sure={shown(least_sure)}, expected a number")
        scale, longest = positive_number("units", units), nonnegative_number("gap", gap)
        up, entities = -1.0 if y_down else 1.0, world.entities
        x0, _, _, y1 = world.arena
        offset = ((x0, y1) if y_down else (0.0, 0.0)) if origin is None else origin
        corner = finite_array("origin", offset, (2,), InvalidSettingError)
        if hasattr(tracks, "columns"):
            read = read_table(tracks, fps is not None, sure, ahead, up)
        elif ahead is not None:
            raise InvalidSettingError(f"ahead={shown(ahead)}, but an array has no parts of bodies")
        else:
            read = read_array(tracks, entities, up)
        own = in_order(read, entities, names)
        said = [f"tracks {', '.join(map(str, names))}" if names else "tracks"]
        if left := len(read.names) - len(entities):
            said.append(f"{left} of other bodies left out")
        said += ["y turned up"] * y_down
        said += [f"1 length = {scale:g} units"] * (scale != 1)
        if read.n_doubted:
            said.append(f"{read.n_doubted} points of a certainty below {least_sure:g} left out")
        poses = own.poses.copy()
        poses[..., :2] = corner + scale * poses[..., :2]
        seconds = own.seconds
        if seconds is None:
            if fps is None:
                raise InvalidSettingError(
                    "fps=None and the tracks have no times: say fps=, frames per second of "
                    "simulated time"
                )
            seconds = np.arange(len(poses)) / positive_number("fps", fps)
        poses, n_bridged = bridged(poses, seconds, longest)
        if n_bridged:
            said.append(f"{n_bridged} gaps of up to {longest:g} s put on straight lines")
        if own.seconds is None and fps is not None:
            found = cls.at_rate(poses, fps)
        else:
            said += ["by their own times, not by fps="] * (fps is not None)
            found = cls.at_times(poses, seconds, max(longest, GAP))
        said += [found.said] * bool(found.said)
        track, n_agents = found.trajectory.copy(), len(world.agents)
        items = track[:, n_agents:]
        items[..., 2] = np.where(np.isnan(items[..., 0]), np.nan, np.nan_to_num(items[..., 2]))
        without = [k for k in range(n_agents) if np.isnan(track[:, k, 2]).all()]
        for agent in without:
            heading = headings(track[:, agent, :2])
            frames = slice(None) if angles == "heading" else slice(1)
            track[frames, agent, 2] = heading[frames]
        if without:
            what = "the way they go" if angles == "heading" else "not seen, but at the start"
            said.append(f"angles of {', '.join(entities[k] for k in without)}: {what}")
        return cls(track, "; ".join(said))

    @property
    def start(self) -> NDArray[np.float64]:
        """(entity, 3): x, y [units], angle [rad] where each was seen first; NaN: never."""
        first = (~np.isnan(self.trajectory)).argmax(axis=0)
        return np.take_along_axis(self.trajectory, first[None], axis=0)[0]

    @property
    def has_gaps(self) -> bool:
        """Whether a body or an angle was not seen in some frame."""
        return bool(np.isnan(self.trajectory).any())

    def filled(self) -> Observation:
        """Return the observation with straight lines where a body or an angle was not seen.

        Before it was seen first and after it was seen last it does not move.

        Raises:
            InvalidEventError: a body or an angle was never seen.
        """
        if not self.has_gaps:
            return self
        filled, time = self.trajectory.copy(), np.arange(self.n_frames)
        for place in np.ndindex(filled.shape[1:]):
            track = filled[:, *place]
            seen = ~np.isnan(track)
            if not seen.any():
                what = f"{'angle' if place[1] == 2 else 'body'} {place[0]}"
                raise InvalidEventError(f"{what} was never seen: there is nothing to go by")
            turned = np.unwrap(track[seen]) if place[1] == 2 else track[seen]
            track[~seen] = np.interp(time[~seen], time[seen], turned)
        n = int(np.isnan(self.trajectory).any(axis=2).sum())
        said = f"{n} poses that were not seen put on straight lines"
        return Observation(filled, f"{self.said}; {said}" if self.said else said)

    def whole(self, what: str) -> Observation:
        """Return the observation if all was seen in it, as ``what`` needs it.

        Raises:
            InvalidEventError: a body or an angle was not seen in some frame.
        """
        if self.has_gaps:
            n = int(np.isnan(self.trajectory).any(axis=(1, 2)).sum())
            raise InvalidEventError(
                f"{what} needs to see all bodies, and some were not seen in {n} of "
                f"{self.n_frames} frames: observation.filled() puts them on straight lines"
            )
        return self

    @property
    def n_frames(self) -> int:
        return len(self.trajectory)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(time, entity, 2): x, y, units."""
        return self.trajectory[..., :2]

    @property
    def angles(self) -> NDArray[np.float64]:
        """(time, entity): radians."""
        return self.trajectory[..., 2]

    def until(self, seconds: float) -> Observation:
        """Return what the film has shown after so many of its seconds, at least two frames.

        Frames between two are drawn in the film, but come from both of them.
        """
        shown = max(frame_shown(seconds) + 1, MIN_FRAMES)
        return Observation(self.trajectory[:shown], self.said)

    @property
    def duration(self) -> str:
        """The duration, in words."""
        seconds = (self.n_frames - 1) / FRAMES_PER_SECOND
        return f"{self.n_frames} frames ({seconds:.1f} s of simulated time)"

    def __repr__(self) -> str:
        bodies = f"{self.positions.shape[1]} bodies"
        seen = self.positions[~np.isnan(self.positions[..., 0])]
        if seen.size:
            (x0, y0), (x1, y1) = seen.min(axis=0), seen.max(axis=0)
            bodies += f", x {x0:.1f} to {x1:.1f}, y {y0:.1f} to {y1:.1f}"
        gone = np.isnan(self.positions[..., 0])
        if n := int(gone.any(axis=1).sum()):
            who = np.flatnonzero(gone.any(axis=0)).tolist()
            named = f"body {who[0]}" if len(who) == 1 else f"{len(who)} of them"
            bodies += f"; {named} unseen in {n} frames"
        return f"<observation: {'; '.join(filter(None, (self.duration, bodies, self.said)))}>"


@dataclasses.dataclass(frozen=True, eq=False)
class Thoughts:
    """What all agents thought; step k is decided at frame k and leads to frame k + 1."""

    subgoals: tuple[tuple[Literal, Literal], ...]  # (step, agent) what each was about
    actions: IntArray  # (step, agent) what it did, an index into the names of actions
    # (step, agent) share of its belief particles in which that was the subgoal
    agreeing: FloatArray
    seen: BoolArray  # (step, agent, entity) whether it had the entity in view
    held: IntArray  # (step, agent) the item that it held, or ``NOTHING``
    # (step, agent, particle, entity, [x, y, angle]) its beliefs, units and radians
    particles: FloatArray


@dataclasses.dataclass(frozen=True)
class Truth:
    """What generated an event of PHASE: effective goals and, if known, strengths and relation.

    Attributes:
        goal_red, goal_green: effective goals, paper strings.
        relation, scenario: by default they follow from the goals.
        strength_red, strength_green: newtons, or None.

    Raises:
        UnknownNameError: a goal, relation or scenario is unknown.
        InvalidSettingError: a strength is no positive force.
    """

    goal_red: str
    goal_green: str
    relation: str = ""
    scenario: str = ""
    strength_red: float | None = None
    strength_green: float | None = None

    def __post_init__(self) -> None:
        for name in ("goal_red", "goal_green"):
            object.__setattr__(self, name, GOALS[goal_index(getattr(self, name))])
        if not self.scenario:
            object.__setattr__(self, "scenario", scenario(self.goal_red, self.goal_green))
        if not self.relation:
            object.__setattr__(self, "relation", relation(self.goal_red, self.goal_green))
        check_name("relation", self.relation, RELATIONS)
        check_name("scenario", self.scenario, SCENARIOS)
        for name in ("strength_red", "strength_green"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked_strength(f"truth.{name}", value))

    @property
    def goals(self) -> dict[str, str]:
        """Name of an agent -> its effective goal."""
        return dict(zip(AGENTS, (self.goal_red, self.goal_green), strict=True))

    @property
    def strengths(self) -> tuple[float | None, ...]:
        """(agent,) newtons, or None."""
        return self.strength_red, self.strength_green

    def to_dict(self) -> dict[str, Any]:
        """Return the plain form, as files have it."""
        forces = dict(zip(AGENTS, self.strengths, strict=True))
        told = {"relation": self.relation, "scenario": self.scenario}
        return {"goals": self.goals, **told, "strengths": forces}

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> Truth | Hypothesis:
        """Return the truth of an event that was generated under a hypothesis.

        In PHASE it has effective goals and strengths; in other worlds it is the hypothesis.
        """
        if truth_class(hypothesis.world) is not cls:
            return hypothesis
        red, green = (GOALS[goal] for goal in hypothesis.effective_goals)
        one, other = hypothesis.strengths
        return cls(red, green, strength_red=one, strength_green=other)


def truth_class(world: World) -> type[Truth] | type[Hypothesis]:
    """Return what the truth of a world's events is: in PHASE the effective goals are enough."""
    return Truth if world == PHASE else Hypothesis


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Event:
    """One social event. Inference reads ``scene`` and ``observation`` only.

    Attributes:
        scene: what is known before anybody moves.
        observation: the trajectories.
        id: name of the event; inference ignores it.
        truth: what generated it, if known: a ``Truth`` in PHASE, a ``Hypothesis`` in another world.
        judgments: human judgments, as read from the file.
        predictions: stored predictions of other models, as read from the file.
        thoughts: the agents' thoughts, for freshly simulated events only; not in files.

    Raises:
        InvalidEventError: the trajectory leaves the arena.
    """

    scene: Scene
    observation: Observation
    id: str = "event"
    truth: Any = None
    judgments: Mapping[str, Any] | None = None
    predictions: Mapping[str, Any] | None = None
    thoughts: Thoughts | None = None

    def __post_init__(self) -> None:
        instance_of("scene", self.scene, Scene, "a phase_ppl.Scene")
        instance_of("observation", self.observation, Observation, "a phase_ppl.Observation")
        check_inside(self.observation.trajectory, self.scene, "trajectory")
        kind = truth_class(self.scene.world)
        if self.truth is not None and not isinstance(self.truth, kind):
            raise InvalidSettingError(
                f"truth={shown(self.truth)}, expected a phase_ppl.{kind.__name__} in the world "
                f"{self.scene.world.name}"
            )

    def __repr__(self) -> str:
        return f"<event {self._words()}>"

    def _words(self) -> str:
        words = f"{self.id}: {self.observation.duration}"
        if isinstance(self.truth, Hypothesis):
            words += f"; {self.truth}"
        elif self.truth is not None:
            words += f"; red: {self.truth.goal_red}, green: {self.truth.goal_green}"
            words += f", {self.truth.relation}"
        return words

    def _repr_html_(self) -> str:
        return drawn(self.scene, self.observation.trajectory, self._words())
