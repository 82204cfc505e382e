"""The posterior of the closed-loop likelihood: summed over all hypotheses, at every frame."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.estimate import Jackknife
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.quantities import (
    ScenarioFunction,
    part_codes,
    quantities,
    relation_codes,
)
from phase_ppl.analysis.stepwise_diagnostics import diagnostics
from phase_ppl.analysis.stepwise_table import SCHEMAS, STRENGTHS, Table, brought_up, check, why
from phase_ppl.analysis.summary import answer_lines, answers, plain, wrapped
from phase_ppl.analysis.tree import kept_scene
from phase_ppl.analysis.weights import log_sum_exp
from phase_ppl.dataset.hdf5 import netcdf_bytes, read_netcdf, root_attribute
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.files import check_output, existing_file, write_bytes
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.scene import Scene


def stepwise_summary(post: StepwisePosterior) -> dict[str, Any]:
    """Return ``post`` in JSON's types.

    Keys: ``goals``, ``relation``, ``scenario``, ``strengths``, ``errors`` as of sampled ones;
    ``map``, ``log_evidence`` (nats), ``diagnostics``, ``frame``, ``settings``, ``cost``.
    """
    record = {
        **answers(post),
        "map": post.map_record(),
        "log_evidence": post.log_evidence,
        "diagnostics": post.diagnostics(),
        "frame": post.frame,
        "settings": post.settings,
        "cost": post.cost,
    }
    return {name: plain(value) for name, value in record.items()}


def stepwise_table(post: StepwisePosterior) -> str:
    """Return ``post`` as a table of at most 88 columns."""
    found = post.diagnostics()
    head = f"{post.event_id}: read step by step, {found['frames']} frames; all hypotheses, "
    seeds = found["planner_seeds"]
    head += f"{seeds} sets of searches" if seeds > 1 else "one set of searches"
    lines = [*wrapped("posterior", head), *wrapped("verdict", found["verdict"]), ""]
    lines += [*answer_lines(post), ""]
    lines += wrapped(
        "evidence", f"log p(video) = {post.log_evidence:.1f} nats, every frame counted in full"
    )
    if found["weight"] != 1:
        words = f"in the probabilities above a frame counts {found['weight']:g} (tempered)"
        lines += wrapped("weight", words)
    return "\n".join([*lines, *wrapped("cost", _cost(post.cost, found["frames"]))])


def _cost(cost: dict[str, Any], n: int) -> str:
    words = f"{cost['searches']} searches, {cost['searches'] / max(1, n - 1):.0f} a step"
    if isinstance(cost.get("seconds"), int | float):
        words += f", in {cost['seconds']:.1f} s; the video lasts {cost['video_seconds']:.1f} s"
    return words


# --- the posterior of the closed-loop likelihood: summed over all hypotheses, at every... ---------

FILTERING: Final = (
    "Filtering: what can be believed at each frame from the frames so far; later frames change "
    "nothing of it. Only which way agents can turn, where a reader of a file found that out from "
    "the video, is known from the start."
)
"""Goes with every result over time."""


class StepwisePosterior(Hypotheses):
    """Posterior over all pairs of goals, alphas and strengths, read step by step.

    The sum over hypotheses leaves none out; what goes into it is approximate. Policies are
    estimated by searches: ``.error`` of every answer is the standard error that comes of it, by
    the jackknife over the sets of searches (``planner_seeds``), NaN with one. Velocities, holds
    and strengths come from a filter, and strengths are taken to be independent of the goals given
    the video. Where the likelihood's ``weight`` is not 1, frames count less than they would under
    the model, and likewise for strengths ``Tracking.strength_weight``; the defaults of both, and of
    sharpness and lapse, were chosen on videos (:class:`phase_ppl.StepwiseLikelihood` says which).

    What one can ask it is in :class:`phase_ppl.analysis.hypotheses.Hypotheses`; beside that
    ``over_time``, ``why``, ``log_evidence`` and ``diagnostics``.

    Args:
        found: what was read (:mod:`phase_ppl.analysis.stepwise_table`).
        frame: the posterior given the frames up to this one; by default all.
        scenario: as of :class:`phase_ppl.analysis.posterior.Posterior`.

    Raises:
        InvalidEventError: ``found`` lacks something; the message names it.
        InvalidSettingError: there is no such frame.
    """

    def __init__(
        self,
        found: xr.Dataset,
        frame: int | None = None,
        *,
        scenario: ScenarioFunction | None = None,
    ) -> None:
        found = brought_up(found)
        check(found)
        self._found, self._scenario = found, scenario
        self._table = Table(found)
        self._diagnostics: dict[str, Any] | None = None
        last = self._table.n_frames - 1
        self._frame = last if frame is None else frame
        if not 0 <= self._frame <= last:
            raise InvalidSettingError(f"frame={frame!r}, expected a number in 0..{last}")
        rows = self._table.rows(self._frame)
        columns = dict(rows.values)
        goals = columns["goal_red"], columns["goal_green"]
        columns |= relation_codes(*goals, scenario) | part_codes(*goals)
        super().__init__(quantities(), dataclasses.replace(rows, values=columns))

    def _jackknife(self, share: float) -> Jackknife | None:
        """Leave out single sets of searches, of which there are few, whatever is asked."""
        if 0.0 not in self._jackknives:
            n = self.planner_seeds
            self._jackknives[0.0] = (
                Jackknife(self._table.weights_without(self._frame), n - 1.0) if n > 1 else None
            )
        return self._jackknives[0.0]

    @property
    def planner_seeds(self) -> int:
        """Independent sets of beliefs and searches that were made."""
        return self._table.n_seeds

    @property
    def dataset(self) -> xr.Dataset:
        """What was read."""
        return self._found

    @property
    def event_id(self) -> str:
        """Name of the event that was explained."""
        return str(self._found.attrs["event_id"])

    @property
    def settings(self) -> dict[str, Any]:
        """What determined the result."""
        return dict(json.loads(self._found.attrs["settings"]))

    @property
    def cost(self) -> dict[str, Any]:
        """What it cost: searches, seconds."""
        return dict(json.loads(self._found.attrs["cost"]))

    @property
    def frame(self) -> int:
        """The last frame that is counted."""
        return self._frame

    def at(self, frame: int) -> StepwisePosterior:
        """Return the posterior given the frames up to ``frame`` only.

        Raises:
            InvalidSettingError: there is no such frame.
        """
        return StepwisePosterior(self._found, frame, scenario=self._scenario)

    @property
    def log_evidence(self) -> float:
        """Log p(s_1..t | s_0) of the frames that are counted, in nats, per (unit^8 rad^2) a frame.

        Log sum_h P(h) prod_t p(s_t | s_<t, h), each frame counted in full whatever the
        likelihood's ``weight``. Of two priors, the one with more explains the video better; so of
        two models with the same tracking.
        """
        return log_sum_exp(self._table.log_mass(self._frame, 1.0).ravel())

    def surprise(self) -> FloatArray:
        """Return (time,) nats by which each frame was less probable than a perfect match.

        A perfect match is a frame exactly where an action puts it, were that action certain; what
        was expected is the posterior given the frames before. 0 for the first frame.
        """
        found = self._found["log_peak"].values - self._table.log_predictive()
        return np.asarray(found[: self._frame + 1])

    def diagnostics(self) -> dict[str, Any]:
        """Return whether this can be trusted.

        Keys: ``frames``; ``planner_seeds`` and ``weight``, of the likelihood; ``leading``, the most
        probable goals and relation with their errors; ``surprise_median`` (nats, of
        :meth:`surprise` less what no action explains) and ``surprising_share``, that of frames
        above ``surprise_reference``;
        ``unexplained_most`` and ``unexplained_frames``, which no action explains;
        ``overlapping_frames``, in which bodies lie on each other or in a wall; and ``verdict``, in
        words, the worst sign first.
        """
        if self._diagnostics is None:
            self._diagnostics = diagnostics(self)
        return self._diagnostics

    def map(self) -> Hypothesis:
        """Return the most probable hypothesis; its goals are the stated ones."""
        best = int(self._rows.weights.argmax())
        values = {name: column[best] for name, column in self._rows.values.items()}
        return Hypothesis(
            int(values["stated_goal_red"]),
            int(values["stated_goal_green"]),
            ALPHAS[int(values["alpha"])],
            *(float(values[name]) for name in STRENGTHS),
        )

    def over_time(self) -> xr.Dataset:
        """Return the marginals at every frame, given the frames until then.

        Returns:
            ``goal_red``, ``goal_green``, ``relation``, ``scenario``: probabilities (time, label),
            labels in ``goal_red_is`` and so on; ``time`` in seconds. The attribute ``filtering``
            says what it is: nothing of later frames, but for ``turning`` (which way agents can
            turn) where the scene's was read off a whole video, as the reader of the authors' files
            does.
        """
        masses = self._table.pair_masses()[: self._frame + 1]
        red, green = (codes.ravel() for codes in np.indices((N_GOALS, N_GOALS)))
        codes = {"goal_red": red, "goal_green": green}
        codes |= relation_codes(red, green, self._scenario)
        known = quantities()
        time = self._found["time"].values[: self._frame + 1]
        result = xr.Dataset(
            coords={"time": ("time", time, {"units": "s"})}, attrs={"filtering": FILTERING}
        )
        flat = masses.reshape(len(masses), -1)
        for name, column in codes.items():
            labels = list(known[name].categories())
            table = np.stack([flat[:, column == code].sum(axis=1) for code in range(len(labels))])
            result[name] = (("time", f"{name}_is"), table.T)
            result = result.assign_coords({f"{name}_is": labels})
        return result

    def why(self, event: str, over: str | None = None) -> xr.Dataset:
        """Return which frames speak for ``event``, and against what.

        Args:
            event: such as ``"relation=friendly"`` or ``"goal_red=get to green agent"``; several
                conditions are joined by commas.
            over: what to compare with, likewise; by default that ``event`` is false.

        Returns:
            ``log_odds`` (time,) of one over the other given the frames so far, in nats, and
            ``change`` (time,) by each frame.

        Raises:
            QueryError, UnknownNameError: it cannot be read, or names something unknown.
            InvalidSettingError: one of them is impossible under the prior.
        """
        return why(self._found, self._table, self._frame, event, over, self._scenario)

    @property
    def scene(self) -> Scene:
        """Where the event takes place, and how it starts."""
        return kept_scene(self._found)

    def observed(self) -> FloatArray:
        """Return the trajectory (time, entity, [x, y, angle]) that was explained."""
        return np.asarray(self._found["trajectory"].values, np.float64)[: self._frame + 1]

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything to ``path`` as NetCDF, whole or not at all.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .nc.
        """
        check_output(path, (".nc",))
        how = {"fletcher32": True, "zlib": True, "complevel": 4}
        write_bytes(path, (".nc",), netcdf_bytes({"/": self._found}, how, sealed=True))
        return Path(path)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, scenario: ScenarioFunction | None = None
    ) -> StepwisePosterior:
        """Read a posterior that :meth:`save` wrote.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        source = existing_file(path)
        try:
            return cls(read_netcdf(source)["/"], scenario=scenario)
        except InvalidEventError as error:
            raise InvalidEventError(f"{source}: {error}") from None

    def summary(self) -> dict[str, Any]:
        """Return the posterior as plain data, fit for JSON."""
        return stepwise_summary(self)

    def map_record(self) -> dict[str, Any]:
        """Return :meth:`map` as plain data; ``goal_*`` are the effective goals."""
        best = self.map()
        record = best.to_dict()
        red, green = best.effective_goals
        return {
            "goal_red": GOALS[red],
            "goal_green": GOALS[green],
            "stated_goal_red": record.pop("goal_red"),
            "stated_goal_green": record.pop("goal_green"),
            **record,
        }

    def __str__(self) -> str:
        return stepwise_table(self)

    def __repr__(self) -> str:
        return f"<StepwisePosterior of {self.event_id} after frame {self._frame}>"


def is_stepwise(path: str | os.PathLike[str]) -> bool:
    """Whether a file holds a posterior that was read step by step."""
    return root_attribute(path, "schema") in SCHEMAS
