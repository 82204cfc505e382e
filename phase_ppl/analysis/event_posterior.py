"""Common methods of both posteriors of an event: files, ArviZ, priors, what-ifs, predictions."""

from __future__ import annotations

import contextlib
import functools
import json
import os
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import Estimate, kish_size, shares
from phase_ppl.analysis.hypotheses import KEPT_DEFINITIONS, Hypotheses, with_errors
from phase_ppl.analysis.quantities import Quantity, Vocabulary
from phase_ppl.analysis.query import conditions, defined
from phase_ppl.analysis.tree import FRAME, kept_scene, scene_dataset
from phase_ppl.analysis.verdict import as_html, verdict_lines
from phase_ppl.analysis.weights import Rows
from phase_ppl.analysis.with_arviz import NO_LOO, arviz_groups, draws_of, resampled
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, QueryError, shown
from phase_ppl.world.event import FRAMES_PER_SECOND, MIN_FRAMES, Observation
from phase_ppl.world.files import check_output, write_bytes
from phase_ppl.world.goals import GOALS
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.picture import bars, plain, preformatted, wrapped
from phase_ppl.world.scene import Scene, World

if TYPE_CHECKING:
    from phase_ppl.analysis.what_if import WhatIf
    from phase_ppl.simulator.contract import Simulator


