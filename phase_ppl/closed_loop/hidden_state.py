"""The hidden part of the state, filtered from what is seen: velocities, holds and strengths.

A beam of full states goes along with the video. At each frame every joint action is tried from
each of them; the states after those that explain the frame best go on, corrected by what was
seen. Frames are compared like with like: means over the substeps of a step.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.closed_loop.noise import NoiseEstimate, filter_gains
from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.constants import WORLD_INNER_STEPS
from phase_ppl.world.checks import nonnegative_number, positive_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.scene import Scene
from phase_ppl.world.state import State

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ALIKE: Final = 4
"""States of the beam that agree on holds and strengths, at most: they differ in velocities."""

_TRIED: Final = 6
"""Joint actions followed per place in the beam."""

_LEAST: Final = 20.0
"""Log weight below the best at which a state is dropped."""

_VELOCITY_BIN: Final = 3.0
"""States whose velocities differ by less are taken for the same, units/s."""


@dataclasses.dataclass(frozen=True)
class Tracking:
    """How the hidden state is followed.

    The values were chosen on ten of the real videos, by agreement with the actions recovered
    from them, and confirmed on all 50 (``benchmarks/stepwise.py replays``).

    Attributes:
        strengths: newtons that each agent may have, ascending.
        states: places in the beam.
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
        for name in ("scale", "angle_scale", "tail"):
            positive_number(name, getattr(self, name))
        if self.noise is not None:
            nonnegative_number("noise", self.noise)


