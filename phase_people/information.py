"""Expected information of people's answers about which of several models is right.

A model predicts the probability of each answer to a question about an event. If people answer as
one of several models does, their answers tell which. The expected information is the mutual
information between model and answers; for one answer it is the Jensen-Shannon divergence of the
models' predictions. It is at most the entropy of the prior over models: log M for M equally
probable ones.
"""

from __future__ import annotations

import dataclasses
import functools
import html
import itertools
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

import phase_ppl as ppl

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray: TypeAlias = NDArray[np.float64]

SCHEMA: Final = "phase-ppl-design-1"

LAPSE: Final = 0.05  # probability of an answer at random, so that no answer is impossible
DRAWS: Final = 4000  # of a model and its answers to all events, for information of several events
_CHOOSING, _ESTIMATING = slice(0, None, 2), slice(1, None, 2)
_OUTCOMES: Final = 2000  # most outcomes that are summed exactly
_REPLICATES: Final = 40  # draws of the models' probabilities within their errors
_LISTED: Final = 20
_RANDOM_SETS: Final = 100

_NAME: Final = 32  # most characters of an id in a figure
_INK, _GREY, _BLUE, _PALE_BLUE = "#222222", "#666666", "#0072b2", "#56a0d3"
_SMALL, _NORMAL = 7.5, 8.5  # font sizes, points


