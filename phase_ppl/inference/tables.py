"""Bottom-up tables: evidence of each window about goals and strengths (paper, Appendix 4B).

They are computed once per event, in NumPy, in one of three forms.

"learned". Goals are scored by :func:`goal_features`, which include the agent's own actions, and
proposed together with alpha (:func:`joint_logits`). The weights of the features were learned from
simulated events. Strengths are estimated from the whole observation.

"paper", for any world. A window from t1 to t2 proposes a goal in proportion to
exp(-gamma (2 d(t2) - d(t1)) / R), with R the diagonal of the arena, in PHASE 28.28. A goal is
likely if it is nearly achieved at the end (d(t2) small) or came closer (d(t1) - d(t2) large). Who
helps or hinders whom comes from the prior. The paper prints the opposite sign, which contradicts
its text, and no R. ``sign="printed"`` and ``unit="printed"`` keep both.

d is the distance of the goal's own entity. For a goal about an item it is the item's, and for an
agent at a landmark the named agent's. For goals of touching it is the distance between the two. For
a goal to be *away* it is max(0, R - distance), which falls up to the largest distance. A smaller
R would leave many goals at distance 0 that nobody works for.

"closed_loop". The closed loop (:mod:`phase_ppl.closed_loop`) reads the video once, with one set of
searches and the paper's uniform prior. A window proposes goals, and who helps or hinders whom, by
the prior times the likelihood of its frames, each given those before it. The initial hypotheses
come from all frames. Given who helps or hinders whom, agents' goals are proposed independently.
Hastings' ratio corrects for that, so the posterior is still that of simulations. But hypotheses
that the closed loop finds improbable are seldom tried.
"""

from __future__ import annotations

import functools
import importlib.resources
import json
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.strength import ESTIMATORS
from phase_ppl.models.sites import IMPOSSIBLE, SELF_REFERRING
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.goals import N_GOALS, goal_literal
from phase_ppl.world.names import AGENTS, PredicateKind
from phase_ppl.world.scene import PHASE, Scene
from phase_ppl.world.space import HypothesisSpace, space_of

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_table import Table
    from phase_ppl.models.prior_masses import GoalRows

WEIGHTS_FILE: Final = "goal_weights.npz"
"""Weights of the features, (kind, feature): ``window`` and ``whole``."""


def window_length(n_frames: int, window: int) -> int:
    """Return Delta T, the steps from the first to the last frame of a window."""
    return min(window, n_frames - 1)


def window_count(n_frames: int, window: int) -> int:
    """Return the number of windows; window k holds the frames k, ..., k + Delta T."""
    return n_frames - window_length(n_frames, window)


class BottomUpTables(NamedTuple):
    """Proposals of each window; the last entry is for the whole observation."""

    # (window + 1, agent, goal) unnormalised log probabilities of stated goals; or (window + 1,
    # way, agent, goal), given the way: who helps or hinders whom (in PHASE: alpha)
    goal_logits: FloatArray | jax.Array
    # (window + 1, agent) estimate, newtons; NaN where there is none
    strength: FloatArray | jax.Array
    # (window + 1, agent) its standard deviation, newtons; NaN likewise
    strength_sd: FloatArray | jax.Array
    # (window + 1, way) beside the prior's; None: as in the prior
    way_logits: FloatArray | jax.Array | None = None


def padded(tables: BottomUpTables, n_windows: int) -> BottomUpTables:
    """Return the tables padded to ``n_windows`` windows; the last entry is repeated."""

    def longer(table: Any) -> Any:
        beyond = [(0, n_windows + 1 - len(table)), *[(0, 0)] * (np.ndim(table) - 1)]
        return np.pad(np.asarray(table, np.float32), beyond, mode="edge")

    given = {name: table for name, table in tables._asdict().items() if table is not None}
    return tables._replace(**{name: longer(table) for name, table in given.items()})


def bottom_up_tables(
    scene: Scene,
    observation: Observation,
    settings: SimpleSettings,
    progress: bool | None = None,
    threads: int | None = None,
) -> BottomUpTables:
    """Return the tables of an event under some settings.

    Open settings are decided by ``SimpleSettings.settled``. The closed loop takes long:
    ``progress`` shows its bar. It searches in ``threads`` threads, by default one per usable core.
    """
    settings = settings.settled(scene.world)
    assert settings.strength is not None, "it is settled"
    n_frames = observation.n_frames
    length = window_length(n_frames, settings.window)
    starts = np.arange(window_count(n_frames, settings.window))
    first, last = np.append(starts, 0), np.append(starts + length, n_frames - 1)
    windows = np.column_stack([first, last])
    # proposals need not know what was not seen: a straight line is good enough for them
    tracks = observation.filled()
    estimates = ESTIMATORS[settings.strength](scene, tracks, windows)
    if settings.proposal != "paper":
        if settings.proposal == "closed_loop":
            goal, alpha = closed_loop_logits(scene, observation, windows, progress, threads)
        else:
            goal, alpha = joint_logits(_scores(scene, tracks, first, last))
        # strength is the same in all windows: the whole observation estimates it best
        strength_of_all, sd_of_all = (np.broadcast_to(part[-1], part.shape) for part in estimates)
        return BottomUpTables(goal, strength_of_all, sd_of_all, alpha)
    distance = goal_distances(scene, tracks)
    unit = _diagonal(scene) if settings.unit == "arena" else 1.0
    closeness = settings.gamma * (2 * distance[last] - distance[first]) / unit
    logits = closeness if settings.sign == "printed" else -closeness
    impossible = space_of(scene.world).impossible
    return BottomUpTables(np.where(impossible, IMPOSSIBLE, logits), *estimates)


