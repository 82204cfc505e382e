"""What the closed loop read: its file, and the table of hypotheses about a video, at every frame.

Attributes of the file: ``schema``, ``event_id``, ``settings`` and ``cost`` (JSON), ``weight`` (what
a frame counts); ``samples``, of a simulator of one's own (0: it has a density); and those of the
scene (:func:`phase_ppl.analysis.tree.scene_dataset`). :func:`dimensions` has the variables.

A hypothesis is a way in which agents stand to each other, a goal of each, and strengths. Its mass
is that of the prior (:mod:`phase_ppl.models.prior_masses`, which says what rows, ways and
combinations are) times what frames say of it. Frames say something of the goals of all agents
together and of strengths: the agents' policies, and with them how probable a frame is
(:mod:`phase_ppl.closed_loop.goal_filter`); or, where a user's simulator was asked, a log density
for each combination of goals and strengths that has prior mass.

All is known in jackknife replicates: replicate 0 uses all sets of searches, or all samples, and
replicate k leaves out set k.

All hypotheses are summed over, unless they are too many. Then some are drawn, each agent's goal in
proportion to about what it has of the mass, and weighted by what they were drawn with: sums are
Monte-Carlo means.
"""

from __future__ import annotations

import functools
from typing import Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.agents.standpoints import standpoints
from phase_ppl.analysis.estimate import Estimate, over_sets
from phase_ppl.analysis.tree import kept_world
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.closed_loop.frame_likelihood import log_likelihoods
from phase_ppl.models.prior_masses import (
    APART,
    GoalRows,
    PriorMasses,
    different_goals,
    goal_codes,
    summed_by,
)
from phase_ppl.physics.actions import ACTION_NAMES, N_ACTIONS
from phase_ppl.world.arrays import GOLDEN, FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace, space_of

MOST_ROWS: Final = 400_000
"""Hypotheses with combinations of strengths up to which all are in one table, where strengths are
independent of goals; of more, strengths are drawn."""

_LEAST: Final = 1e-12  # hypotheses with a smaller share of the mass of the best are left out


SCHEMA: Final = "phase_ppl/closed_loop/4"
"""Of files of posteriors of the closed loop."""

_ATTRS: Final = ("event_id", "settings", "cost", "weight")
_ALWAYS: Final = {
    "combinations": ("combination", "agent"),
    "unexplained": ("time",),
    "trajectory": ("time", "entity", "coord"),
}
_BY_AGENTS: Final = {
    "strengths": ("time", "combination"),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "log_peak": ("time",),
}
_POLICIES: Final = {
    "density": ("time", "joint_action"),
    "policies": ("time", "agent", "policy", "planner_seed", "action"),
    "policy_of": ("time", "agent", "standpoint"),
    "shift": ("time", "table"),  # jackknife replicates
}
_READ: Final = {
    "goals": ("read", "agent"),
    "log_likelihood": ("time", "read", "combination"),
    "log_likelihood_without": ("part", "time", "read", "combination"),
}
_MARGINALS: Final = {"marginals": ("time", "agent", "goal")}


def dimensions(space: HypothesisSpace) -> dict[str, tuple[str, ...]]:
    """Return variable of a file -> its dimensions, of all that a file can have.

    ``strengths`` are the probabilities of their combinations, whatever the goals, given the frames
    so far and equal ones before; ``actions`` those of what each agent did to come to a frame;
    ``unexplained`` says by how many nats the best joint action leaves the frame less probable than
    one that is exactly where an action puts it, whose log density is ``log_peak``.
    ``log_likelihood`` is the log density of a frame given those before it, by effective goals, NaN
    where a simulator was not asked; then ``unexplained`` is by how many nats the frame is less
    probable than on the nearest of its samples, NaN without. The rest is in
    :mod:`phase_ppl.closed_loop.goal_filter`.
    """
    apart = {**APART, **_MARGINALS, "log_prior": space.kept_columns}
    return {**_ALWAYS, **_BY_AGENTS, **_POLICIES, **_READ, **apart}