class EventPosterior(Hypotheses):
    """Base of both posteriors of an event: sampled, and by the closed loop.

    It takes three arguments beside those of :class:`Hypotheses`: the quantities of the event's
    world (``words``), the attributes of the file (``attrs``), and its variables of the scene
    (``constant``).
    """

    def __init__(
        self,
        words: Vocabulary,
        attrs: Mapping[Hashable, Any],
        constant: xr.Dataset,
        quantities: Mapping[str, Quantity],
        rows: Rows,
    ) -> None:
        super().__init__(words.space, quantities, rows)
        self._words, self._attrs, self._constant = words, attrs, constant
        self._define_kept(attrs)

    @property
    def event_id(self) -> str:
        """Id of the event."""
        return str(self._attrs["event_id"])

    @property
    def settings(self) -> dict[str, Any]:
        """All that determined the result: model, likelihood, seed and the rest."""
        return dict(json.loads(self._attrs["settings"]))

    @property
    def cost(self) -> dict[str, Any]:
        """What the run cost: ``simulations`` or ``searches``, ``seconds``, ``workers`` and more."""
        return dict(json.loads(self._attrs["cost"]))

    @property
    def scene(self) -> Scene:
        """The scene of the event: its room, walls and start."""
        return kept_scene(self._constant)

    @property
    def world(self) -> World:
        """The world of the event: its agents, items, landmarks and goals."""
        return self.scene.world

    def map(self) -> Any:
        """Return the most probable hypothesis; its goals are stated goals.

        Returns:
            A :class:`phase_ppl.Hypothesis`.
        """
        raise NotImplementedError

    def map_record(self) -> dict[str, Any]:
        """Return :meth:`map` as a dictionary of plain data.

        In PHASE the keys are ``goal_<agent>`` (effective goals), ``stated_goal_<agent>``, ``alpha``
        and ``strength_<agent>``; in other worlds ``goals``, ``relation`` and ``strengths``, as of
        :meth:`phase_ppl.Hypothesis.to_dict`. A sampled posterior adds ``log_joint``, nats, and the
        labels of relations and scenarios.
        """
        best = self.map()
        record = best.to_dict()
        if "goals" in record:
            return dict(record)
        red, green = best.effective_goals
        return {
            "goal_red": GOALS[red],
            "goal_green": GOALS[green],
            "stated_goal_red": record.pop("goal_red"),
            "stated_goal_green": record.pop("goal_green"),
            **record,
        }

    def observed(self) -> FloatArray:
        """Return the observed trajectory (time, entity, [x, y, angle]), in units and radians."""
        raise NotImplementedError

    def replay(self) -> FloatArray | None:
        """Return (time, entity, [x, y, angle]) the stored simulation of the best hypothesis.

        It is in units and radians. None: the closed loop's posterior has no simulations.
        """
        return None

    @property
    def untried(self) -> float:
        """Prior mass of the combinations of all agents' effective goals that were not simulated.

        A sampled posterior gives these combinations probability 0, however well they may explain
        the video. NaN: the file does not hold their prior. The closed loop tries all hypotheses: 0.
        """
        return 0.0

    @property
    def arviz(self) -> Any:
        """The posterior as equal draws for ArviZ, as in ``az.summary(post.arviz)``.

        If draws count equally (weights ``"count"``), they are the chains after the burn-in. Else
        they are 4 chains of 1000 draws resampled from the weights, with a seed derived from the
        run's. R-hat and effective sizes of resampled draws describe the resampling; :attr:`chains`
        has the original chains.

        The group ``posterior`` has numbers: strengths, real sites and a user's own quantities, and
        ``log_joint`` and ``total_error`` of a sampled posterior. Each label with a probability
        above 2 % has an indicator (0 or 1), whose mean is the label's probability.
        ``observed_data`` and ``constant_data`` have the observation and the scene. There is no
        ``log_likelihood`` for ``az.loo``; the attribute ``loo`` says why. The attributes
        ``weights``, ``effective_size_kish`` (Kish's size of the weights) and ``draws`` describe the
        draws.

        Returns:
            An ``arviz.InferenceData`` for ArviZ before 1, otherwise an :class:`xarray.DataTree`.
        """
        weights, exact = self._rows.weights, self._is_exact
        rows = resampled(weights, int(self.settings.get("seed", 0)), exact=exact)
        size = kish_size(weights)
        what = "probable hypotheses" if exact else f"weighted rows, worth {size:.1f} equal draws"
        how = f"{rows.shape[0]} x {rows.shape[1]} equal draws, resampled from {weights.size} {what}"
        return self._for_arviz(rows, self._beside, how)

    @property
    def chains(self) -> Any:
        """The original chains for ArviZ: ``az.rhat``, ``az.ess``, ``az.plot_trace``.

        Raises:
            InvalidSettingError: the posterior has no chains.
        """
        raise NotImplementedError

    @property
    def _is_exact(self) -> bool:
        """Whether the table has every hypothesis exactly once: nothing was drawn."""
        return False

    @property
    def _weighting(self) -> str:
        """Name of the weighting of hypotheses."""
        raise NotImplementedError

    @property
    def _beside(self) -> dict[str, NDArray[Any]]:
        """Numbers (row,) beside quantities."""
        return {}

    def _for_arviz(
        self,
        rows: NDArray[np.int64],
        beside: Mapping[str, NDArray[Any]],
        how: str,
        *,
        moving: bool = False,
        **groups: xr.Dataset,
    ) -> Any:
        """Return draws (chain, draw) of rows of the table, in ArviZ's form."""
        table, numbers, codes = self._rows, dict(beside), {}
        told = {*self.goals_of.values(), *self.relations_of.values(), *self.scenarios_of.values()}
        for name, quantity in self._quantities.items():
            if quantity.labels is None:
                numbers[name] = table.values[name]
            elif name in told or name not in self._words.quantities:
                size, column = len(quantity.labels), table.values[name]
                codes[name] = quantity, column[rows], shares(column, table.weights, size)
        drawn = {name: column[rows] for name, column in numbers.items()}
        scene, observed = scene_dataset(self.scene), self.observed()
        time = "time", np.arange(len(observed)) / FRAMES_PER_SECOND, {"units": "s"}
        seen = {"time": time, "entity": scene["entity"], "coord": scene["coord"]}
        attrs = {name: value for name, value in self._attrs.items() if name != "schema"}
        attrs |= {"weights": self._weighting, "effective_size_kish": kish_size(table.weights)}
        found = {
            "posterior": draws_of(drawn, codes, moving=moving),
            "observed_data": xr.Dataset({"trajectory": (FRAME, observed)}, seen),
            "constant_data": scene,
            **groups,
        }
        return arviz_groups(found, {**attrs, "draws": how, "loo": NO_LOO})

    @property
    def tempering(self) -> str:
        """The weight of a frame as evidence, in words; "": it counts in full, as far as known."""
        raise NotImplementedError

    def over_time(self) -> xr.Dataset:
        """Return (time, label) the probabilities of goals, relations and scenario at every frame.

        For a sampled posterior they are in hindsight; the attribute ``hindsight`` says so.
        """
        raise NotImplementedError

    def why(self, event: str, over: str | None = None) -> xr.Dataset:
        """Return the log odds of ``event`` by frame: which frames are evidence for it.

        Args:
            event: conditions in words, such as ``"goal_red=get to green agent"`` or
                ``"strength_red > strength_green, not relation=friendly"``
                (:mod:`phase_ppl.analysis.query`).
            over: conditions to compare with; by default that ``event`` is false.

        Returns:
            Three variables (time,), in nats. ``log_odds``: log odds of ``event`` over ``over``
            given the frames so far, in hindsight for a sampled posterior (see :meth:`over_time`).
            ``error``: its standard error, by the jackknife over sets of searches; NaN: unknown, as
            always for a sampled posterior.
            ``change``: by how much each frame changes ``log_odds``. The attribute ``tempering``
            says what a frame counts.

        Raises:
            QueryError, UnknownNameError: the conditions cannot be read, or name something unknown.
            InvalidSettingError: ``event`` or ``over`` is impossible, or was never simulated.
        """
        raise NotImplementedError

    def _sides(
        self, table: Mapping[str, NDArray[Any]], event: str, over: str | None
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the rows of a table in which ``event`` is true, and those in which ``over`` is."""
        columns = dict(self._words.completed(table))
        known = {n: one for n, one in self._quantities.items() if n in columns}
        for name, definition in self._defined.items():
            with contextlib.suppress(QueryError):  # the table may lack a quantity of the definition
                known[name], columns[name] = defined(name, definition, known, columns)
        wanted = conditions(known, event).holds(columns)
        return wanted, ~wanted if over is None else conditions(known, over).holds(columns)

    def _odds(
        self, odds: FloatArray, error: FloatArray, event: str, over: str | None, **attrs: str
    ) -> xr.Dataset:
        """Return log odds (time,) and their errors as the dataset of :meth:`why`."""
        time = np.arange(len(odds)) / FRAMES_PER_SECOND
        columns = {"log_odds": odds, "error": error, "change": np.diff(odds, prepend=odds[0])}
        said = {"event": event, "over": over or f"not {event}", "tempering": self.tempering}
        coords = {"time": ("time", time, {"units": "s"})}
        found = {name: ("time", column) for name, column in columns.items()}
        return xr.Dataset(found, coords, {**said, **attrs})

    def _along_time(
        self, time: FloatArray, tables: Mapping[str, FloatArray], **attrs: str
    ) -> xr.Dataset:
        """Return tables (time, label) of quantities, and of their ``_error``, as one dataset."""
        known = self._words.quantities
        of = {name: name if name in known else name.removesuffix("_error") for name in tables}
        labels = {f"{one}_is": list(known[one].categories()) for one in of.values()}
        found = {name: (("time", f"{of[name]}_is"), table) for name, table in tables.items()}
        return xr.Dataset(found, {"time": ("time", time, {"units": "s"}), **labels}, attrs)

    def diagnostics(self) -> dict[str, Any]:
        """Return diagnostics: numbers, and a verdict on whether to trust the posterior.

        They include ``trust`` ("confident", "not certain", "do not trust"), ``answer``, ``checks``,
        ``next`` (what to do) and ``verdict``.
        """
        raise NotImplementedError

    def _head(self, found: Mapping[str, Any]) -> str:
        """Return a heading in one line, given the diagnostics."""
        raise NotImplementedError

    def _body(self, found: Mapping[str, Any]) -> list[str]:
        """Return the lines of a table of all answers and their cost."""
        raise NotImplementedError

    def __str__(self) -> str:
        found = self.diagnostics()
        head = wrapped("posterior", self._head(found))
        return "\n".join([*head, *verdict_lines(found), "", *self._body(found)])

    def _repr_html_(self) -> str:
        found = self.diagnostics()
        head = wrapped("posterior", self._head(found))
        return as_html(found) + preformatted("\n".join([*head, "", *self._body(found)]))

    def summary(self) -> dict[str, Any]:
        """Return the posterior in JSON's types; numbers that do not exist are None.

        Keys: ``goals`` (agent -> goal -> probability), ``relation`` and ``scenario`` (label ->
        probability), ``strengths`` (agent -> mean, sd, hdi_low, hdi_high in newtons), ``errors``
        (the errors of all these, in the same form), ``map``, ``diagnostics``, ``settings``,
        ``cost``. The closed loop's posterior also has ``log_evidence`` (nats) and ``frame``.
        """
        record = {**answers(self), "map": self.map_record(), **self._judged()}
        return dict(plain({**record, "settings": self.settings, "cost": self.cost}))

    def _judged(self) -> dict[str, Any]:
        """Return what a summary has of the posterior as a whole."""
        return {"diagnostics": self.diagnostics()}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the posterior to ``path`` as NetCDF, whole or not at all.

        What is in use becomes the file's default: weighting and burn-in, or the last frame that
        counts. Definitions in words are kept.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .nc.
        """
        check_output(path, (".nc",))
        from phase_ppl.data.hdf5 import netcdf_bytes

        groups, packing = self._to_keep()
        attrs = {k: v for k, v in groups["/"].attrs.items() if k != KEPT_DEFINITIONS}
        groups["/"].attrs = attrs | self._definitions_to_keep()
        # every array has a checksum, so reading notices a damaged file
        how = {"fletcher32": True, **packing}
        write_bytes(path, (".nc",), netcdf_bytes(groups, how, sealed=True))
        return Path(path)

    def _to_keep(self) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
        """Return the groups of a file by path, the root's own to change, and how to pack them."""
        raise NotImplementedError

    def with_prior(self, prior: Callable[..., object] | str) -> Self:
        """Return the posterior under another prior; nothing is simulated or searched again.

        The closed loop's posterior has all hypotheses, so the result equals a new run, with one
        exception. The old prior chose which pairs of goals got all searches; for other pairs errors
        are too small. A sampled posterior is reweighted by the ratio of the priors over its
        simulations. The result's ``settings`` then have the effective size, which is also printed.

        Args:
            prior: NumPyro program over the sites of a hypothesis, or the name of a ready-made prior
                (:func:`phase_ppl.priors.available`). A prior that looks at the video sees all
                frames that were read.

        Raises:
            InvalidSettingError: ``prior`` is no prior, or too few of the hypotheses that it makes
                probable were simulated.
            UnknownNameError: there is no such prior.
        """
        return self.under(self._checked(prior))

    def _checked(self, prior: Callable[..., object] | str) -> Callable[..., object]:
        """Return a prior, by its name or itself; errors as of a model."""
        from phase_ppl.models.model import Model

        return Model(prior=prior).in_world(self.scene, self._video).prior

    def bound(self, prior: Callable[..., object]) -> Callable[..., Any]:
        """Return a prior bound to the scene and the frames read, where it asks for them."""
        from phase_ppl.models.world_priors import bound

        return bound(prior, self.scene, self._video)

    @property
    def _video(self) -> Observation | None:
        """What was read; None: the start only."""
        seen = self.observed()
        return Observation(seen) if len(seen) >= MIN_FRAMES else None

    def under(self, prior: Callable[..., object]) -> Self:
        """Return the same as :meth:`with_prior`, without its check of the prior, which is slow."""
        raise NotImplementedError

    def sensitivity(
        self, question: str, prior: Callable[..., object], values: Iterable[float]
    ) -> xr.DataArray:
        """Return the answer to a question as an argument of the prior varies.

        Args:
            question: question with numbers as answer, such as ``"P(relation)"``,
                ``"P(relation=friendly)"`` or ``"E[strength_red]"``.
            prior: NumPyro program of one argument, a number; compare ``ppl.priors.relation_first``.
            values: values of that argument.

        Returns:
            The answers, an array with the dim ``value``, with their ``error``.

        Example:
            ``post.sensitivity("P(relation)", related, [0.1, 0.5, 0.9])`` with
            ``def related(p): ...`` that samples ``alpha`` and the rest.

        Raises:
            InvalidSettingError: too little was simulated for a prior, or the answer is no number.
            QueryError: the question cannot be answered, as in :meth:`query`.
        """
        if not callable(prior):
            raise InvalidSettingError(
                f"prior={shown(prior)}: expected a NumPyro program of one argument, the number "
                "that is varied"
            )
        at = [float(value) for value in values]
        if not at:
            raise InvalidSettingError("values is empty: expected numbers")
        # the check is slow, and one value is enough
        self._checked(functools.partial(prior, at[0]))
        answers = []
        for value in at:
            answer = self.under(functools.partial(prior, value)).query(question)
            if isinstance(answer, Estimate):
                answer = xr.DataArray(float(answer), {"error": answer.error})
            if not isinstance(answer, xr.DataArray):
                raise InvalidSettingError(
                    f"{question!r} is answered by {type(answer).__name__}, which makes no curve: "
                    "expected a question with numbers as answer, such as P(relation)"
                )
            answers.append(answer)
        found = xr.concat(answers, "value", join="override").assign_coords(value=at)
        return found.assign_attrs(question=question, prior=qualified_name(prior))

    def do(
        self,
        *,
        alpha: tuple[int, int] | None = None,
        relation: Mapping[tuple[str, str], str] | None = None,
        remove: str | Sequence[str] = (),
        walls: Any = None,
        at: int | None = None,
        seconds: float | None = None,
        n: int = 16,
        seed: int = 0,
        workers: int | None = None,
        simulator: Simulator | None = None,
        **changed: Any,
    ) -> WhatIf:
        """Return simulations of a counterfactual change, beside simulations without it.

        Hypotheses are drawn from the posterior. Each is simulated twice with the same seed: as it
        is, and with the change. Without a change, each is simulated once.

        Args:
            alpha: who helps or hinders whom in PHASE, one of ``ppl.ALPHAS``: (red towards green,
                green towards red), 1 to help, -1 to hinder, 0 for neither.
            relation: who helps or hinders whom in any world: (who, whom) -> "help" or "hinder".
                Pairs that are left out do neither. An agent that no longer helps or hinders pursues
                its own goal; in other worlds than PHASE this is drawn from the prior.
            remove: name of an entity to remove, or several, such as ``"green agent"``.
            walls: (n, 2, 2) end points of the inner walls, in units; an empty list: no walls.
            at: frame of the change; agents know what they saw until then. Default: the start.
            seconds: simulated seconds from that frame; by default to the end of the video.
            n: number of hypotheses, at least 2.
            seed: seed of draws and simulations, a whole number >= 0.
            workers: number of processes; by default one per usable core.
            simulator: the simulator; needed if the run had a simulator of your own.
            **changed: ``goal_<agent>``: the effective goal of that agent, as in
                ``goal_red="get to green agent"``; the other agents know it and keep their goals.
                ``stated_goal_<agent>``: its stated goal; agents that help or hinder it follow.
                ``strength_<agent>``: its strength in newtons.

        Returns:
            A :class:`phase_ppl.analysis.what_if.WhatIf` of all simulations. ``print`` shows how
            often and when each agent reaches its goal, with the change and without it. It also says
            whether that differs by more than chance (sign test of the pairs of simulations).

        Example:
            ``print(post.do(remove="green agent"))``

        Raises:
            InvalidSettingError: a value cannot be used; ``simulator`` is needed; or the simulator
                cannot do this: ``at`` and ``remove`` are for the joint simulator.
            UnknownNameError: there is no such entity, goal or quantity.
        """
        from phase_ppl.analysis.what_if import Change, simulated

        change = Change.of(self.world, changed, alpha, relation, remove, walls)
        own = self._constant.get("log_prior_goals")
        own_goals = None if own is None else np.exp(own.values)
        how = (at, seconds, n, seed, workers, simulator)
        return simulated(self, own_goals, change, *how)

    def predict(
        self, seconds: float = 2.0, *, n: int = 16, seed: int = 0, workers: int | None = None
    ) -> WhatIf:
        """Return the posterior predictive: simulations of what follows the last frame.

        Args:
            seconds: simulated seconds after the last frame.
            n: number of hypotheses drawn from the posterior, each simulated once; at least 2.
            seed: seed of draws and simulations, a whole number >= 0.
            workers: number of processes; by default one per usable core.

        Returns:
            A :class:`phase_ppl.analysis.what_if.WhatIf` with a single world, "as it is".

        Example:
            ``post.at(40).predict(2).tracks.mean("simulation")``, for the closed loop's posterior

        Raises:
            InvalidSettingError: a value cannot be used, or the run had a simulator of your own.
        """
        last = len(self.observed()) - 1
        return self.do(at=last, seconds=seconds, n=n, seed=seed, workers=workers)


# --- what a table of hypotheses says, all at once -------------------------------------------------


def answers(of: Hypotheses) -> dict[str, Any]:
    """Return ``goals``, relations, scenario and ``strengths``, and the ``errors`` of each."""
    goals = {agent: dict(with_errors(of.marginal(name))) for agent, name in of.goals_of.items()}
    found: dict[str, Any] = {"goals": goals}
    for name in (*of.relations_of.values(), *of.scenarios_of.values()):
        found[name] = dict(with_errors(of.marginal(name)))
    found["strengths"] = {}
    for agent, name in of.strengths_of.items():
        (_, low), (_, high) = with_errors(of.hdi(name))
        numbers = {"mean": of.mean(name), "sd": of.sd(name)}
        found["strengths"][agent] = {**numbers, "hdi_low": low, "hdi_high": high}
    return {**_of_each(found, float), "errors": _of_each(found, lambda one: one.error)}


def answer_lines(
    of: Hypotheses,
    untried: Callable[[str], frozenset[str]] = lambda name: frozenset(),
    levels: Sequence[float] = (),
) -> list[str]:
    """Return the lines of a table about goals, relations, scenario and strengths.

    ``untried`` returns the labels of a quantity that nothing was simulated for. ``levels`` are the
    only strengths that there are, newtons; none: any.
    """
    lines: list[str] = []
    for agent, name in of.goals_of.items():
        lines += bars(agent, _leading(of, name))
    for label, name in (*of.relations_of.items(), *of.scenarios_of.items()):
        without = untried(name)
        lines += bars(label, [(one, None if one in without else p) for one, p in of.top(name, 4)])
    for place, (agent, name) in enumerate(of.strengths_of.items()):
        if levels:
            events: list[dict[str, Any]] = [{name: (level, level)} for level in levels]
            shares = [of.probability(**event) for event in events]
            text = ", ".join(f"{x:g} N ({p:.2f})" for x, p in zip(levels, shares, strict=True))
        else:
            low, high = of.hdi(name).values
            within = f"95 % of the posterior in {low:.0f} to {high:.0f} N"
            text = f"mean, with its error, {of.mean(name)} N; {within}"
        lines += wrapped("" if place else "strength", f"{agent}: {text}")
    return lines


_SHOWN: Final = 3  # goals of an agent that are named
_LITTLE: Final = 0.005  # probability of all others that is not told


def _leading(of: Hypotheses, name: str) -> list[tuple[str, Estimate]]:
    """Return the most probable goals, and all others together."""
    ranked = [entry for entry in of.top(name, len(of.quantities[name] or ())) if entry[1] > 0]
    shown, others = ranked[:_SHOWN], [label for label, _ in ranked[_SHOWN:]]
    event: dict[str, Any] = {name: others}
    if others and (rest := of.probability(**event)) >= _LITTLE:
        shown.append((f"{len(others)} other goal{'s' * (len(others) > 1)}", rest))
    return shown


def _of_each(found: Mapping[str, Any], part: Callable[[Estimate], float]) -> dict[str, Any]:
    """Return a part of every estimate in nested dictionaries."""
    return {
        name: _of_each(one, part) if isinstance(one, dict) else part(one)
        for name, one in found.items()
    }