def joint_logits(scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unnormalised log probabilities of stated goals and alpha.

    From scores (..., agent, goal) of effective goals they are (..., alpha, agent, goal) for stated
    goals given alpha, and (..., alpha), to be added to the prior's.
    """
    space = space_of(PHASE)
    goal = np.zeros((*scores.shape[:-2], *space.becomes.shape))
    for way, agent in np.ndindex(space.owner.shape):
        of_agent = scores[..., agent, :]
        goal[..., way, space.owner[way, agent], :] += of_agent[..., space.becomes[way, agent]]
    goal = np.where(SELF_REFERRING, IMPOSSIBLE, goal)
    evidence = np.logaddexp.reduce(goal, axis=-1).sum(axis=-1)
    return goal, evidence - evidence.max(axis=-1, keepdims=True)


def _scores(scene: Scene, observation: Observation, first: IntArray, last: IntArray) -> FloatArray:
    """Return (window + 1, agent, goal) scores; the last stretch is the whole observation."""
    features = goal_features(scene, observation, first, last)
    weights = goal_weights()
    scores = (features * weights["window"][GOALS_ABOUT.kind]).sum(axis=-1)
    scores[-1] = (features[-1] * weights["whole"][GOALS_ABOUT.kind]).sum(axis=-1)
    return scores


@functools.cache
def goal_weights() -> dict[str, FloatArray]:
    """Return the package's own weights, (kind, feature) each."""
    file = importlib.resources.files(__package__) / WEIGHTS_FILE
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
        return {name: stored[name].astype(np.float64) for name in ("window", "whole")}


def _diagonal(scene: Scene) -> float:
    """Return the greatest distance in the arena, units."""
    x0, x1, y0, y1 = scene.arena
    return float(np.hypot(x1 - x0, y1 - y0))


def goal_distances(scene: Scene, observation: Observation) -> FloatArray:
    """Return (time, agent, goal) the distance of each goal from being achieved, units.

    Goals that an agent cannot have, because they name itself, get 0.
    """
    position, world, farthest = observation.positions, scene.world, _diagonal(scene)
    distance = np.empty((len(position), len(world.agents), len(world.goals)))
    for holder, goal in np.ndindex(distance.shape[1:]):
        literal = goal_literal(goal, holder, world)
        near = literal.positive
        if literal.predicate is PredicateKind.USERS:
            own = world.predicates[literal.target]
            apart, near = own.apart(position, scene), own.brings_near is literal.positive
        else:
            on = literal.predicate is PredicateKind.ON
            target = scene.landmark_centres[literal.target] if on else position[:, literal.target]
            apart = np.linalg.norm(position[:, literal.subject] - target, axis=-1)
        distance[:, holder, goal] = apart if near else np.maximum(0.0, farthest - apart)
    return distance


# --- the closed loop's proposals ------------------------------------------------------------------

_LEAST: Final = 1e-12  # least share of the mass with which a goal is proposed
_EVENTS_KEPT: Final = 8


def closed_loop_logits(
    scene: Scene,
    observation: Observation,
    windows: IntArray,
    progress: bool | None = None,
    threads: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return unnormalised log probabilities of stated goals and ways, by the frames of each window.

    ``windows`` are (window, [first, last]) frame numbers. The first array is (window, way, agent,
    goal), for stated goals given the way: who helps or hinders whom. The second is (window, way),
    to be added to the prior's. ``progress`` and ``threads`` as of :func:`bottom_up_tables`.
    """
    table = _read(scene, observation, progress, threads).table
    space, rows = table.space, table.hypotheses
    n = len(space.ways)
    log_prior = rows.log_prior - rows.log_drawn
    least = np.where(np.isfinite(log_prior), _LEAST, 0)
    prior = _sums(rows.way, np.exp(log_prior), n)
    goal = np.empty((len(windows), n, space.n_agents, space.n_goals))
    evidence = np.empty((len(windows), n))
    for place, (first, last) in enumerate(windows.tolist()):
        log_masses = table.log_masses_within(first, last)
        masses = np.exp(log_masses - log_masses.max())
        evidence[place] = _sums(rows.way, np.maximum(masses, least), n) - prior
        for way in range(n):
            goal[place, way] = _goal_logits(space, way, rows, masses)
    return np.where(space.impossible, IMPOSSIBLE, goal), evidence


def _goal_logits(
    space: HypothesisSpace, way: int, rows: GoalRows, masses: FloatArray
) -> FloatArray:
    """Return (agent, goal) log masses of stated goals in one way; uniform without any mass."""
    found = np.zeros((space.n_agents, space.n_goals))
    chosen = rows.way == way
    for agent in np.unique(space.owner[way]):
        shares = np.bincount(rows.stated[chosen, agent], masses[chosen], space.n_goals)
        found[agent] = np.log(np.maximum(shares / max(shares.sum(), 1e-300), _LEAST))
    return found


def _sums(way: IntArray, masses: FloatArray, n: int) -> FloatArray:
    """Return (way,) logs of sums of masses."""
    return np.asarray(np.log(np.maximum(np.bincount(way, masses, n), 1e-300)))


class ReadingCost(NamedTuple):
    """The cost of reading a video before the first simulation."""

    seconds: float = 0.0  # of wall time
    searches: int = 0


class _Read(NamedTuple):
    table: Table
    cost: ReadingCost


def reading_cost(scene: Scene, observation: Observation) -> ReadingCost:
    """Return the cost of the closed loop's reading; zero before it is done."""
    found = _kept.get((scene, observation))
    return ReadingCost() if found is None else found.cost


def _read(
    scene: Scene, observation: Observation, progress: bool | None, threads: int | None
) -> _Read:
    # cached for the same two objects, so that compared kernels share it
    from phase_ppl.analysis.closed_loop_table import table_of
    from phase_ppl.inference.closed_loop import filtered_frames
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood
    from phase_ppl.models.model import Model

    if (known := _kept.get((scene, observation))) is not None:
        return known
    model = Model(likelihood=ClosedLoopLikelihood(planner_seeds=1))
    event = Event(scene, observation)
    found = filtered_frames(event, model, threads=threads, progress=progress)
    cost = json.loads(found.attrs["cost"])
    while len(_kept) >= _EVENTS_KEPT:
        _kept.pop(next(iter(_kept)), None)
    read = _Read(table_of(found), ReadingCost(cost["seconds"], cost["searches"]))
    _kept[scene, observation] = read
    return read


_kept: Final[dict[tuple[Scene, Observation], _Read]] = {}
"""The last few videos that were read."""


# --- features of motion that are evidence for goals -----------------------------------------------

# A goal is about a subject (the agent itself, the other one, an item) and a place: a landmark, or
# the other agent. Features describe the subject's position and approach to the place. They also
# describe the agent's own actions: going to the subject, touching it, moving towards the place.
# They use positions alone, so they hold for any scene, landmark and item.

FEATURES: Final = (
    "constant",
    "distance at the end",
    "distance at the start",
    "achieved at the end",
    "achieved at the start",
    "in the room at the end",
    "in the room at the start",
    "agent's gap to the subject at the end",
    "agent's smallest gap to the subject",
    "share of time touching the subject",
    "progress",
    "agent's way towards the subject",
    "agent's way towards the place",
    "the same, while at the subject",
    "agent's path",
    "progress while touching the subject",
)
"""Features of a goal in a stretch of time; lengths in units of 10, paths in units of 3."""

KINDS: Final = ("item", "not item", "self", "not self", "other", "not other", "touch", "not touch")
"""Kinds of goals: subject and place, and to or away; each kind has its own weights."""

TOUCHING: Final = 0.4
"""Gap below which two bodies count as touching, units; frames are means over a step."""

_TOUCHED: Final = 0.6
"""Gap of the agents below which "get to" counts as achieved at that moment, units."""

_FAR: Final = 10.0
_LENGTH, _WAY = 10.0, 3.0


class _Goals(NamedTuple):
    """Subject and place of the goals; all arrays are (agent, goal)."""

    kind: IntArray  # index into ``KINDS``
    subject: IntArray  # entity
    about_agent: NDArray[np.bool_]  # whether the place is an agent instead of a landmark
    agent: IntArray  # the place; 0 where it is of the other sort
    landmark: IntArray


def _goals() -> _Goals:
    rows = []
    for holder, goal in np.ndindex(len(AGENTS), N_GOALS):
        literal = goal_literal(goal, holder)
        touch = literal.predicate is PredicateKind.TOUCH
        about = "self" if literal.subject == holder else "other"
        about = "item" if literal.subject >= len(AGENTS) else about
        number = KINDS.index("touch" if touch else about) + (not literal.positive)
        place = (literal.target, 0) if touch else (0, literal.target)
        rows.append((number, literal.subject, touch, *place))
    columns = np.array(rows).reshape(len(AGENTS), N_GOALS, -1)
    kind, subject, about_agent, agent, landmark = (columns[..., i] for i in range(5))
    return _Goals(kind, subject, about_agent.astype(bool), agent, landmark)


GOALS_ABOUT: Final = _goals()


def goal_features(
    scene: Scene, observation: Observation, first: IntArray, last: IntArray
) -> FloatArray:
    """Return features (stretch, agent, goal, feature), in the order of ``FEATURES``.

    A stretch goes from its first to its last frame.
    """
    tracks, first, last = _Tracks(scene, observation), np.asarray(first), np.asarray(last)
    columns = [_features_of(tracks, agent, first, last) for agent in range(len(AGENTS))]
    return np.stack(columns, axis=1)


class _Tracks:
    """Quantities computed once for all frames, with sums over time up to each frame."""

    def __init__(self, scene: Scene, observation: Observation) -> None:
        position, places = observation.positions, scene.landmark_centres
        to_place = places[None, None] - position[:, :, None]
        apart = position[:, None] - position[:, :, None]
        self.distance_to_landmark = np.linalg.norm(to_place, axis=-1)
        self.distance_to_entity = np.linalg.norm(apart, axis=-1)
        self.gap = self.distance_to_entity - scene.radius[:, None] - scene.radius
        self.on: NDArray[np.bool_] = np.all(np.abs(to_place) < scene.landmark_half_width, axis=-1)
        self.room = scene.rooms.room_of(position.reshape(-1, 2)).reshape(position.shape[:2])
        self.room_of_landmark = scene.rooms.room_of(places)
        agents = slice(0, len(AGENTS))
        step = np.diff(position[:, agents], axis=0)[:, :, None]
        self.way_to_landmark = _summed((step * _unit(to_place[:-1, agents])).sum(axis=-1))
        self.way_to_entity = _summed((step * _unit(apart[:-1, agents])).sum(axis=-1))
        self.path = _summed(np.linalg.norm(step[:, :, 0], axis=-1))
        self.touching = _summed((self.gap < TOUCHING).astype(float))


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)


def _summed(values: FloatArray) -> FloatArray:
    """Return (time + 1, ...) cumulative sums of the values before each time."""
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])


