"""The hidden part of the state, filtered from what is seen: velocities, holds and strengths.

A beam of full states goes along with the video, some for every pair of strengths. At each frame
every joint action is tried from each of them; the states after those that explain the frame best
go on, corrected by what was seen. Frames are compared like with like: means over the substeps of a
step.

Each pair of strengths has a filter of its own, and its evidence is the product over the frames of
how probable that filter found them, so that none is lost by being dropped from the beam.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.constants import WORLD_INNER_STEPS
from phase_ppl.physics.flat import to_state
from phase_ppl.simulator.joint import Past
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.checks import nonnegative_number, positive_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES
from phase_ppl.world.observation import State
from phase_ppl.world.scene import Scene, check_phase

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
        start: (4, 3) the first frame.

    Attributes:
        now: the estimate from the frames so far, units; before there are three, ``UNSEEN``. A
            frame is to be scored with the one from the frames before it.
    """

    def __init__(self, known: float | None, start: FloatArray) -> None:
        self._known = known
        self._last: list[FloatArray] = [start[BLUE_ITEM:, :2]]
        self._differences: list[FloatArray] = []
        self.now = UNSEEN if known is None else known

    def update(self, observed: FloatArray) -> None:
        """Take in a frame, (4, 3)."""
        if self._known is not None:
            return
        self._last = [*self._last[-2:], observed[BLUE_ITEM:, :2]]
        if len(self._last) == 3:
            before, between, now = self._last
            self._differences.append(np.abs(now - 2 * between + before))
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
    """How the hidden state is followed.

    The scales and the tail were chosen on ten of the real videos, by agreement with the actions
    recovered from them, and confirmed on all 50 (``benchmarks/stepwise.py replays``);
    ``strength_weight`` by the log score of the strengths of the first half of the real videos,
    with and without noise on the positions (``benchmarks/stepwise.py beam``). It is far below 1
    since a beam keeps few of the many histories that frames cannot tell apart: the evidence of a
    pair of strengths then varies by far more than it should, on videos of the model's own too.

    Attributes:
        strengths: newtons that each agent may have, ascending.
        states: places in the beam, beside the best state of every pair of strengths.
        strength_weight: what a frame counts as evidence for strengths; below 1 it is tempered.
        scale: of the distance of an entity from where the right action would have put it, units;
            noise of the observation adds to it.
        angle_scale: likewise of an agent's angle, rad.
        tail: degrees of freedom of both, Student's t.
        noise: standard deviation of the observed positions, units; None: estimated on the way.

    Raises:
        InvalidSettingError: a value that cannot be used.
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
        if isinstance(self.states, bool) or not isinstance(self.states, int) or self.states < 1:
            raise InvalidSettingError(f"states={self.states!r}, expected a whole number >= 1")
        for name in ("scale", "angle_scale", "tail", "strength_weight"):
            positive_number(name, getattr(self, name))
        if self.noise is not None:
            nonnegative_number("noise", self.noise)


@dataclasses.dataclass(frozen=True, eq=False)
class Beam:
    """States that the world may be in."""

    bodies: FloatArray  # (B, entity, 9), as in ``physics.compiled``, like those below
    held: IntArray  # (B, agent)
    weld: FloatArray  # (B, agent, 3)
    pair: IntArray  # (B,) the pair of strengths, as an index
    within: FloatArray  # (B,) log probabilities given the pair of strengths

    def __len__(self) -> int:
        return len(self.bodies)


class Expected(NamedTuple):
    """A pair of strengths, and the most probable state given it."""

    strengths: tuple[float, float]  # of red and green, newtons
    bodies: FloatArray  # (4, 9), (2,), (2, 3), as in ``compiled``
    held: IntArray
    weld: FloatArray


class HiddenState:
    """The filter, at the start of a video.

    Args:
        scene: where everything starts, at rest.
        tracking: its settings.
        threads: that may be at work at a time, see :meth:`advance`.

    Attributes:
        beam: states after the last frame.
        log_peak: log density that the last frame would have had exactly where an action puts it.
    """

    def __init__(self, scene: Scene, tracking: Tracking, threads: int = 1) -> None:
        check_phase(scene, "the closed loop")
        self.tracking = tracking
        self._pairs = np.array(list(itertools.product(tracking.strengths, repeat=len(AGENTS))))
        n = len(self._pairs)
        bodies, held, weld = compiled.from_state(State.at_start(scene), scene.radius)
        self.beam = Beam(
            np.repeat(bodies[None], n, axis=0),
            np.repeat(held[None], n, axis=0),
            np.repeat(weld[None], n, axis=0),
            np.arange(n),
            np.zeros(n),
        )
        self._evidence = np.zeros(n)  # log, of each pair of strengths
        # each part of the beam has a work space; its forces are overwritten state by state
        strongest = (max(tracking.strengths),) * 2
        self._spaces = [
            (
                compiled.make_params(scene, strongest, inner_steps=WORLD_INNER_STEPS),
                compiled.make_scratch(),
                inverse.make_trial(),
            )
            for _ in range(1 if threads == 1 else min(_PARTS_PER_THREAD * threads, n))
        ]
        self._executed = np.array([executed(a, scene.turning) for a in range(N_ACTIONS)])
        intended = np.zeros((N_ACTIONS, N_ACTIONS))
        np.add.at(intended, np.ix_(self._executed, self._executed), 1.0 / N_ACTIONS**2)
        with np.errstate(divide="ignore"):
            self._log_prior = np.log(intended)
        self._noise = NoiseEstimate(tracking.noise, scene.start)
        self.log_peak = 0.0

    def advance(
        self, observed: FloatArray, share: Callable[..., Iterable[None]] = map
    ) -> FloatArray:
        """Take in the next frame.

        Args:
            observed: (4, 3) x, y [units], angle [rad].
            share: as ``map``, from whichever threads; the result does not depend on it.

        Returns:
            (A, A) log density of the frame after every pair of intended actions, red's first.
        """
        tracking, beam = self.tracking, self.beam
        scale = float(np.hypot(tracking.scale, self._noise.now))  # from the frames before
        self.log_peak = _log_peak(scale, tracking.angle_scale, tracking.tail)
        found = np.empty((len(beam), N_ACTIONS, N_ACTIONS))
        strengths = self._pairs[beam.pair]
        bounds = np.linspace(0, len(beam), len(self._spaces) + 1).astype(int)

        def try_part(part: int) -> None:
            rows = slice(bounds[part], bounds[part + 1])
            inverse.try_all(
                *(beam.bodies[rows], beam.held[rows], beam.weld[rows], strengths[rows]),
                *(observed, scale, tracking.angle_scale, tracking.tail),
                *(*self._spaces[part], found[rows]),
            )

        for _ in share(try_part, range(len(self._spaces))):
            pass
        found += beam.within[:, None, None]
        before = self._log_strengths()
        density = np.logaddexp.reduce(found + before[beam.pair][:, None, None], axis=0)
        self._noise.update(observed)
        self._go_on(
            found + self._log_prior, observed, filter_gains(tracking.scale, self._noise.now)
        )
        return np.asarray(density[np.ix_(self._executed, self._executed)])

    def strengths(self) -> FloatArray:
        """Return (strength of red, strength of green) probabilities, by the settings' order."""
        n = len(self.tracking.strengths)
        return np.exp(self._log_strengths()).reshape(n, n)

    def _log_strengths(self) -> FloatArray:
        """Return (pair,) log probabilities of the pairs of strengths."""
        found = self.tracking.strength_weight * self._evidence
        return np.asarray(found - np.logaddexp.reduce(found))

    def best(self) -> Expected:
        """Return the most probable state."""
        row = int((self.beam.within + self._log_strengths()[self.beam.pair]).argmax())
        return self._expected(row)

    def spread(self, n: int) -> list[Expected]:
        """Return ``n`` pairs of strengths that stand for what is believed of them, with states.

        They are quantiles of the probabilities: of red's strength, and of green's given red's,
        evenly spread over both; one alone is the median.
        """
        table = self.strengths()
        found = []
        for place in range(n):
            red = _quantile(table.sum(axis=1), (place + 0.5) / n)
            # a permutation, so that the agents' quantiles are not those of equal strengths
            green = _quantile(table[red], ((place * _stride(n) + n // 2) % n + 0.5) / n)
            (rows,) = np.nonzero(self.beam.pair == red * len(table) + green)
            found.append(self._expected(int(rows[self.beam.within[rows].argmax()])))
        return found

    def _expected(self, row: int) -> Expected:
        beam = self.beam
        red, green = self._pairs[beam.pair[row]].tolist()
        return Expected((red, green), beam.bodies[row], beam.held[row], beam.weld[row])

    def _go_on(self, joint: FloatArray, observed: FloatArray, gains: FloatArray) -> None:
        """Replace the beam by the best states after the frame; ``joint`` is (B, A, A)."""
        beam, n_pairs = self.beam, len(self._pairs)
        flat = joint.reshape(len(beam), -1)
        evidence = np.full(n_pairs, -np.inf)
        np.logaddexp.at(evidence, beam.pair, np.logaddexp.reduce(flat, axis=1))
        self._evidence += evidence
        self._evidence -= self._evidence.max()
        flat = flat - evidence[beam.pair][:, None]
        # the best of every pair of strengths, then the most probable of all
        highest = flat.max(axis=1)
        order = np.lexsort((-highest, beam.pair))
        states = order[np.searchsorted(beam.pair[order], np.arange(n_pairs))]
        first = states * flat.shape[1] + flat[states].argmax(axis=1)
        overall = (flat + self._log_strengths()[beam.pair][:, None]).ravel()
        overall[first] = -np.inf
        n = min(len(overall), _TRIED * self.tracking.states)
        rest = np.argpartition(-overall, n - 1)[:n]
        rest = rest[np.argsort(-overall[rest], kind="stable")]
        rest = rest[overall[rest] > -_LEAST]
        chosen = np.concatenate([first, rest])
        parents, red, green = np.unravel_index(chosen, joint.shape)
        n = len(chosen)
        bodies = np.empty((n, len(ENTITIES), beam.bodies.shape[2]))
        held = np.empty((n, len(AGENTS)), np.int64)
        weld = np.empty((n, len(AGENTS), 3))
        done = np.column_stack([red, green]).astype(np.int64)
        params, scratch, trial = self._spaces[0]
        inverse.follow(
            beam.bodies,
            beam.held,
            beam.weld,
            self._pairs[beam.pair],
            parents.astype(np.int64),
            done,
            observed,
            gains,
            params,
            scratch,
            trial,
            bodies,
            held,
            weld,
        )
        pair = beam.pair[parents]
        rows, mass = self._merged(bodies, held, pair, flat.ravel()[chosen])
        pair = pair[rows]
        total = np.full(n_pairs, -np.inf)
        np.logaddexp.at(total, pair, mass)
        self.beam = Beam(bodies[rows], held[rows], weld[rows], pair, mass - total[pair])

    def _merged(
        self, bodies: FloatArray, held: IntArray, pair: IntArray, weight: FloatArray
    ) -> tuple[list[int], FloatArray]:
        """Return which states go on, and their log weights; the first stands for all alike."""
        places: dict[tuple[float, ...], int] = {}
        alike: dict[tuple[float, ...], int] = {}
        rows: list[int] = []
        mass: list[float] = []
        room = len(self._pairs) + self.tracking.states
        velocities = np.round(bodies[:, :, 3:5].reshape(len(bodies), -1) / _VELOCITY_BIN)
        for row, (holds, strengths, velocity) in enumerate(
            zip(held.tolist(), pair.tolist(), velocities.tolist(), strict=True)
        ):
            kind = (*holds, strengths)
            key = (*kind, *velocity)
            place = places.get(key)
            if place is not None:
                mass[place] = float(np.logaddexp(mass[place], weight[row]))
            elif len(rows) < room and alike.get(kind, 0) < _ALIKE:
                alike[kind] = alike.get(kind, 0) + 1
                places[key] = len(rows)
                rows.append(row)
                mass.append(float(weight[row]))
        return rows, np.array(mass)


def _log_peak(scale: float, angle_scale: float, tail: float) -> float:
    """Return the log density of a frame that is exactly where it was expected.

    The density is that of :func:`phase_ppl.physics.inverse.try_all`.
    """
    angle = math.lgamma(0.5 * (tail + 1)) - math.lgamma(0.5 * tail)
    angle -= 0.5 * math.log(tail * math.pi) + math.log(angle_scale)
    position = -math.log(2 * math.pi) - 2 * math.log(scale)
    return len(ENTITIES) * position + len(AGENTS) * angle


def _quantile(masses: FloatArray, share: float) -> int:
    """Return the first place up to which lies more than a share of the mass."""
    cumulated = np.cumsum(masses)
    return int(min(np.searchsorted(cumulated, share * cumulated[-1], "right"), len(masses) - 1))


def _stride(n: int) -> int:
    """Return a number without a common factor with ``n``, at about its golden section."""
    return next(k for k in range(max(1, round(0.618 * n)), 2 * n + 2) if math.gcd(k, n) == 1)


def reconstructed(scene: Scene, trajectory: FloatArray, tracking: Tracking | None = None) -> Past:
    """Return the most probable states and actions behind a trajectory, (time, 4, 3)."""
    hidden = HiddenState(scene, tracking or Tracking())
    states, actions = [State.at_start(scene)], []
    for frame in trajectory[1:]:
        actions.append(most_probable_actions(hidden.advance(frame)))
        best = hidden.best()
        states.append(to_state(best.bodies, best.held, best.weld, scene.radius))
    return Past(states, actions)


def most_probable_actions(density: FloatArray) -> tuple[Action, Action]:
    """Return the pair of intended actions under which a frame is most probable.

    Args:
        density: (A, A) from :meth:`HiddenState.advance`.
    """
    red, green = np.unravel_index(int(density.argmax()), density.shape)
    return Action(int(red)), Action(int(green))