@dataclasses.dataclass(frozen=True, eq=False)
class Beam:
    """States that the world may be in.

    Attributes:
        bodies: (B, 4, 9); held: (B, 2); weld: (B, 2, 3): as in :mod:`phase_ppl.physics.compiled`.
        strengths: (B, 2) newtons.
        log_weight: (B,) log probabilities.
    """

    bodies: FloatArray
    held: IntArray
    weld: FloatArray
    strengths: FloatArray
    log_weight: FloatArray

    def __len__(self) -> int:
        return len(self.bodies)

    def best(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return (bodies, held, weld) of the most probable state."""
        row = int(self.log_weight.argmax())
        return self.bodies[row], self.held[row], self.weld[row]


class HiddenState:
    """The filter, at the start of a video.

    Args:
        scene: where everything starts, at rest.
        tracking: its settings.

    Attributes:
        beam: states after the last frame.
    """

    def __init__(self, scene: Scene, tracking: Tracking) -> None:
        self.tracking = tracking
        pairs = np.array(list(itertools.product(tracking.strengths, repeat=len(AGENTS))))
        n = len(pairs)
        bodies, held, weld = compiled.from_state(State.at_start(scene), scene.radius)
        self.beam = Beam(
            np.repeat(bodies[None], n, axis=0),
            np.repeat(held[None], n, axis=0),
            np.repeat(weld[None], n, axis=0),
            pairs,
            np.full(n, -np.log(n)),
        )
        # its forces are overwritten state by state
        strongest = (max(tracking.strengths),) * 2
        self._params = compiled.make_params(scene, strongest, inner_steps=WORLD_INNER_STEPS)
        self._scratch = compiled.make_scratch()
        self._trial = inverse.make_trial()
        self._executed = np.array([executed(a, scene.turning) for a in range(N_ACTIONS)])
        intended = np.zeros((N_ACTIONS, N_ACTIONS))
        np.add.at(intended, np.ix_(self._executed, self._executed), 1.0 / N_ACTIONS**2)
        with np.errstate(divide="ignore"):
            self._log_prior = np.log(intended)
        self._noise = NoiseEstimate(tracking.noise, scene.start)

    def advance(self, observed: FloatArray) -> FloatArray:
        """Take in the next frame.

        Args:
            observed: (4, 3) x, y [units], angle [rad].

        Returns:
            (A, A) log density of the frame after every pair of intended actions, red's first.
        """
        tracking, beam = self.tracking, self.beam
        noise = self._noise.update(observed)
        found = np.empty((len(beam), N_ACTIONS, N_ACTIONS))
        inverse.try_all(
            beam.bodies,
            beam.held,
            beam.weld,
            beam.strengths,
            observed,
            float(np.hypot(tracking.scale, noise)),
            tracking.angle_scale,
            tracking.tail,
            self._params,
            self._scratch,
            self._trial,
            found,
        )
        found += beam.log_weight[:, None, None]
        self._go_on(found + self._log_prior, observed, filter_gains(tracking.scale, noise))
        density = np.logaddexp.reduce(found, axis=0)
        return np.asarray(density[np.ix_(self._executed, self._executed)])

    def strengths(self) -> FloatArray:
        """Return (strength of red, strength of green) probabilities, by the settings' order."""
        levels = np.array(self.tracking.strengths)
        table = np.zeros((len(levels), len(levels)))
        red, green = np.searchsorted(levels, self.beam.strengths).T
        np.add.at(table, (red, green), np.exp(self.beam.log_weight))
        return table

    def _go_on(self, joint: FloatArray, observed: FloatArray, gains: FloatArray) -> None:
        """Replace the beam by the best states after the frame; ``joint`` is (B, A, A)."""
        flat = joint.ravel()
        n = min(len(flat), _TRIED * self.tracking.states)
        order = np.argpartition(-flat, n - 1)[:n]
        order = order[np.argsort(-flat[order], kind="stable")]
        order = order[flat[order] > flat[order[0]] - _LEAST]
        parents, red, green = np.unravel_index(order, joint.shape)
        n = len(order)
        bodies = np.empty((n, len(ENTITIES), self.beam.bodies.shape[2]))
        held = np.empty((n, len(AGENTS)), np.int64)
        weld = np.empty((n, len(AGENTS), 3))
        inverse.follow(
            self.beam.bodies,
            self.beam.held,
            self.beam.weld,
            self.beam.strengths,
            parents.astype(np.int64),
            np.column_stack([red, green]).astype(np.int64),
            observed,
            gains,
            self._params,
            self._scratch,
            self._trial,
            bodies,
            held,
            weld,
        )
        strengths = self.beam.strengths[parents]
        rows, mass = self._merged(bodies, held, strengths, flat[order])
        mass -= np.logaddexp.reduce(mass)
        self.beam = Beam(bodies[rows], held[rows], weld[rows], strengths[rows], mass)

    def _merged(
        self, bodies: FloatArray, held: IntArray, strengths: FloatArray, weight: FloatArray
    ) -> tuple[list[int], FloatArray]:
        """Return which states go on, and their log weights; the best stands for all alike."""
        places: dict[tuple[float, ...], int] = {}
        alike: dict[tuple[float, ...], int] = {}
        rows: list[int] = []
        mass: list[float] = []
        velocities = np.round(bodies[:, :, 3:5].reshape(len(bodies), -1) / _VELOCITY_BIN)
        for row in range(len(bodies)):
            kind = (*held[row].tolist(), *strengths[row].tolist())
            key = (*kind, *velocities[row].tolist())
            place = places.get(key)
            if place is not None:
                mass[place] = float(np.logaddexp(mass[place], weight[row]))
            elif len(rows) < self.tracking.states and alike.get(kind, 0) < _ALIKE:
                alike[kind] = alike.get(kind, 0) + 1
                places[key] = len(rows)
                rows.append(row)
                mass.append(float(weight[row]))
        return rows, np.array(mass)


def most_probable_actions(density: FloatArray) -> tuple[Action, Action]:
    """Return the pair of intended actions under which a frame is most probable.

    Args:
        density: (A, A) from :meth:`HiddenState.advance`.
    """
    red, green = np.unravel_index(int(density.argmax()), density.shape)
    return Action(int(red)), Action(int(green))
