"""The posterior of the closed-loop likelihood: summed over all hypotheses, at every frame."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.closed_loop_table import Table, dimensions, table_of
from phase_ppl.analysis.estimate import Estimate, Jackknife, kish_size, over_sets
from phase_ppl.analysis.event_posterior import EventPosterior, answer_lines
from phase_ppl.analysis.hypotheses import Given, Hypotheses
from phase_ppl.analysis.quantities import Vocabulary
from phase_ppl.analysis.query import Definition
from phase_ppl.analysis.tree import changed_text, settings_under
from phase_ppl.analysis.verdict import SURPRISE, UNEXPLAINED, of_reading, of_tracks
from phase_ppl.analysis.weights import log_sum_exp
from phase_ppl.models.prior_masses import MOST_HYPOTHESES
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    QueryError,
    UnknownNameError,
    whole_number,
)
from phase_ppl.world.event import MIN_FRAMES, Observation
from phase_ppl.world.picture import wrapped

if TYPE_CHECKING:
    from phase_ppl.analysis.users_sites import WithSites

FILTERING: Final = (
    "Filtering: what can be believed at each frame from the frames so far; later frames change "
    "nothing of it. Only which way agents can turn, where a reader of a file found that out from "
    "the video, is known from the start."
)
"""Goes with every result over time."""

FRAME: Final = "frame"  # attribute of files: the last frame that is counted


class ClosedLoopPosterior(EventPosterior):
    """The closed loop's posterior over all agents' goals, relations and strengths.

    Methods for questions are described in :class:`phase_ppl.analysis.hypotheses.Hypotheses`.

    The posterior is a sum over all hypotheses. With more than 500 000 of them it is a weighted sum
    over that many, drawn from a mixture of the prior and of goals that the video makes likely.

    The terms of the sum are approximate. Searches estimate the agents' policies: ``.error`` of an
    answer is the resulting standard error, by the jackknife over the sets of searches
    (``planner_seeds``); with one set it is NaN. It is NaN too for answers that depend on strengths.
    Velocities, holds and strengths come from a filter. Strengths are taken to be independent of the
    goals given the video.

    Each frame counts ``weight`` (of the likelihood) for goals, and ``Tracking.strength_weight`` for
    strengths. Where these are not 1, the posterior is tempered: frames then count less than they
    would under the model (how they were chosen: :class:`phase_ppl.ClosedLoopLikelihood`).

    With a simulator of your own nothing is filtered, strengths are part of the hypotheses, and by
    default a frame counts in full. If the simulator has a density of the next frame, the posterior
    is exact and errors are 0. Otherwise errors come from the jackknife over parts of its samples.

    Args:
        found: what the closed loop read (:mod:`phase_ppl.analysis.closed_loop_table`).
        frame: the last frame that counts; by default the last of the video.
        prior: the prior's program, for questions about sites beyond those of a hypothesis.
        table: the hypotheses' likelihoods, computed from ``found`` by another posterior of the same
            video; None: they are computed.

    Raises:
        InvalidEventError: ``found`` lacks something; the message names it.
        InvalidSettingError: there is no such frame.
    """

    def __init__(
        self,
        found: xr.Dataset,
        frame: int | None = None,
        *,
        prior: Callable[..., object] | None = None,
        table: Table | None = None,
    ) -> None:
        self._table: Table = table_of(found) if table is None else table
        self._found, self._prior = self._table.found, prior
        last = self._table.n_frames - 1
        self._frame = last if frame is None else whole_number("frame", frame, 0, last)
        self._of_sites: dict[str, Definition] = {}  # defined in terms of further sites
        words = Vocabulary(self._table.space)
        rows, without = self._table.rows(self._frame)
        self._over_sets = over_sets(without)
        if self._table.is_exact:  # there is nothing to leave out
            self._over_sets = Jackknife(rows.weights[None], 0.0)
        rows = dataclasses.replace(rows, values=words.completed(rows.values))
        found = self._found
        super().__init__(words, found.attrs, found, words.quantities, rows)

    @functools.cached_property
    def sites(self) -> WithSites:
        """The table of hypotheses and of the further sites that a prior of your own samples.

        Questions that name such a site are answered from it
        (:mod:`phase_ppl.analysis.users_sites`): exactly, if these sites have up to 64 combinations
        of values; otherwise from 20 000 seeded draws, with their Monte-Carlo error.

        Raises:
            InvalidSettingError: the prior has no further sites, or its program is unknown, as after
                loading.
        """
        if not self._site_names:
            raise InvalidSettingError("the prior samples nothing but the sites of a hypothesis")
        if self._prior is None:
            raise InvalidSettingError(
                f"{', '.join(self._site_names)}: a site of the prior "
                f"{self.settings['model']['prior']}, which a file cannot hold: give it again, "
                "post.with_prior(prior)"
            )
        from phase_ppl.analysis.users_sites import with_sites

        prior = self.bound(self._prior)
        found = with_sites(prior, self._table, self._frame, self._words)
        return found._defining({**self._defined, **self._of_sites})

    @functools.cached_property
    def _site_names(self) -> tuple[str, ...]:
        """The further sites of the prior."""
        return tuple(json.loads(self._found.attrs.get("sites", "[]")))

    @property
    def quantities(self) -> dict[str, tuple[str, ...] | None]:
        """What one can ask about: name of a quantity -> its labels; None for a real number."""
        if self._prior is None or not self._site_names:
            return super().quantities
        return {**super().quantities, **self.sites.quantities}

    def _names_sites(self, said: object) -> bool:
        """Whether words name a further site, or what is defined by one."""
        # a name may have other characters than those of words
        words = (said, *re.findall(r"\w+", said)) if isinstance(said, str) else ()
        return not {*self._site_names, *self._of_sites}.isdisjoint(words)

    def _knowing(self, *names: str, given: Given = None) -> Hypotheses:
        said = (*names, *given) if isinstance(given, Mapping) else (*names, given)
        return self.sites if any(map(self._names_sites, said)) else self

    def query(self, question: str) -> Any:
        try:
            return super().query(question)
        except QueryError:
            if self._prior is None or not self._site_names:
                raise
            # it may name a further site, which words alone do not tell; else the error does
            return self.sites.query(question)

    def define(self, name: str, definition: Definition) -> Self:
        if self._names_sites(definition):
            self.sites.define(name, definition)
            if self._defined.pop(name, None) is not None:
                self._quantities = {k: one for k, one in self._quantities.items() if k != name}
            self._of_sites[name] = definition
            return self
        if name in self._site_names:
            raise InvalidSettingError(f"the prior has a site {name!r}: choose another name")
        self._of_sites.pop(name, None)
        super().define(name, definition)
        if "sites" in vars(self):
            self.sites.define(name, definition)
        return self

    def _jackknife(self, share: float) -> Jackknife | None:
        """Leave out single sets of searches, of which there are few, whatever is asked."""
        return self._over_sets

    def _has_error(self, *columns: NDArray[Any]) -> bool:
        """Return whether no column depends on strengths.

        One filter follows these, whatever the sets of searches find: how far the sets differ says
        nothing of them.
        """
        same = ((column == column[self._first_alike]).all() for column in columns)
        return self._table.users_simulator or all(same)

    @functools.cached_property
    def _first_alike(self) -> IntArray:
        """(row,) the first row with the same goals and alphas; such rows follow each other."""
        apart = {*self.strengths_of.values(), *self._defined}
        columns = [column for name, column in self._rows.values.items() if name not in apart]
        new = np.any([column[1:] != column[:-1] for column in columns], axis=0)
        place = np.arange(len(self._rows.weights))
        return np.maximum.accumulate(np.where(np.concatenate([[True], new]), place, 0))

    @property
    def planner_seeds(self) -> int:
        """Number of sets of searches; with a simulator of your own, of parts of its samples."""
        return self._table.n_sets

    @property
    def dataset(self) -> xr.Dataset:
        """What the closed loop read (:func:`phase_ppl.analysis.closed_loop_table.dimensions`)."""
        return self._found

    @property
    def prior(self) -> Callable[..., object] | None:
        """The prior's program; None: unknown, as after loading."""
        return self._prior

    @property
    def frame(self) -> int:
        """The last frame that counts."""
        return self._frame

    def at(self, frame: int) -> ClosedLoopPosterior:
        """Return the posterior given only the frames from 0 to ``frame``.

        Raises:
            InvalidSettingError: there is no such frame.
        """
        at = ClosedLoopPosterior(self._found, frame, prior=self._prior, table=self._table)
        return at._defining(self.definitions)

    @property
    def definitions(self) -> dict[str, Definition]:
        return {**self._defined, **self._of_sites}

    def _checked(self, prior: Callable[..., object] | str) -> Callable[..., object]:
        from phase_ppl.models.effective import as_given
        from phase_ppl.models.model import Model, for_table

        return as_given(for_table(Model(prior=prior).prior, self.scene, self._video))

    @property
    def _video(self) -> Observation | None:
        """All frames that were read, whatever is counted."""
        seen = self._found["trajectory"].values
        return Observation(seen) if len(seen) >= MIN_FRAMES else None

    def under(self, prior: Callable[..., object]) -> ClosedLoopPosterior:
        from phase_ppl.models.closed_loop import closed_loop_prior

        table = self._table
        masses, attrs = closed_loop_prior(self.bound(prior), self.world, table.levels)
        known = dimensions(table.space)
        found = self._found.assign({name: (known[name], one) for name, one in masses.items()})
        found.attrs |= {**attrs, "settings": settings_under(found.attrs["settings"], prior)}
        changed = ClosedLoopPosterior(found, self._frame, prior=prior)
        return changed._defining(self.definitions)

    @property
    def tempering(self) -> str:
        weight, of_strengths = float(self._found.attrs["weight"]), self._strength_weight
        counts = {
            "goals": weight,
            "strengths": weight if self._table.users_simulator else of_strengths,
        }
        words = [f"{count:g} for {what}" for what, count in counts.items() if count != 1]
        return f"tempered: a frame counts {' and '.join(words)}" if words else ""

    @property
    def _strength_weight(self) -> float:
        """What a frame counts as evidence for strengths apart; 1 where it is not known."""
        if self._table.users_simulator:
            return 1.0
        tracking = self.settings.get("likelihood", {}).get("tracking", {})
        return float(tracking.get("strength_weight", 1.0))

    @property
    def log_evidence(self) -> Estimate:
        """Log p(s_1..t | s_0) of the frames s so far: log sum_h P(h) prod_t p(s_t | s_<t, h).

        It is in nats; the density is per frame, in PHASE in 1 / (unit^8 rad^2). Each frame counts
        in full, for any ``weight`` of the likelihood. Only evidence for strengths stays tempered
        (``Tracking.strength_weight``).

        Of two priors, or of two models with the same tracking, the one with the higher log evidence
        explains the video better. Do not compare priors that differ in strengths by it. Differences
        tend to be too large, because a model that errs does so for many frames in a row.

        The error is by the jackknife over sets of searches; NaN with one set.
        """
        return self._table.log_evidence(self._frame)

    def surprise(self) -> FloatArray:
        """Return (time,) the nats by which each frame was less probable than a perfect match.

        In a perfect match the bodies are exactly where an action of probability 1 puts them. A
        frame's probability is under the posterior given the frames before. The first frame has 0.
        With a simulator of your own all are NaN, because no perfect match is known.
        """
        if self._table.users_simulator:
            return np.full(self._frame + 1, np.nan)
        found = self._found["log_peak"].values - self._table.log_predictive
        return np.asarray(found[: self._frame + 1])

    @property
    def chains(self) -> Any:
        raise InvalidSettingError(
            "a posterior of the closed loop has no chains: it is a sum over hypotheses. "
            "post.arviz has draws from it; post.diagnostics() says whether it can be trusted"
        )

    @property
    def _is_exact(self) -> bool:
        return not self._table.sampled

    @property
    def _weighting(self) -> str:
        return "all hypotheses"

    def diagnostics(self) -> dict[str, Any]:
        """Return diagnostics, with a verdict on whether the answer can be trusted.

        Returns:
            A dictionary. Numbers in nats are None if they are unknown.

            * ``frames``: number of frames so far.
            * ``planner_seeds``: number of sets of searches. ``weight``: what a frame counts.
            * ``samples``: samples drawn of a simulator of your own (0: it has a density); else
              None.
            * ``leading``: the most probable goals and relation (:meth:`leaders`). ``decided``:
              whether all of them are sure.
            * ``surprise_median``: median of :meth:`surprise`, nats, without the part that no action
              explains.
            * ``surprising_share``: share of frames where this exceeds ``surprise_reference`` (4).
            * ``unexplained_most``: largest part of a frame's surprise that no action explains,
              nats. ``unexplained_frames``: indices of frames whose part exceeds 17 nats.
            * Facts about the tracks: the keys of :func:`phase_ppl.analysis.verdict.of_tracks`.
            * The verdict: ``trust``, ``answer``, ``checks``, ``next``, ``verdict``
              (:func:`phase_ppl.analysis.verdict.judged`).
        """
        found = self._found.isel(time=slice(None, self._frame + 1))
        unexplained = np.array(found["unexplained"].values, float)
        observed = self.observed()
        surprise = self.surprise() - unexplained
        surprise = surprise[1:][~np.isnan(observed[1:, :, 0]).all(axis=1)]
        leading = self.leaders()
        known, seen = np.isfinite(surprise).any(), np.isfinite(unexplained[1:]).any()
        result = {
            "frames": self._frame + 1,
            "planner_seeds": self.planner_seeds,
            "weight": float(found.attrs["weight"]),
            "samples": self._table.samples,
            "leading": leading,
            "decided": all(one["sure"] for one in leading.values()),
            "surprise_median": float(np.median(surprise)) if known else None,
            "surprise_reference": SURPRISE,
            "surprising_share": float((surprise > SURPRISE).mean()) if known else None,
            "unexplained_most": float(unexplained[1:].max()) if seen else None,
            "unexplained_frames": np.flatnonzero(unexplained > UNEXPLAINED).tolist(),
            **of_tracks(observed, self.scene, not self._table.users_simulator),
        }
        return {**result, **of_reading(result)}

    def map(self) -> Any:
        space, best = self._table.space, self._table.most_probable(self._frame)
        sites = zip(space.sites, space.kept_columns, strict=True)
        return space.hypothesis({site: best[name] for site, name in sites})

    def over_time(self) -> xr.Dataset:
        """Return the marginals at every frame, given the frames so far.

        Returns:
            Probabilities (time, label) of ``goal_red``, ``goal_green``, ``relation`` and
            ``scenario``, or of ``goal_<agent>`` and ``relation_<one>_<other>`` in another world.
            Labels of ``goal_red`` are in ``goal_red_is``, its standard errors in ``goal_red_error``
            (NaN with a single set of searches), and so on. ``time`` is in simulated seconds. The
            attribute ``filtering`` says in words what these probabilities are.
        """
        words, n = self._words, self._frame + 1
        columns = words.completed(self._table.columns())
        told = (*self.goals_of.values(), *self.relations_of.values(), *self.scenarios_of.values())
        sizes = {name: len(words.quantities[name].categories()) for name in told}
        masses = {
            name: np.empty((self._table.n_replicates, n, size)) for name, size in sizes.items()
        }
        for t in range(n):
            for row, weights in enumerate(self._table.weights(t)):
                for name, size in sizes.items():
                    masses[name][row, t] = np.bincount(columns[name], weights, size)
        tables = {}
        for name, found in masses.items():
            tables[name] = found[0]
            tables[f"{name}_error"] = self._error_over_sets(found[1:], found[0])
        time = self._found["time"].values[:n]
        return self._along_time(time, tables, filtering=FILTERING, tempering=self.tempering)

    def _error_over_sets(self, without: FloatArray, value: FloatArray) -> FloatArray:
        """Return the errors of (...) values, given (set, ...) those without each set of searches.

        By the jackknife; NaN where there is a single set.
        """
        if self._over_sets is None or self._table.is_exact:
            return np.full(np.shape(value), 0.0 if self._table.is_exact else np.nan)
        return self._over_sets.error(without, value)

    def why(self, event: str, over: str | None = None) -> xr.Dataset:
        if self._knowing(given=event) is not self or self._knowing(given=over) is not self:
            raise InvalidSettingError(
                f"{event}{f' over {over}' if over else ''}: frames speak of hypotheses, not of "
                "further sites of the prior"
            )
        table = self._table
        masses_at: Callable[[int], FloatArray] = table.log_masses
        try:
            wanted, other = self._sides(table.columns(), event, over)
        except (QueryError, UnknownNameError):  # it may be about strengths, in a larger table
            wanted, other = self._sides(table.all_columns(), event, over)
            masses_at = table.all_log_masses
        log_odds, possible = np.empty((table.n_replicates, self._frame + 1)), False
        for t in range(self._frame + 1):
            for place, mass in enumerate(masses_at(t)):
                for_it, against = log_sum_exp(mass[wanted]), log_sum_exp(mass[other])
                possible |= math.isfinite(for_it)
                with np.errstate(invalid="ignore"):
                    log_odds[place, t] = for_it - against
        odds, without = log_odds[0], log_odds[1:]
        if not np.isfinite(odds[0]):
            raise InvalidSettingError(
                f"{over or f'not {event}' if possible else event} is impossible under the prior: "
                "there are no odds"
            )
        with np.errstate(invalid="ignore"):  # of odds that are not finite there is no error
            error = self._error_over_sets(without, odds)
        return self._odds(odds, error, event, over)

    def by_frame(self) -> xr.Dataset | None:
        table = self._table
        if not table.space.is_listed:
            return None
        names, n = table.space.goal_sites, self._frame + 1
        log_likelihood, log_prior = table.on_grid(table.by_frame()[:n]), table.prior_of_goals()
        labels = {key: list(self.world.goals) for key in names}
        weighed = float(self._found.attrs["weight"]) * log_likelihood
        return xr.Dataset(
            {"log_likelihood": (("time", *names), weighed), "log_prior": (names, log_prior)},
            {"time": self._found["time"][:n], **labels},
        )

    def observed(self) -> FloatArray:
        return np.asarray(self._found["trajectory"].values, np.float64)[: self._frame + 1]

    def _to_keep(self) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
        found = self._found.copy()
        found.attrs |= {FRAME: self._frame}
        return {"/": found}, {"zlib": True, "complevel": 4}

    def _judged(self) -> dict[str, Any]:
        return {"log_evidence": self.log_evidence, **super()._judged(), "frame": self.frame}

    def _head(self, found: Mapping[str, Any]) -> str:
        seeds = found["planner_seeds"]
        searched = f"{seeds} sets of searches" if seeds > 1 else "one set of searches"
        if self._table.users_simulator:
            samples, simulator = self._table.samples, self.settings["model"]["simulator"]
            searched = f"by {f'{samples} samples' if samples else 'the density'} of {simulator}"
        return f"{self.event_id}: closed loop, {found['frames']} frames; all hypotheses, {searched}"

    def _body(self, found: Mapping[str, Any]) -> list[str]:
        cost, told = self.cost, [*self._notes(), *answer_lines(self, levels=self._table.levels), ""]
        if changed := changed_text(self.settings):
            told += wrapped("prior", changed)
        counted = ", not tempered" if self.tempering else ""
        if (strengths := self._strength_weight) != 1:
            counted = f", not tempered for goals; for strengths a frame counts {strengths:g}"
        value = self.log_evidence
        density = str(value) if value.error > 0 else f"{value:.1f}"
        evidence = f"the log density of the video is {density} nats{counted}"
        told += wrapped("evidence", evidence)
        if self.tempering:
            told += wrapped("weight", f"{self.tempering} in the probabilities above")
        steps = max(1, self._table.n_frames - 1)  # it was paid for all frames, counted or not
        what = "calls" if self._table.users_simulator else "searches"
        sets = found["planner_seeds"] if what == "searches" else 1
        by = f" by {sets} sets" if sets > 1 else ""
        words = f"{cost[what]} {what}{by} in {steps} steps"
        if isinstance(cost.get("seconds"), int | float):
            words += f", in {cost['seconds']:.1f} s (the film: {cost['video_seconds']:.1f} s)"
        return [*told, *wrapped("cost", words)]

    def _notes(self) -> list[str]:
        """Return what is to be said of hypotheses that were drawn."""
        table = self._table
        if not table.sampled:
            return []
        n = kish_size(table.weights(self._frame)[0])
        return wrapped(
            "hypotheses",
            f"of {table.prior.n_hypotheses:.2g} hypotheses {MOST_HYPOTHESES} were drawn, worth "
            f"{n:.0f} of equal weight: probabilities are Monte-Carlo means with standard errors of "
            f"up to {0.5 / n**0.5:.1g}, beside those shown",
        )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.event_id} after frame {self._frame}>"