def _titled(axes: Axes, title: str, note: str) -> None:
    """Write a title, and a smaller note between it and the axes."""
    axes.set_title(title, pad=15)
    place: dict[str, Any] = {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "annotation_clip": False,
    }
    axes.annotate(note, (0, 1), (0, 4), color=_GREY, **place)


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """How much people's answers about events are expected to tell which of several models is right.

    :func:`phase_ppl.design` returns one. Printed it is a table; :meth:`plot` draws it. Information
    is in nats.

    Attributes:
        probabilities: (model, event, answer) probability that a model gives to an answer about an
            event; over answers they sum to 1. The coordinate ``error`` (model, event, answer) has
            their Monte-Carlo errors; NaN: unknown.
        question: the question asked, such as "relation".
        answers: number of people who are asked about each event.
        lapse: probability that a person answers at random.
        prior: (model,) prior probability of each model, sum 1.
        seed: seed of the simulated answers that estimate joint information.
    """

    probabilities: xr.DataArray
    question: str
    answers: int
    lapse: float
    prior: FloatArray
    seed: int

    @functools.cached_property
    def models(self) -> list[str]:
        """Names of the models."""
        return list(map(str, self.probabilities["model"].values))

    @functools.cached_property
    def events(self) -> list[str]:
        """Ids of the events, in the order in which they were given."""
        return list(map(str, self.probabilities["event"].values))

    @functools.cached_property
    def labels(self) -> list[str]:
        """The possible answers to the question."""
        return list(map(str, self.probabilities["answer"].values))

    @property
    def most(self) -> float:
        """The largest possible information, in nats: the entropy of the prior over models."""
        return float(-(self.prior * np.log(self.prior)).sum())

    # --- single events -------------------------------------------------------------------------

    @functools.cached_property
    def _log_shares(self) -> FloatArray:
        return self._with_lapses(self.probabilities.values)

    def _with_lapses(self, probabilities: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            n = probabilities.shape[-1]
            return np.asarray(np.log((1 - self.lapse) * probabilities + self.lapse / n))

    @functools.cached_property
    def information(self) -> xr.DataArray:
        """(event,) expected information of each event's answers on which model is right, in nats.

        The coordinate ``error`` has its standard error, from the errors of the models'
        probabilities; NaN if any of these is unknown. Errors make models look more different than
        they are. So information no larger than its error shows nothing.
        """
        n, people = len(self.labels), self.answers
        summed = math.comb(people + n - 1, n - 1) <= _OUTCOMES
        values = (
            self._summed(self._log_shares, people) if summed else self._expected(self._simulated)[0]
        )
        errors = self.probabilities["error"].values
        known = ~np.isnan(errors).any(axis=(0, 2))
        rng = np.random.default_rng(self.seed)
        replicates = []
        for _ in range(_REPLICATES):
            noise = rng.standard_normal(errors.shape) * np.nan_to_num(errors)
            shares = np.maximum(self.probabilities.values + noise, 0.0) + 1e-12
            logs = self._with_lapses(shares / shares.sum(axis=-1, keepdims=True))
            replicates.append(self._summed(logs, people if summed else 1))
        spread = np.std(replicates, axis=0) * (1 if summed else people)
        coords = {"event": self.events, "error": ("event", np.where(known, spread, np.nan))}
        return xr.DataArray(values, coords, dims="event", name="information")

    def _summed(self, log_shares: FloatArray, answers: int) -> FloatArray:
        """Return (event,) information of answers to each event alone, over all outcomes."""
        counts = _compositions(answers, log_shares.shape[-1])
        ways = gammaln(answers + 1) - gammaln(counts + 1).sum(axis=1)
        # an impossible answer has count 0
        safe = np.maximum(log_shares, -1e300)
        logs = np.einsum("oa,mea->oem", counts, safe) + ways[:, None, None]
        log_joint = logs + np.log(self.prior)
        log_outcome = logsumexp(log_joint, axis=-1)
        share = np.exp(log_joint - log_outcome[..., None])
        with np.errstate(divide="ignore", invalid="ignore"):
            of_outcome = -np.where(share > 0, share * np.log(share), 0.0).sum(axis=-1)
        return np.maximum(self.most - (np.exp(log_outcome) * of_outcome).sum(axis=0), 0.0)

    @property
    def table(self) -> pd.DataFrame:
        """A row per event, the most informative first.

        Columns: ``information`` and its ``error``, in nats; ``share``, the information divided by
        :attr:`most`; and a column per model: its most probable answer with the probability, as
        text.
        """
        table = self.information.to_dataframe()[["information", "error"]]
        table["share"] = table["information"] / self.most
        for model, answers in zip(self.models, self.probabilities.values, strict=True):
            table[model] = [f"{self.labels[row.argmax()]} {row.max():.2f}" for row in answers]
        return table.sort_values("information", ascending=False, kind="stable")

    # --- sets of events ------------------------------------------------------------------------

    @functools.cached_property
    def _models_drawn(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        places = (np.arange(DRAWS) + 0.5) / DRAWS
        return np.searchsorted(self.prior.cumsum()[:-1], places).astype(np.int64)

    @functools.cached_property
    def _simulated(self) -> FloatArray:
        """(draw, event, model) log likelihoods of the answers that the drawn models give."""
        found = np.empty((DRAWS, len(self.events), len(self.prior)))
        rng = np.random.default_rng(self.seed)
        for event in range(len(self.events)):
            logs = self._log_shares[:, event]
            counts = rng.multinomial(self.answers, np.exp(logs)[self._models_drawn])
            found[:, event] = counts @ np.maximum(logs, -1e300).T
        return found

    def _expected(self, logs: FloatArray, which: slice = slice(None)) -> FloatArray:
        """Return information (...), its error, and how often the right model leads.

        ``logs`` are log likelihoods (draw, ..., model); ``which`` selects draws.
        """
        log_joint = logs[which] + np.log(self.prior)
        best = log_joint.max(axis=-1, keepdims=True)
        models = self._models_drawn[which].reshape(-1, *[1] * (log_joint.ndim - 1))
        right = np.take_along_axis(log_joint, models, axis=-1)[..., 0] - best[..., 0]
        total = np.log(np.exp(log_joint - best).sum(axis=-1))
        # the mean log of the right model's posterior over its prior: unbiased
        before = np.log(self.prior)[models[..., 0]]
        nats = np.maximum(right - total, -700.0) - before
        ties = (log_joint > best - 1e-9).sum(axis=-1)
        leads = np.where(right > -1e-9, 1 / ties, 0.0)
        error = nats.std(axis=0) / math.sqrt(len(nats))
        return np.array([nats.mean(axis=0), error, leads.mean(axis=0)])

    def joint(self, events: Iterable[str]) -> ppl.Estimate:
        """Return the joint information of answers about several events, in nats, with its error.

        Args:
            events: ids of the events. An event that is named twice counts once.

        Raises:
            UnknownNameError: there is no such event.
        """
        places = [self._place(event) for event in dict.fromkeys(events)]
        value, error, _ = self._expected(self._simulated[:, places].sum(axis=1))
        return ppl.Estimate(float(value), float(error))

    def _place(self, event: str) -> int:
        ppl.errors.check_name("event", event, self.events)
        return self.events.index(event)

    def best(self, n: int) -> pd.DataFrame:
        """Return the events to ask about, chosen one by one to add the most information.

        The choice is greedy. It uses one half of 4000 simulations, each of a model and people's
        answers to all events. The other half estimates the columns.

        Args:
            n: number of events, at least 1.

        Returns:
            A row per event, in the order of choice. ``information``: joint information of the
            answers about this event and those chosen before it, in nats, with its ``error``.
            ``share``: the information divided by :attr:`most`. ``right``: how often, given these
            answers, the most probable model is the one by which people answer.
        """
        n = min(ppl.errors.whole_number("n", n), len(self.events))
        logs = np.zeros((DRAWS, len(self.prior)))
        rows, left = [], list(range(len(self.events)))
        for _ in range(n):
            found = self._expected(logs[:, None] + self._simulated[:, left], _CHOOSING)[0]
            place = left.pop(int(np.argmax(found)))
            logs += self._simulated[:, place]
            rows.append((self.events[place], *self._expected(logs, _ESTIMATING)))
        table = pd.DataFrame(rows, columns=["event", "information", "error", "right"])
        table.insert(3, "share", table["information"] / self.most)
        return table.set_index("event")

    def at_random(self, n: int) -> pd.DataFrame:
        """Return the joint information of the first 1 to ``n`` events of a random order.

        Returns:
            A row per number of events, over 100 random orders: ``information``, the mean joint
            information in nats; ``low`` and ``high``, its 5 % and 95 % quantiles; ``right``, how
            often the most probable model is the one by which people answer.
        """
        n = min(ppl.errors.whole_number("n", n), len(self.events))
        rng = np.random.default_rng(self.seed)
        found = np.empty((_RANDOM_SETS, n, 2))
        for order in range(_RANDOM_SETS):
            places = rng.permutation(len(self.events))[:n]
            logs = self._simulated[:, places].cumsum(axis=1)
            found[order] = self._expected(logs, _ESTIMATING)[[0, 2]].T
        low, high = np.quantile(found[..., 0], (0.05, 0.95), axis=0)
        mean = found.mean(axis=0)
        columns = {"information": mean[:, 0], "low": low, "high": high, "right": mean[:, 1]}
        return pd.DataFrame(columns, index=pd.RangeIndex(1, n + 1, name="events"))

    def attributed(
        self, answers: Mapping[str, str | Sequence[str] | Mapping[str, int]]
    ) -> dict[str, float]:
        """Return model -> its posterior probability given people's answers.

        Args:
            answers: event id -> one answer, a list of answers, or a mapping answer -> number of
                people.

        Raises:
            UnknownNameError: there is no such event or answer.
            InvalidSettingError: these answers are impossible under all models.
        """
        labels, log_mass = self.labels, np.log(self.prior)
        for event, given in answers.items():
            place = self._place(event)
            counted = given if isinstance(given, Mapping) else {}
            for answer in counted or ([given] if isinstance(given, str) else given):
                ppl.errors.check_name("answer", answer, labels)
                if times := counted.get(answer, 1):  # answers that nobody gave may be impossible
                    log_mass = log_mass + times * self._log_shares[:, place, labels.index(answer)]
        if np.isneginf(log_mass).all():
            raise ppl.errors.InvalidSettingError("no model can give these answers, without lapses")
        shares = np.exp(log_mass - logsumexp(log_mass))
        return dict(zip(self.models, shares.tolist(), strict=True))

    # --- a figure, files and print ---------------------------------------------------------------

    @ppl.plot.in_style
    def plot(self, path: str | os.PathLike[str] | None = None, *, n: int = 12) -> Figure:
        """Draw the information of each event, and the joint information of the best events.

        Left is the expected information of the most informative events, with its error if known.
        Right is the joint information of the first 1 to ``n`` events of :meth:`best` (blue), and of
        as many random events (grey: mean and 90 % of 100 orders). The dotted line is :attr:`most`.
        The figure is 8 inches wide; matplotlib's ``pyplot`` does not know it.

        Args:
            path: file to write the figure to as well, ending in .png, .pdf or .svg.
            n: largest number of events in either panel.

        Raises:
            OutputError: ``path`` cannot be written, or has another ending.
        """
        table = self.table.head(n)
        figure = ppl.plot.new_figure(8.0, max(2.6, 1.1 + 0.2 * len(table)))
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        places = np.arange(len(table))[::-1]
        error = {"xerr": table["error"], "error_kw": {"ecolor": _INK, "elinewidth": 1}}
        left.barh(places, table["information"], 0.62, color=_PALE_BLUE, **error)
        people = "an answer" if self.answers == 1 else f"{self.answers} answers"
        note = f"expected information of {people} about the {self.question}"
        _titled(left, "Events that tell models apart", note)
        left.set_xlabel("nats")
        left.set_yticks(places, [name[:_NAME] for name in table.index], fontsize=_SMALL)
        left.set_xlim(left=0)

        chosen, random = self.best(n), self.at_random(n)
        counts = np.arange(1, len(chosen) + 1)
        right.axhline(self.most, color=_GREY, lw=0.8, ls=":")
        end = {"color": _GREY, "va": "bottom", "ha": "right"}
        right.text(len(chosen), self.most, "all that can be known", **end)
        right.fill_between(counts, random["low"], random["high"], color=_GREY, alpha=0.16, lw=0)
        right.plot(counts, random["information"], color=_GREY, lw=1.6)
        right.plot(counts, chosen["information"], "o-", ms=3, color=_BLUE, lw=1.8)
        middle = len(counts) // 2
        for text, y, colour, side, up in (
            ("chosen", chosen["information"], _BLUE, "bottom", 5),
            ("by chance", random["information"], _GREY, "top", -7),
        ):
            style: dict[str, Any] = {
                "ha": "center",
                "va": side,
                "fontsize": _NORMAL,
                "color": colour,
            }
            at = counts[middle], y.iloc[middle]
            right.annotate(text, at, (0, up), textcoords="offset points", **style)
        _titled(right, "Several events together", f"between {', '.join(self.models)}"[:64])
        right.set(xlabel="events", ylabel="nats", ylim=(0, self.most * 1.12))
        right.set_xticks(counts[:: max(1, len(counts) // 6)])
        right.grid(axis="y")
        return ppl.plot.written(figure, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a .json file, from which :meth:`load` reads it.

        Raises:
            OutputError: the file cannot be written, or its name does not end in .json.
        """
        errors = self.probabilities["error"].values
        none = np.full(errors.shape, None)  # for unknown values
        record = {
            "schema": SCHEMA,
            "question": self.question,
            "answers": self.answers,
            "lapse": self.lapse,
            "seed": self.seed,
            "prior": self.prior.tolist(),
            "models": self.models,
            "events": self.events,
            "labels": self.labels,
            "probabilities": self.probabilities.values.tolist(),
            "errors": np.where(np.isfinite(errors), errors, none).tolist(),
        }
        ppl.files.write_json(path, record)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Design:
        """Read a design from a file that :meth:`save` wrote.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        record = ppl.read_json(path)
        if record.get("schema") != SCHEMA:
            raise ppl.errors.InvalidEventError(
                f"{path}: its schema is {record.get('schema')!r}, not {SCHEMA}"
            )
        try:
            dims = ("model", "event", "answer")
            coords = {dim: record[f"{dim}s"] for dim in dims[:2]} | {"answer": record["labels"]}
            coords["error"] = dims, np.array(record["errors"], np.float64)
            return checked(
                xr.DataArray(np.array(record["probabilities"], np.float64), coords, dims=dims),
                str(record["question"]),
                answers=record["answers"],
                lapse=record["lapse"],
                prior=dict(zip(record["models"], record["prior"], strict=True)),
                seed=record["seed"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ppl.errors.InvalidEventError(f"{path} is damaged: {error}") from None

    def __str__(self) -> str:
        people = "one answer" if self.answers == 1 else f"{self.answers} answers"
        head = (
            f"{self.question} of {len(self.events)} events, {people} about each, between "
            f"{', '.join(self.models)}\nat most {self.most:.2f} nats can be known; somebody "
            f"answers at random with probability {self.lapse:g}\n"
        )
        table = self.table.head(_LISTED)
        text = table.to_string(float_format=lambda number: f"{number:.3f}", na_rep="unknown")
        rest = len(self.events) - len(table)
        return f"{head}\n{text}" + (f"\n... and {rest} less telling ones" if rest else "")

    def _repr_html_(self) -> str:
        return f'<pre style="line-height:1.25">{html.escape(str(self))}</pre>'

    def __repr__(self) -> str:
        return f"<Design: {self.question} of {len(self.events)} events, {len(self.models)} models>"


def checked(
    probabilities: xr.DataArray,
    question: str,
    *,
    answers: int = 1,
    lapse: float = LAPSE,
    prior: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Design:
    """Return a design of (model, event, answer) probabilities; errors as in ``ppl.design``."""
    models = [str(name) for name in probabilities["model"].values]
    if len(models) < 2:
        raise ppl.errors.InvalidSettingError(
            f"models={ppl.errors.shown(models)}, expected at least two to compare"
        )
    if isinstance(lapse, bool) or not 0 <= lapse < 1:
        raise ppl.errors.InvalidSettingError(
            f"lapse={ppl.errors.shown(lapse)}, expected a number in [0, 1)"
        )
    weights = np.ones(len(models))
    if prior is not None:
        for name in prior:
            ppl.errors.check_name("model in prior", name, models)
        weights = np.array([float(prior.get(name, 0.0)) for name in models])
        if not (np.isfinite(weights).all() and (weights > 0).all()):
            raise ppl.errors.InvalidSettingError(
                f"prior={ppl.errors.shown(dict(prior))}, expected a positive number for every model"
            )
    return Design(
        probabilities,
        question,
        ppl.errors.whole_number("answers", answers),
        float(lapse),
        weights / weights.sum(),
        ppl.errors.whole_number("seed", seed, minimum=0),
    )


@functools.lru_cache(8)
def _compositions(total: int, parts: int) -> FloatArray:
    """Return (outcome, part) all ways in which ``parts`` counts add up to ``total``."""
    bars = itertools.combinations(range(total + parts - 1), parts - 1)
    edges = np.array([(-1, *places, total + parts - 1) for places in bars])
    return np.diff(edges, axis=1).astype(np.float64) - 1
