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
    """Poses, velocities and holds of all entities at one moment.

    Attributes:
        pose: (entity, 3) x, y of each body's origin [units], angle [rad].
        velocity: (entity, 2) velocity of each centre of mass, units per simulated second.
        spin: (entity,) angular velocity, rad per simulated second.
        held: (agent,) index of the entity that each agent holds; -1: nothing.
        weld: (agent, 3) place of the held item: x, y of its centre relative to the agent's centre
            of mass, in the agent's frame [units], and its angle relative to the agent [rad].
    """

    pose: NDArray[np.float64]
    velocity: NDArray[np.float64]
    spin: NDArray[np.float64]
    held: NDArray[np.int64]
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
"""Seconds that a film takes for a frame. A frame is 1/12 simulated second: a third of its speed."""

MIN_FRAMES: Final = 2


def frame_shown(seconds: float) -> int:
    """Return the last frame, from 0, that the film has shown after so many of its seconds."""
    return math.floor(seconds / SHOWN_SECONDS_PER_FRAME + 1e-6)


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Observed trajectories of all entities of a world.

    Attributes:
        trajectory: (time, entity, coord) with coord = x, y [units], angle [rad, unwrapped]; angle 0
            looks up, and angles grow counter-clockwise. Entities are in the order of
            ``world.entities``. Frame 0 is the start. Frame k is the mean
            over the five substeps of planner step k, which takes a twelfth of a simulated second.
            :meth:`at_rate` and :meth:`at_times` convert frames at other rates. NaN means that a
            body was not seen in a frame (all its three numbers are NaN), or that its angle was not.
        said: how the trajectory was made from tracks, in words; "" if nothing was done to them.

    Raises:
        InvalidEventError: the trajectory has fewer than 2 frames, a wrong shape, an infinite value,
            or a NaN in x or y of a body whose other numbers are known.
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
        """Return the observation made of frames at any rate, such as a tracker's or a game's.

        At 12 frames a second the frames are taken as they are. At any other rate bodies are taken
        to move straight between given frames, and a frame of the observation is the mean of five
        points of this motion, 1/60 s apart. At 60 frames a second these are five given frames.

        Args:
            trajectory: (time, entity, coord) x, y [units], angle [rad]; frame 0 is the start.
            fps: number of given frames per simulated second.

        Raises:
            InvalidEventError: the class refuses the trajectory, or the frames last less than a
                twelfth of a second.
            InvalidSettingError: ``fps`` is no positive number.
        """
        rate = positive_number("fps", fps)
        given = finite_array("trajectory", trajectory, (None, None, 3), unseen=True)
        if rate == FRAMES_PER_SECOND:
            return cls(given)
        return cls.at_times(given, np.arange(len(given)) / rate, gap=1 / rate)

    @classmethod
    def at_times(cls, trajectory: ArrayLike, times: ArrayLike, gap: float = GAP) -> Observation:
        """Return the observation made of frames with time stamps, as sensors give them.

        The first frame is the start. Every later frame of the observation is the mean over the
        twelfth of a second before it. Bodies are taken to move straight between two time stamps. A
        body counts as unseen between two time stamps if these are more than ``gap`` apart, or if it
        was not seen at one of the two.

        Args:
            trajectory: (time, entity, coord) x, y [units], angle [rad]; NaN: not seen.
            times: (time,) time stamp of each frame, simulated seconds, ascending.
            gap: longest time between two time stamps that is bridged, seconds. Default: 0.25.

        Raises:
            InvalidEventError: the class refuses the trajectory; or times do not ascend, two of them
                are more than an hour apart, or their number is not that of the frames.
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
        """Return the observation made of another program's tracks.

        Its attribute ``said`` lists what was done to the tracks. If a track has several points,
        such as the parts that a pose tracker marks, the body is at their mean.

        Args:
            tracks: a pandas table, or an array (time, entity, [x, y] or [x, y, angle]) in the order
                of ``world.entities``. A long table has columns track (or id), frame or time, x, y
                and perhaps angle. A wide table has x and y of each track, such as ``red_x`` or
                ``x1``, or columns with levels. Column names of TrackMate, idtracker.ai, DeepLabCut
                and SLEAP are recognised. Angles are radians, counter-clockwise on the screen; 0
                looks up.
            world: the world of the tracks; each of its entities must have a track.
            names: name of a track -> name of its entity; by default the two names are equal.
            fps: number of tracked frames per simulated second; not needed if tracks have times.
            units: world units per unit of the tracks, such as per pixel.
            y_down: whether the tracks' y grows downwards, as in pictures.
            origin: (x, y) in the world, units, of the tracks' point (0, 0). By default (0, 0), or
                the arena's upper left corner if y grows downwards.
            gap: longest gap in a track that is filled linearly, seconds; 0: none. In longer gaps
                the body counts as unseen. Default: 0.25.
            angles: angles of agents whose tracks have none: "unseen", or "heading", the direction
                of motion. Agents can move in any direction without turning, so a heading often
                jumps faster than an agent can turn, and no action explains it. With "unseen" the
                first frame gets the heading as a placeholder, which inference ignores.
            ahead: names of two parts that a pose tracker marks on each body, such as (tail, head).
                The line from the first to the second gives the body's angle.
            least_sure: points whose confidence is below this count as not seen. Confidences are the
                other program's, in a column "likelihood", "score" or "confidence". Default: 0.6.

        Raises:
            InvalidEventError: the table lacks a needed column, or the class refuses the trajectory.
            InvalidSettingError, UnknownNameError: a value cannot be used, or tracks and entities do
                not match.
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
        """(entity, 3) x, y [units], angle [rad], each as first seen; NaN if never seen."""
        first = (~np.isnan(self.trajectory)).argmax(axis=0)
        return np.take_along_axis(self.trajectory, first[None], axis=0)[0]

    @property
    def has_gaps(self) -> bool:
        """Whether some body or angle was not seen in some frame."""
        return bool(np.isnan(self.trajectory).any())

    def filled(self) -> Observation:
        """Return the observation with all gaps filled.

        Within a gap, the body or angle changes linearly. Before it is first seen and after it is
        last seen, it stays as it was then.

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
        """Return this observation, or raise an error if it has gaps.

        Args:
            what: what needs an observation without gaps, for the error's message.

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
        """Number of frames, the start included."""
        return len(self.trajectory)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Positions (x, y) of all bodies, (time, entity, 2), units."""
        return self.trajectory[..., :2]

    @property
    def angles(self) -> NDArray[np.float64]:
        """Angles of all bodies, (time, entity), rad."""
        return self.trajectory[..., 2]

    def until(self, seconds: float) -> Observation:
        """Return the frames that the film shows until ``seconds``, at least two, as an observation.

        In the package's films the pictures between two frames are interpolated from both. They do
        not count as having shown the second.

        Args:
            seconds: time since the film began, seconds of the film (0.25 per frame).
        """
        shown = max(frame_shown(seconds) + 1, MIN_FRAMES)
        return Observation(self.trajectory[:shown], self.said)

    @property
    def duration(self) -> str:
        """Number of frames and duration [simulated s], in words."""
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
            several = f"{gone.sum()} of {gone.size} positions missing"
            bodies += f"; body {who[0]} unseen in {n} frames" if len(who) == 1 else f"; {several}"
        return f"<observation: {'; '.join(filter(None, (self.duration, bodies, self.said)))}>"


@dataclasses.dataclass(frozen=True, eq=False)
class Thoughts:
    """What all simulated agents thought. Step k is decided at frame k and leads to frame k + 1.

    Attributes:
        subgoals: (step, agent) the subgoal of each agent, a ``phase_ppl.goals.Literal``.
        actions: (step, agent) the action of each agent, a number of ``phase_ppl.Action``.
        agreeing: (step, agent) share of the agent's belief particles that have its subgoal.
        seen: (step, agent, entity) whether the agent observed the entity.
        held: (step, agent) index of the entity that the agent held; -1: nothing.
        particles: (step, agent, particle, entity, [x, y, angle]) belief particles, units and rad.
    """

    subgoals: tuple[tuple[Literal, Literal], ...]
    actions: IntArray
    agreeing: FloatArray
    seen: BoolArray
    held: IntArray
    particles: FloatArray


@dataclasses.dataclass(frozen=True)
class Truth:
    """What generated an event of PHASE: effective goals, relation and, if known, strengths.

    Attributes:
        goal_red, goal_green: effective goal of the red and the green agent, one of ``GOALS``.
        relation: "friendly", "neutral" or "adversarial"; by default it follows from the goals.
        scenario: "collaborative", "independent", "competing" or "opposing"; by default it follows
            from the goals.
        strength_red, strength_green: maximum force of the agent, newtons; None: unknown.

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
        """Strength of each agent, (agent,), newtons; None: unknown."""
        return self.strength_red, self.strength_green

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as in event files.

        Keys are ``goals`` and ``strengths``, both by name of agent, ``relation`` and ``scenario``.
        """
        forces = dict(zip(AGENTS, self.strengths, strict=True))
        told = {"relation": self.relation, "scenario": self.scenario}
        return {"goals": self.goals, **told, "strengths": forces}

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> Truth | Hypothesis:
        """Return the truth of an event that was generated under ``hypothesis``.

        In PHASE it is a ``Truth`` with the hypothesis's effective goals and strengths. In another
        world it is the hypothesis itself.
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
        observation: trajectories of all entities.
        id: name of the event; inference ignores it.
        truth: what generated the event: a ``Truth`` in PHASE, a ``Hypothesis`` in another world;
            None: unknown.
        judgments: people's answers about the event, as its file has them.
            ``phase_ppl.Judgments.of(event)`` reads them.
        predictions: other models' predictions, as the event's file has them: name of a model ->
            prediction. ``phase_ppl.reference_predictions([event])`` reads them.
        thoughts: what the agents of an event from :func:`phase_ppl.simulate` thought; None for
            other events. Files do not keep it.

    Raises:
        InvalidEventError: the trajectory leaves the arena, or has another number of entities than
            the world.
        InvalidSettingError: ``scene``, ``observation`` or ``truth`` is of the wrong class.
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