def labels(space: HypothesisSpace, levels: tuple[float, ...]) -> dict[str, list[Any]]:
    """Return dimension -> its labels, of those that have some."""
    ways = [str(tuple(one[1] if one else 0 for one in way)) for way in space.ways]
    return {
        "agent": list(space.world.agents),
        "action": list(ACTION_NAMES),
        "goal": list(space.world.goals),
        **{key: list(space.world.goals) for key in space.stated_sites},
        ALPHA_SITE: ways,
        **{key: list(levels) for key in space.strength_sites},
    }


def _check(found: xr.Dataset, space: HypothesisSpace) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, unless ``found`` was read."""
    users_simulator = "samples" in found.attrs
    is_read = users_simulator or "log_likelihood" in found
    known = dimensions(space)
    names = {*_ALWAYS, *(() if users_simulator else _BY_AGENTS), *(_READ if is_read else _POLICIES)}
    apart = {*APART, *(() if users_simulator else _MARGINALS)}
    names |= {"log_prior"} if "log_prior" in found else apart
    missing = [name for name in _ATTRS if name not in found.attrs]
    if missing := sorted((*missing, *(name for name in names if name not in found.variables))):
        raise InvalidEventError(f"it lacks {', '.join(missing)}")
    if is_read and not users_simulator:  # goals and strengths apart
        known |= {"log_likelihood": ("time", "read")}
        known |= {"log_likelihood_without": ("planner_seed", "time", "read")}
    for name in names:
        if found[name].dims != known[name]:
            raise InvalidEventError(
                f"{name} has dimensions {found[name].dims}, expected {known[name]}"
            )
    sizes = {name: len(each) for name, each in labels(space, ()).items() if each}
    sizes |= {"way": len(space.ways), "joint_action": N_ACTIONS**space.n_agents}
    for name, size in sizes.items():
        if found.sizes.get(name, size) != size:
            raise InvalidEventError(f"{name} has {found.sizes[name]} entries, expected {size}")
    if is_read and not users_simulator and found.sizes["planner_seed"] == 1:
        raise InvalidEventError("planner_seed has 1 entry, expected none or several")
    for name, top in (("goals", space.n_goals), ("policy_of", found.sizes.get("policy", 0))):
        if name in names and not ((codes := found[name].values) >= 0).all() & (codes < top).all():
            raise InvalidEventError(f"{name} has a code outside 0 to {top - 1}")
    numbers = {
        **dict.fromkeys(("log_likelihood", "density", "log_prior_alpha"), "log densities"),
        **{"shift": "differences", "strengths": "probabilities", "trajectory": "positions"},
    }
    for name in names & {*numbers}:
        values = found[name].values
        # not asked, or not seen
        unknown = name == "trajectory" or (name == "log_likelihood" and users_simulator)
        if (np.isnan(values).any() and not unknown) or (values == np.inf).any():
            raise InvalidEventError(f"{name} has values that are no {numbers[name]}")


class Table:
    """Hypotheses about a video, and their log masses at any frame; :func:`table_of` makes it.

    Attributes:
        found: the variables that were read.
        space: the hypotheses of the world.
        prior: which of them there are.
        sampled: whether hypotheses were drawn.
        users_simulator: whether a user's simulator was read, strengths along with goals.
        samples: of it, for each hypothesis and frame; 0 where it has a density; else None.
        is_exact: whether there is no chance in it, so that errors are 0.
        goals: (goals, agent) the combinations of effective goals, of which frames say something.
    """

    def __init__(self, found: xr.Dataset) -> None:
        self.found, self.space = found, space_of(kept_world(found))
        self._weight, self.n_frames = float(found.attrs["weight"]), int(found.sizes["time"])
        self.users_simulator = "samples" in found.attrs
        self.samples = int(found.attrs["samples"]) if self.users_simulator else None
        self.is_exact = self.samples == 0
        kept = {name: found[name].values for name in ("log_prior", *APART) if name in found}
        self.prior = PriorMasses(self.space, kept, found["combinations"].values)
        self.sampled = self.prior.are_many
        # the last frame that is summed up, and the sums; those of an earlier frame start anew
        self._sums = -1, np.empty(0)

    def extended(self, found: xr.Dataset) -> Self:
        """Return the table of the same video with further frames, which goes on from this one.

        So that a stream costs as much at a late frame as at an early one, where all hypotheses are
        summed.
        """
        after = type(self)(found)
        if not self.sampled:  # others are drawn by what all frames say
            names = ("prior", "hypotheses", "_log_prior", "_places", "_standpoints", "_sums")
            vars(after).update({name: vars(self)[name] for name in names if name in vars(self)})
        return after

    def check_was_read(self) -> None:
        """Raise InvalidSettingError unless the simulator was asked about all that has mass."""
        prior = np.isfinite(self._log_prior)
        known = (self.goals[self._goals_of] == self.hypotheses.goals).all(axis=1)
        read = ~np.isnan(self.found["log_likelihood"].values[0][self._goals_of])
        if missing := int((prior & ~(known[:, None] & read)).sum()):
            raise InvalidSettingError(
                f"the prior has mass on {missing} hypotheses that the simulator was not asked "
                "about, as the first prior had none there: infer the event again with this one"
            )

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        """The hypotheses that are summed over, without strengths."""
        if not self.sampled:
            return self.prior.enumerated()
        marginals = self.found["marginals"].values  # by how probable goals are at about any frame
        masses = np.exp(marginals - marginals.max(axis=2, keepdims=True))
        return self.prior.drawn((masses / masses.sum(axis=2, keepdims=True)).mean(axis=0))

    @functools.cached_property
    def _places(self) -> tuple[IntArray, IntArray]:
        goals, n = self.hypotheses.goals, self.space.n_goals
        if self.sampled:
            return goals, np.arange(len(goals))
        if "goals" not in self.found:
            return different_goals(goals, n)
        read = self.found["goals"].values
        place = np.searchsorted(goal_codes(read, n), goal_codes(goals, n))
        return read, np.minimum(place, len(read) - 1)  # of goals without mass any will do

    @property
    def goals(self) -> IntArray:
        return self._places[0]

    @property
    def _goals_of(self) -> IntArray:
        """(row,) which of :attr:`goals` each hypothesis has."""
        return self._places[1]

    @functools.cached_property
    def _standpoints(self) -> list[IntArray]:
        """(agent) (goals,) the standpoint of each agent."""
        world = self.space.world
        return [standpoints(agent, world).of(self.goals) for agent in range(self.space.n_agents)]

    @property
    def combinations(self) -> FloatArray:
        """(combination, agent) strengths, newtons."""
        return self.prior.combinations

    @property
    def levels(self) -> tuple[float, ...]:
        """Strengths, newtons, ascending."""
        return tuple(np.unique(self.combinations).tolist())

    @property
    def n_sets(self) -> int:
        """Sets of searches, or parts of samples."""
        if "policies" in self.found:
            return int(self.found.sizes["planner_seed"])
        return max(1, len(self.found["log_likelihood_without"]))

    @property
    def n_replicates(self) -> int:
        """Jackknife replicates: with all sets of searches, and without each if there are several.

        In files their dimension is called "table".
        """
        return 1 + (self.n_sets if self.n_sets > 1 else 0)

    # --- what frames say ------------------------------------------------------------------------

    def of_frame(self, t: int, n_replicates: int = 1) -> FloatArray:
        """Return (replicate, goals) log likelihoods of a frame, of so many; of the first frame, 0.

        With strengths read along, (replicate, goals, combination), NaN where nothing was asked.
        """
        found = self.found
        if "log_likelihood" in found:
            without = found["log_likelihood_without"].values[: n_replicates - 1, t]
            return np.array([found["log_likelihood"].values[t], *without], np.float64)
        if t == 0:
            return np.zeros((n_replicates, len(self.goals)))
        policy_of, policies = found["policy_of"].values[t], found["policies"].values[t]
        numbers = [of[place] for of, place in zip(policy_of, self._standpoints, strict=True)]
        of_agents = [
            one[: of.max() + 1].astype(np.float64)
            for one, of in zip(policies, policy_of, strict=True)
        ]
        density = found["density"].values[t].reshape((N_ACTIONS,) * self.space.n_agents)
        first, every = log_likelihoods(density, of_agents, numbers, n_replicates)
        moved = first + found["shift"].values[t, :n_replicates, None]
        return np.where(np.isnan(every), moved, every)

    def summed(self, frame: int) -> FloatArray:
        """Return (replicate, goals) log likelihoods of the frames up to ``frame``, as of one."""
        at, sums = self._sums
        if not 0 <= at <= frame:
            at, sums = 0, self.of_frame(0, self.n_replicates)
        for t in range(at + 1, frame + 1):
            sums = sums + self.of_frame(t, self.n_replicates)  # others may have the old ones
        self._sums = frame, sums
        return sums

    def of_strengths(self, frame: int) -> FloatArray:
        """Return (combination,) what the frames so far say of strengths, whatever the goals.

        That is their probabilities now over those before any frame, which were equal.
        """
        if self.users_simulator:
            return np.ones(len(self.combinations))
        found = self.found["strengths"].values[frame]
        return np.maximum(found, 1e-300) * found.size

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return (row, combination) log likelihoods of the frames up to ``frame``, as they count.

        -inf where nothing was asked.
        """
        found = self._weight * self.summed(frame)[0][self._goals_of]
        if self.users_simulator:
            return np.where(np.isfinite(self._log_prior), found, -np.inf)
        return np.asarray(found[:, None] + np.log(self.of_strengths(frame)))

    def by_frame(self) -> FloatArray:
        """Return (time, goals) log densities of frames given those before them.

        Strengths that were read along are averaged over, as they are believed to be by then.
        """
        if not self.users_simulator:
            return np.array([self.of_frame(t)[0] for t in range(self.n_frames)])
        n = len(self.goals)
        masses = np.array(
            [summed_by(self._goals_of, self.log_masses(t)[0], n) for t in range(self.n_frames)]
        )
        with np.errstate(invalid="ignore"):  # of what was impossible before
            found = np.diff(masses, axis=0, prepend=masses[:1]) / self._weight
        return np.where(np.isnan(found), -np.inf, found)

    def on_grid(self, of_goals: FloatArray) -> FloatArray:
        """Return (..., goal of the first agent, of the second, ...) of (..., goals); else -inf."""
        found = np.full(
            (*of_goals.shape[:-1], *[self.space.n_goals] * self.space.n_agents), -np.inf
        )
        found[..., *self.goals.T] = of_goals
        return found

    def prior_of_goals(self) -> FloatArray:
        """Return (goal of the first agent, of the second, ...) log prior masses."""
        return self.on_grid(summed_by(self._goals_of, self.hypotheses.log_prior, len(self.goals)))

    # --- masses of goals ------------------------------------------------------------------------

    @functools.cached_property
    def _log_prior(self) -> FloatArray:
        """(row, combination) log prior masses."""
        with np.errstate(divide="ignore"):
            return self.hypotheses.log_prior[:, None] + np.log(self.prior.of_strengths)

    def _masses(self, frame: int, weight: float) -> FloatArray:
        """Return (replicate, row, combination) log masses, of strengths that were read along."""
        found = np.full((self.n_replicates, *self._log_prior.shape), -np.inf)
        some = np.flatnonzero(np.isfinite(self._log_prior).any(axis=1))
        prior, so_far = self._log_prior[some], weight * self.summed(frame)[:, self._goals_of[some]]
        found[:, some] = np.where(prior > -np.inf, prior + so_far, -np.inf)
        return found

    def log_masses(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return (replicate, row) log masses given the frames up to ``frame``.

        A frame counts ``weight``, by default the likelihood's.
        """
        weight = self._weight if weight is None else weight
        if self.users_simulator:
            return np.asarray(np.logaddexp.reduce(self._masses(frame, weight), axis=2))
        rows, of_strengths = self.hypotheses, self.prior.of_strengths @ self.of_strengths(frame)
        so_far = weight * self.summed(frame)[:, self._goals_of]
        return np.asarray(rows.log_prior - rows.log_drawn + np.log(of_strengths) + so_far)

    def log_masses_within(self, first: int, last: int) -> FloatArray:
        """Return (row,) log masses given the frames after ``first`` up to ``last`` alone.

        With all sets of searches; of strengths these frames say nothing here.
        """
        rows = self.hypotheses
        with np.errstate(invalid="ignore"):  # what has become impossible before stays so
            seen = -self.summed(first)[0] + self.summed(last)[0]
        seen = np.where(np.isnan(seen), -np.inf, seen)[self._goals_of]
        return np.asarray(rows.log_prior - rows.log_drawn + self._weight * seen)

    def weights(self, frame: int) -> FloatArray:
        """Return (replicate, row) :meth:`log_masses` as probabilities."""
        return _shares(self.log_masses(frame))

    def log_evidence(self, frame: int) -> Estimate:
        """Return log p of the frames up to ``frame``, in nats, each counted in full.

        Its error is by the jackknife over sets of searches; NaN: there is a single set.
        """
        value, *without = [log_sum_exp(masses) for masses in self.log_masses(frame, 1.0)]
        if self.is_exact:
            return Estimate(value, 0.0)
        if (sets := over_sets(np.reshape(without, (-1, 1)))) is None:
            return Estimate(value, why="of one set of searches; planner_seeds=4 tells it")
        return Estimate(value, float(sets.error(without, value)))

    @functools.cached_property
    def log_predictive(self) -> FloatArray:
        """Return (time,) log density of each frame given those before it; 0 for the first."""
        found = np.zeros(self.n_frames)
        for t in range(1, self.n_frames):
            before = self.log_masses(t - 1)[0]
            of_frame = self.of_frame(t)[0][self._goals_of]
            found[t] = log_sum_exp(before - log_sum_exp(before) + of_frame)
        return found

    # --- tables ---------------------------------------------------------------------------------

    def strengths(self, frame: int) -> FloatArray:
        """Return (row, combination) probabilities of strengths given a hypothesis; one row: any."""
        if not self.users_simulator:
            found = self.prior.of_strengths * self.of_strengths(frame)
            return np.asarray(found / found.sum(axis=1, keepdims=True))
        masses = self._masses(frame, self._weight)[0]
        possible = masses.max(axis=1, keepdims=True) > -np.inf
        masses = np.where(possible, masses, 0.0)
        return np.where(possible, _shares(masses), self.prior.of_strengths)

    def all_log_masses(self, frame: int) -> FloatArray:
        """Return (replicate, row of :meth:`all_columns`) log masses."""
        if self.users_simulator:
            return self._masses(frame, self._weight).reshape(self.n_replicates, -1)
        masses = self.log_masses(frame)
        if not self._with_strengths(len(self.hypotheses.way)):
            return masses
        with np.errstate(divide="ignore"):
            strengths = np.log(self.strengths(frame))
        return np.asarray((masses[:, :, None] + strengths).reshape(len(masses), -1))

    def _with_strengths(self, n: int) -> bool:
        """Whether so many hypotheses with all strengths are in one table."""
        depend = self.users_simulator or self.prior.log_prior is not None
        return depend or n * len(self.combinations) <= MOST_ROWS

    def all_columns(self) -> dict[str, NDArray[Any]]:
        """Return the codes of all hypotheses, with all strengths unless these are too many."""
        n_rows, n = len(self.hypotheses.way), len(self.combinations)
        if not self._with_strengths(n_rows):
            return self.columns()
        return self.columns(*np.divmod(np.arange(n_rows * n), n))

    def columns(
        self, rows: IntArray | None = None, combination: IntArray | None = None
    ) -> dict[str, NDArray[Any]]:
        """Return the codes of some hypotheses, or of all, with or without strengths."""
        space, found = self.space, self.hypotheses
        way, goals, stated = (
            part if rows is None else part[rows] for part in (found.way, found.goals, found.stated)
        )
        values: dict[str, NDArray[Any]] = {
            **dict(zip(space.stated_sites, stated.T, strict=True)),
            ALPHA_SITE: way,
            **dict(zip(space.goal_sites, goals.T, strict=True)),
        }
        if combination is not None:
            newtons = self.combinations[combination].T
            values |= dict(zip(space.strength_sites, newtons, strict=True))
        return values

    def rows(self, frame: int) -> tuple[Rows, FloatArray]:
        """Return hypotheses with any mass to speak of, and (set, row) weights without each set."""
        weights, n = self.weights(frame), len(self.combinations)
        kept = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
        if self._with_strengths(len(kept)):
            if self.users_simulator:  # each part of the samples has strengths of its own
                weights = _shares(
                    self._masses(frame, self._weight)[:, kept].reshape(len(weights), -1)
                )
            else:
                strengths = self.strengths(frame)
                strengths = strengths[kept] if len(strengths) > 1 else strengths
                weights = (weights[:, kept, None] * strengths).reshape(len(weights), -1)
            some = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
            row, combination = np.divmod(some, n)
            kept, weights = kept[row], weights[:, some]
        else:  # two combinations each, in their proportions: a low-discrepancy draw
            at = (np.arange(len(kept)) * GOLDEN)[:, None] + [0.0, 0.5]
            combination = np.searchsorted(np.cumsum(self.strengths(frame)[0]), (at % 1.0).ravel())
            combination = np.minimum(combination, n - 1)
            kept, weights = np.repeat(kept, 2), np.repeat(weights[:, kept], 2, axis=1)
        weights = weights / weights.sum(axis=1, keepdims=True)
        index = {"hypothesis": np.arange(len(kept))}
        return Rows(self.columns(kept, combination), weights[0], index), weights[1:]

    def most_probable(self, frame: int) -> dict[str, Any]:
        """Return the codes of the most probable hypothesis, whatever it was drawn with."""
        strengths = self.strengths(frame)
        masses = self.log_masses(frame)[0] + self.hypotheses.log_drawn
        row = (masses + np.log(strengths.max(axis=1))).argmax()
        combination = strengths[row if len(strengths) > 1 else 0].argmax()
        columns = self.columns(np.array([row]), np.array([combination]))
        return {name: column[0].item() for name, column in columns.items()}


def table_of(found: xr.Dataset) -> Table:
    """Return the hypotheses about a video that the closed loop read.

    Raises:
        InvalidEventError: ``found`` lacks something, or is of another kind; the message names it.
        InvalidSettingError: the prior has mass on hypotheses that the simulator was not asked
            about.
    """
    if found.attrs.get("schema") != SCHEMA:
        raise InvalidEventError(
            "this is no posterior of the closed loop: its schema is "
            f"{found.attrs.get('schema')!r}, expected {SCHEMA!r} (other versions: infer again)"
        )
    try:
        space = space_of(kept_world(found))
    except (ValueError, LookupError, TypeError, PhasePPLError) as error:
        raise InvalidEventError(f"its world cannot be read: {error}") from None
    _check(found, space)
    table = Table(found)
    if table.users_simulator:
        table.check_was_read()
    return table


def _shares(log_masses: FloatArray) -> FloatArray:
    """Return (..., row) log masses as probabilities."""
    shares = np.exp(log_masses - log_masses.max(axis=-1, keepdims=True))
    return np.asarray(shares / shares.sum(axis=-1, keepdims=True))