def _features_of(tracks: _Tracks, agent: int, first: IntArray, last: IntArray) -> FloatArray:
    """Return (stretch, goal, feature) of one agent."""
    _, subject, about_agent, named, landmark = (part[agent] for part in GOALS_ABOUT)
    own = subject == agent

    def of_place(of_agents: NDArray[Any], of_landmarks: NDArray[Any]) -> FloatArray:
        return np.where(about_agent, of_agents, of_landmarks).astype(float)

    distance = of_place(
        tracks.distance_to_entity[:, subject, named],
        tracks.distance_to_landmark[:, subject, landmark],
    )
    achieved = of_place(tracks.gap[:, subject, named] < _TOUCHED, tracks.on[:, subject, landmark])
    in_room = of_place(
        tracks.room[:, subject] == tracks.room[:, named],
        tracks.room[:, subject] == tracks.room_of_landmark[landmark],
    )
    gap = np.minimum(tracks.gap[:, agent, subject], _FAR)
    nearest = np.stack([gap[a : b + 1].min(axis=0) for a, b in zip(first, last, strict=True)])
    touching = tracks.touching[last + 1] - tracks.touching[first]
    share = touching[:, agent, subject] / (last - first + 1)[:, None]
    to_entity = (tracks.way_to_entity[last] - tracks.way_to_entity[first])[:, agent]
    to_landmark = (tracks.way_to_landmark[last] - tracks.way_to_landmark[first])[:, agent]
    to_place = of_place(to_entity[:, named], to_landmark[:, landmark]) / _WAY
    path = (tracks.path[last] - tracks.path[first])[:, agent, None] / _WAY
    progress = (distance[first] - distance[last]) / _WAY
    share = np.where(own, 0.0, share)
    at_subject = ~own & (gap[last] < TOUCHING)
    columns = (
        np.ones_like(progress),
        distance[last] / _LENGTH,
        distance[first] / _LENGTH,
        achieved[last],
        achieved[first],
        in_room[last],
        in_room[first],
        np.where(own, 0.0, gap[last] / _LENGTH),
        np.where(own, 0.0, nearest / _LENGTH),
        share,
        progress,
        np.where(own, 0.0, to_entity[:, subject] / _WAY),
        to_place,
        np.where(at_subject, to_place, 0.0),
        np.broadcast_to(path, progress.shape),
        share * progress,
    )
    return np.stack(columns, axis=-1)
