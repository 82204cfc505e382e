"""The hidden part of the state, filtered from what is seen: velocities, holds and strengths.

A beam of full states goes along with the video, some for every combination of strengths that is
followed. At each frame every joint action is tried from each of them; the states after those that
explain the frame best go on, corrected by what was seen. Frames are compared like with like: means
over the substeps of a step.

Some combinations of strengths are followed: all of two agents; of three and more as many, in which
every agent has every strength equally often, and so has every pair of the first two or three. Each
has a filter of its own, and its evidence is the product over the frames of how probable that filter
found them, so that none is lost by being dropped from the beam.

A body may be unseen. It goes on as physics moves it, and an agent as its policies say: then states
are drawn by their probabilities, not the best ones taken, so that they spread as its whereabouts
do. When it is seen again, its place counts as evidence by that spread, and corrects the states.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.constants import WORLD_INNER_STEPS
from phase_ppl.physics.flat import ANGLE, X, Y, to_state
from phase_ppl.simulator.joint import Past
from phase_ppl.world.arrays import GOLDEN, FloatArray, IntArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    nonnegative_number,
    positive_number,
    whole_number,
)
from phase_ppl.world.event import State
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE
from phase_ppl.world.scene import Scene

UNSEEN: Final = 0.05  # units that are assumed before there is anything to estimate the noise from
_MEDIAN: Final = 0.6745  # median of |x| for a standard normal x

_MOST: Final = 0.9
"""Share of a deviation that is taken over where observations are exact: the rest is the means'
lag behind the state at the end of a step."""

_MOST_VELOCITY: Final = 0.5
_ANGLE: Final = 0.9


class NoiseEstimate:
    """The standard deviation of the observed positions, estimated on the way.

    Items lie still most of the time: the median of the absolute second differences of their
    positions is that of the noise alone, however they move in the rest.

    Args:
        known: units; None: to be estimated.
        start: (entity, 3) the first frame.
        n_agents: of the entities, so many are agents.

    Attributes:
        now: the estimate from the frames so far, units; before there are three, ``UNSEEN``. A
            frame is to be scored with the one from the frames before it.
    """

    def __init__(self, known: float | None, start: FloatArray, n_agents: int) -> None:
        self._known = known
        self._items = slice(n_agents if len(start) > n_agents else 0, None)  # agents if need be
        self._last: list[FloatArray] = [start[self._items, :2]]
        self._differences: list[float] = []
        self.now = UNSEEN if known is None else known

    def update(self, observed: FloatArray) -> None:
        """Take in a frame, (entity, 3), NaN where unseen."""
        if self._known is not None:
            return
        self._last = [*self._last[-2:], observed[self._items, :2]]
        if len(self._last) == 3:
            before, between, now = self._last
            found = np.abs(now - 2 * between + before)
            self._differences += found[~np.isnan(found)].tolist()
        if self._differences:
            self.now = float(np.median(self._differences)) / (_MEDIAN * math.sqrt(6))


def filter_gains(drift: float, noise: float) -> FloatArray:
    """Return the shares of a deviation by which position, velocity and angle are corrected.

    Those of the stationary alpha-beta filter of a position that drifts by ``drift`` units a step
    and is observed with ``noise`` units, at most 0.9 and 0.5; angles are taken as seen.
    """
    if noise <= 0:
        return np.array([_MOST, _MOST_VELOCITY, _ANGLE])
    ratio = (drift / noise) ** 2
    alpha = min(_MOST, (math.sqrt(ratio * ratio + 4 * ratio) - ratio) / 2)
    beta = min(_MOST_VELOCITY, alpha * alpha / (2 - alpha))
    return np.array([alpha, beta, _ANGLE])


_ALIKE: Final = 4
"""States of the beam that agree on holds and strengths, at most: they differ in velocities."""

_TRIED: Final = 6  # joint actions followed per place in the beam
_LEAST: Final = 20.0  # log weight below the best at which a state is dropped

_PARTS_PER_THREAD: Final = 4
"""Into which the beam is divided: some states take far longer than others."""

_VELOCITY_BIN: Final = 3.0  # states whose velocities differ by less are taken for the same, units/s


@dataclasses.dataclass(frozen=True)
class Tracking:
    """Settings by which the closed loop follows hidden states: velocities, holds, strengths.

    Four settings were chosen on 50 of the authors' test videos. ``scale``, ``angle_scale`` and
    ``tail`` were chosen on ten of them, by agreement with the actions recovered from these videos,
    and confirmed on all 50 (``benchmarks/closed_loop.py replays``). ``strength_weight`` was chosen
    by the log score of the strengths of one half of the 50 (``--half first``), with and without
    noise on positions (``benchmarks/closed_loop.py beam``).

    ``strength_weight`` is far below 1, because a beam (the states kept) has few of the many
    histories that frames cannot tell apart. So the evidence for the agents' strengths is far too
    noisy, even on videos drawn from the model itself. The exponent makes up for that.

    Attributes:
        strengths: forces that each agent may have, newtons, ascending, from 150 to 600.
        states: number of states kept, in addition to the best one of each combination of strengths.
        strength_weight: exponent of each frame's density as evidence for strengths. Below 1 this
            evidence is tempered.
        scale: scale of the density of an entity's distance from where the agents' true actions
            would have put it, units. ``noise`` is added to it, as the root of the sum of squares.
        angle_scale: scale of the density of the difference between an agent's angle and the one
            that the action tried would give, rad.
        tail: degrees of freedom of Student's t, the form of both densities.
        noise: standard deviation of the noise on observed positions, units. None: estimated from
            the frames so far.

    Raises:
        InvalidSettingError: a value cannot be used.
    """

    strengths: tuple[float, ...] = STRENGTH_LEVELS
    states: int = 24
    strength_weight: float = 0.05
    scale: float = 0.06
    angle_scale: float = 0.06
    tail: float = 3.0
    noise: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "strengths", tuple(sorted(map(float, self.strengths))))
        low, high = STRENGTH_RANGE
        if not self.strengths or not all(low <= n <= high for n in self.strengths):
            raise InvalidSettingError(
                f"strengths={self.strengths}, expected newtons in [{low:g}, {high:g}]"
            )
        if len(set(self.strengths)) < len(self.strengths):
            raise InvalidSettingError(f"strengths={self.strengths}: a strength is named twice")
        object.__setattr__(self, "states", whole_number("states", self.states))
        for name in ("scale", "angle_scale", "tail", "strength_weight"):
            positive_number(name, getattr(self, name))
        if self.noise is not None:
            nonnegative_number("noise", self.noise)


@dataclasses.dataclass(frozen=True, eq=False)
class Beam:
    """States that the world may be in."""

    bodies: FloatArray  # (B, entity, 9), as in ``physics.flat``, like those below
    held: IntArray  # (B, agent)
    weld: FloatArray  # (B, agent, 3)
    combination: IntArray  # (B,) of strengths, as an index
    within: FloatArray  # (B,) log probabilities given the strengths

    def __len__(self) -> int:
        return len(self.bodies)


class Expected(NamedTuple):
    """Strengths of all agents, and the most probable state given them."""

    strengths: tuple[float, ...]  # (agent,) newtons
    bodies: FloatArray  # (entity, 9), as in ``physics.flat``, like those below
    held: IntArray  # (agent,)
    weld: FloatArray  # (agent, 3)


class HiddenState:
    """The filter, from a scene at rest on; ``threads`` may be at work at a time.

    Attributes:
        beam: states after the last frame.
        combinations: (combination, agent) newtons, those that are followed.
        log_peak: log density that the last frame would have had exactly where an action puts it.
    """

    def __init__(self, scene: Scene, tracking: Tracking, threads: int = 1) -> None:
        self.tracking = tracking
        n_agents, n_bodies = len(scene.world.agents), len(scene.world.entities)
        self._n_agents = n_agents
        self.combinations = balanced(tracking.strengths, n_agents)
        n = len(self.combinations)
        bodies, held, weld = compiled.from_state(State.at_start(scene), scene.radius)
        self.beam = Beam(
            np.repeat(bodies[None], n, axis=0),
            np.repeat(held[None], n, axis=0),
            np.repeat(weld[None], n, axis=0),
            np.arange(n),
            np.zeros(n),
        )
        self._evidence = np.zeros(n)  # log, of each combination of strengths
        # each part of the beam has a work space; its forces are overwritten state by state
        strongest = (max(tracking.strengths),) * n_agents
        self._spaces = [
            (
                compiled.make_params(scene, strongest, inner_steps=WORLD_INNER_STEPS),
                compiled.make_scratch(n_bodies, n_agents),
                inverse.make_trial(n_bodies, n_agents),
            )
            for _ in range(1 if threads == 1 else min(_PARTS_PER_THREAD * threads, n))
        ]
        self._executed = np.array([executed(a, scene.turning) for a in range(N_ACTIONS)])
        self._all_executed = np.ix_(*[self._executed] * n_agents)
        # of joint actions that are executed, where all that are intended are alike
        share = np.zeros((N_ACTIONS,) * n_agents)
        np.add.at(share, self._all_executed, 1.0 / N_ACTIONS**n_agents)
        with np.errstate(divide="ignore"):
            self._log_share = np.log(share.ravel())
        self._noise = NoiseEstimate(tracking.noise, scene.start, n_agents)
        # (entity, [position, angle]) frames since each was seen, and whole turns that an angle may
        # have made meanwhile, rad
        self._unseen = np.zeros((n_bodies, 2), np.int64)
        self._turns = np.zeros(n_bodies)
        self._n_drawn = 0  # frames after which states were drawn
        self.log_peak = 0.0

    def advance(
        self,
        observed: FloatArray,
        share: Callable[..., Iterable[None]] = map,
        policies: Sequence[FloatArray] | None = None,
    ) -> FloatArray:
        """Take in the next frame.

        Args:
            observed: (entity, 3) x, y [units], angle [rad]; NaN where unseen.
            share: as ``map``, from whichever threads; the result does not depend on it.
            policies: (agent) (action,) probabilities of intended actions, by which agents go on
                that are unseen; None: any action is as probable as another.

        Returns:
            (action of the first agent, of the second, ...) log density of what is seen of the
            frame after every combination of intended actions.
        """
        observed = self._continued(observed)
        observed.setflags(write=False)  # like a file's: kernels are compiled for one kind of array
        tracking, beam = self.tracking, self.beam
        scale = float(np.hypot(tracking.scale, self._noise.now))  # from the frames before
        spread = self._spread()
        scatter = inverse.Scatter(
            np.hypot(scale, spread[:, 0]),
            np.hypot(tracking.angle_scale, spread[:, 2]),
            tracking.tail,
        )
        self.log_peak = _log_peak(scatter, scale, tracking.angle_scale, observed, self._n_agents)
        found = np.empty((len(beam), len(self._log_share)))
        strengths = self.combinations[beam.combination]
        bounds = np.linspace(0, len(beam), len(self._spaces) + 1).astype(int)

        def try_part(part: int) -> None:
            rows = slice(bounds[part], bounds[part + 1])
            state = beam.bodies[rows], beam.held[rows], beam.weld[rows]
            inverse.try_all(
                *state, strengths[rows], observed, scatter, *self._spaces[part], found[rows]
            )

        list(share(try_part, range(len(self._spaces))))
        found += beam.within[:, None]
        before = self._log_strengths()
        log_density = np.logaddexp.reduce(found + before[beam.combination][:, None], axis=0)
        self._noise.update(observed)
        # what was unseen is corrected the more the less was known of it
        usual = filter_gains(tracking.scale, self._noise.now)
        noise = np.array([scale, scale, tracking.angle_scale]) ** 2
        gains = usual + (1.0 - usual) * spread**2 / (spread**2 + noise)
        self._go_on(found + self._log_share_of(observed, policies), observed, gains)
        self._unseen = np.where(np.isnan(observed[:, [0, 2]]), self._unseen + 1, 0)
        return np.asarray(log_density.reshape((N_ACTIONS,) * self._n_agents)[self._all_executed])

    def _continued(self, observed: FloatArray) -> FloatArray:
        """Return a frame whose angles go on from those that were believed while they were unseen.

        Whoever gives frames cannot know how many whole turns were made meanwhile.
        """
        again = (self._unseen[:, 1] > 0) & ~np.isnan(observed[:, 2])
        if again.any():
            off = observed[:, 2] - self.best().bodies[:, ANGLE]
            self._turns[again] = 2 * np.pi * np.round(off[again] / (2 * np.pi))
        if self._turns.any():
            return observed - self._turns[:, None] * [0.0, 0.0, 1.0]
        return np.ascontiguousarray(observed).view()

    def _spread(self) -> FloatArray:
        """Return (entity, 3) how sure it still is of x, y [units] and angle [rad] that were unseen.

        Standard deviations over the states, of x and y together; 0 of what the last frame shows.
        """
        found, unseen = np.zeros((len(self._unseen), 3)), self._unseen[:, [0, 0, 1]] > 0
        if unseen.any():
            weight = np.exp(self.beam.within + self._log_strengths()[self.beam.combination])
            pose = self.beam.bodies[..., [X, Y, ANGLE]]
            off = pose - np.tensordot(weight, pose, 1)
            variance = np.tensordot(weight, off**2, 1)
            variance[:, :2] = variance[:, :2].mean(axis=1, keepdims=True)
            found[unseen] = np.sqrt(variance[unseen])
        return found

    def _log_share_of(
        self, observed: FloatArray, policies: Sequence[FloatArray] | None
    ) -> FloatArray:
        """Return (joint action,) log probabilities of executed actions before the frame."""
        unseen = np.asarray(np.isnan(observed[: self._n_agents]).any(axis=1)).tolist()
        if policies is None or not any(unseen):
            return self._log_share
        joint = np.ones(())
        for own, is_unseen in zip(policies, unseen, strict=True):
            intended = own if is_unseen else np.full(N_ACTIONS, 1.0 / N_ACTIONS)
            joint = np.multiply.outer(joint, np.bincount(self._executed, intended, N_ACTIONS))
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(joint.ravel()))

    def strengths(self) -> FloatArray:
        """Return (combination,) probabilities."""
        return np.exp(self._log_strengths())

    def _log_strengths(self) -> FloatArray:
        """Return (combination,) log probabilities."""
        found = self.tracking.strength_weight * self._evidence
        return np.asarray(found - np.logaddexp.reduce(found))

    def best(self) -> Expected:
        """Return the most probable state."""
        row = int((self.beam.within + self._log_strengths()[self.beam.combination]).argmax())
        return self._expected(row)

    def spread(self, n: int) -> list[Expected]:
        """Return ``n`` combinations of strengths that stand for what is believed of them.

        They are quantiles of the probabilities: of the first agent's strength, and of each other's
        given those before, evenly spread over all; one alone is the median.
        """
        masses, found = self.strengths(), []
        levels = np.searchsorted(self.tracking.strengths, self.combinations)
        for place in range(n):
            left = np.arange(len(masses))
            at = place
            for agent in range(self._n_agents):
                by_level: FloatArray = np.bincount(levels[left, agent], masses[left]).astype(float)
                left = left[levels[left, agent] == _quantile(by_level, (at + 0.5) / n)]
                # a permutation, so that the agents' quantiles are not those of equal strengths
                at = (at * _stride(n) + n // 2) % n
            (rows,) = np.nonzero(self.beam.combination == left[0])
            found.append(self._expected(int(rows[self.beam.within[rows].argmax()])))
        return found

    def _expected(self, row: int) -> Expected:
        beam = self.beam
        strengths = tuple(self.combinations[beam.combination[row]].tolist())
        return Expected(strengths, beam.bodies[row], beam.held[row], beam.weld[row])

    def _go_on(self, flat: FloatArray, observed: FloatArray, gains: FloatArray) -> None:
        """Replace the beam by states after the frame; ``flat`` is (B, joint action)."""
        beam, n_combinations = self.beam, len(self.combinations)
        evidence = np.full(n_combinations, -np.inf)
        np.logaddexp.at(evidence, beam.combination, np.logaddexp.reduce(flat, axis=1))
        self._evidence += evidence
        self._evidence -= self._evidence.max()
        flat = flat - evidence[beam.combination][:, None]
        drawn = np.isnan(observed[: self._n_agents, 0]).any()
        chosen, mass = self._drawn(flat) if drawn else self._best(flat)
        parents, joint = np.divmod(chosen, flat.shape[1])
        n = len(chosen)
        bodies = np.empty((n, *beam.bodies.shape[1:]))
        held = np.empty((n, self._n_agents), np.int64)
        weld = np.empty((n, self._n_agents, 3))
        done = np.column_stack(np.unravel_index(joint, (N_ACTIONS,) * self._n_agents))
        inverse.follow(
            beam.bodies, beam.held, beam.weld, self.combinations[beam.combination],
            parents.astype(np.int64), done.astype(np.int64), observed, gains,
            self._unseen[:, 0].copy(), *self._spaces[0], bodies, held, weld,
        )  # fmt: skip
        combination, rows = beam.combination[parents], np.arange(n)
        if not drawn:
            rows, mass = self._merged(bodies, held, combination, mass)
        combination = combination[rows]
        total = np.full(n_combinations, -np.inf)
        np.logaddexp.at(total, combination, mass)
        log_within = mass - total[combination]
        self.beam = Beam(bodies[rows], held[rows], weld[rows], combination, log_within)

    def _best(self, flat: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the most probable places in (B, joint action), and their log masses."""
        beam = self.beam
        # the best of every combination of strengths, then the most probable of all
        highest = flat.max(axis=1)
        order = np.lexsort((-highest, beam.combination))
        every = np.arange(len(self.combinations))
        states = order[np.searchsorted(beam.combination[order], every)]
        first = states * flat.shape[1] + flat[states].argmax(axis=1)
        overall = (flat + self._log_strengths()[beam.combination][:, None]).ravel()
        overall[first] = -np.inf
        n = min(len(overall), _TRIED * self.tracking.states)
        rest = np.argpartition(-overall, n - 1)[:n]
        rest = rest[np.argsort(-overall[rest], kind="stable")]
        rest = rest[overall[rest] > -_LEAST]
        chosen = np.concatenate([first, rest])
        return chosen, flat.ravel()[chosen]

    def _drawn(self, flat: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return places in (B, joint action) drawn by their masses, and their log shares.

        Of every combination of strengths there is one, and more by how probable it is. The draws
        are systematic: evenly spread over the masses, from a beginning that is another for each
        combination and frame.
        """
        of_combination, chosen, shares = self.beam.combination, [], []
        rooms = 1 + (self.tracking.states * self.strengths()).astype(int)
        for combination, room in enumerate(rooms):
            rows = np.flatnonzero(of_combination == combination)
            mass = np.cumsum(np.exp(flat[rows]))
            begin = (self._n_drawn * len(rooms) + combination) * GOLDEN % 1.0
            at = np.searchsorted(mass, mass[-1] * (begin + np.arange(room)) / room, "right")
            kept, times = np.unique(np.minimum(at, len(mass) - 1), return_counts=True)
            row, joint = np.divmod(kept, flat.shape[1])
            chosen.append(rows[row] * flat.shape[1] + joint)
            shares.append(np.log(times / room))
        self._n_drawn += 1
        return np.concatenate(chosen), np.concatenate(shares)

    def _merged(
        self, bodies: FloatArray, held: IntArray, combination: IntArray, weight: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return which states go on, and their log weights; the first stands for all alike."""
        places: dict[tuple[float, ...], int] = {}
        alike: dict[tuple[float, ...], int] = {}
        rows: list[int] = []
        mass: list[float] = []
        room = len(self.combinations) + self.tracking.states
        velocities = np.round(bodies[:, :, 3:5].reshape(len(bodies), -1) / _VELOCITY_BIN)
        for row, (holds, strengths, velocity) in enumerate(
            zip(held.tolist(), combination.tolist(), velocities.tolist(), strict=True)
        ):
            kind = (*holds, strengths)
            key = (*kind, *velocity)
            if (place := places.get(key)) is not None:
                mass[place] = float(np.logaddexp(mass[place], weight[row]))
            elif len(rows) < room and alike.get(kind, 0) < _ALIKE:
                alike[kind] = alike.get(kind, 0) + 1
                places[key] = len(rows)
                rows.append(row)
                mass.append(float(weight[row]))
        return np.array(rows), np.array(mass)


def balanced(levels: Sequence[float], n_agents: int) -> FloatArray:
    """Return (combination, agent) strengths to follow, of one agent or two all there are.

    A third agent's place among the levels is the sum of the first two's, a fourth's the difference:
    any two of the first three have all pairs of levels once, as in a Latin square.
    """
    n = len(levels)
    free = np.array(list(itertools.product(range(n), repeat=min(n_agents, 2))))
    more = [free.sum(axis=1), free[:, 0] - free[:, -1]][: max(0, n_agents - 2)]
    return np.asarray(np.array(levels)[np.column_stack([free, *more]) % n])


def _log_peak(
    scatter: inverse.Scatter,
    scale: float,
    angle_scale: float,
    observed: FloatArray,
    n_agents: int,
) -> float:
    """Return the log density of a frame that is exactly where it was expected.

    The density is that of :func:`phase_ppl.physics.inverse.try_all`; ``scale`` and ``angle_scale``
    are its scales of what was seen before.
    """
    tail, seen = scatter.tail, ~np.isnan(observed)
    angle = math.lgamma(0.5 * (tail + 1)) - math.lgamma(0.5 * tail)
    angle -= 0.5 * math.log(tail * math.pi) + math.log(angle_scale)
    position = -math.log(2 * math.pi) - 2 * math.log(scale)
    turned = seen[:n_agents, 2]
    widened = 2 * np.log(scatter.scale / scale)[seen[:, 0]].sum()
    widened += np.log(scatter.angle_scale / angle_scale)[:n_agents][turned].sum()
    return float(seen[:, 0].sum() * position + turned.sum() * angle - widened)


def _quantile(masses: FloatArray, share: float) -> int:
    """Return the first place up to which lies more than a share of the mass."""
    cumulated = np.cumsum(masses)
    return int(min(np.searchsorted(cumulated, share * cumulated[-1], "right"), len(masses) - 1))


def _stride(n: int) -> int:
    """Return a number without a common factor with ``n``, at about its golden section."""
    return next(k for k in range(max(1, round(0.618 * n)), 2 * n + 2) if math.gcd(k, n) == 1)


def reconstructed(scene: Scene, trajectory: FloatArray, tracking: Tracking | None = None) -> Past:
    """Return the most probable states and actions behind a trajectory, (time, entity, 3).

    Agents that are unseen may do anything.
    """
    hidden = HiddenState(scene, tracking or Tracking())
    states, actions = [State.at_start(scene)], []
    for frame in trajectory[1:]:
        actions.append(most_probable_actions(hidden.advance(frame)))
        best = hidden.best()
        states.append(to_state(best.bodies, best.held, best.weld, scene.radius))
    return Past(states, actions)


def most_probable_actions(log_density: FloatArray) -> tuple[Action, ...]:
    """Return the intended actions under which a frame is most probable, of all agents.

    The log density is that of :meth:`HiddenState.advance`.
    """
    best = np.unravel_index(int(log_density.argmax()), log_density.shape)
    return tuple(Action(int(action)) for action in best)
