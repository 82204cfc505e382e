"""Kernels side by side on equal budgets: a table, a curve, a file."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.summary import plain
from phase_ppl.world.errors import InvalidEventError, unknown_name
from phase_ppl.world.files import existing_file, write_json
from phase_ppl.world.picture import preformatted

SCHEMA: Final = "phase-ppl-comparison-1"

MEASURES: Final[Mapping[str, str]] = {
    "tv_goals": "TV goals",
    "tv_relation": "TV relation",
    "p_pair": "P(pair)",
    "p_goals": "P(goals)",
    "p_relation": "P(relation)",
    "map_goals": "goals right",
    "map_relation": "relation right",
    "acceptance": "acceptance",
    "moves": "moves",
    "distinct": "distinct",
    "ess_per_simulation": "ESS per simulation",
    "simulations": "simulations",
    "frames": "frames",
    "seconds": "seconds",
}
"""Measure -> heading; :func:`~phase_ppl.analysis.measures.accuracy` and
:func:`~phase_ppl.analysis.measures.efficiency` say what they are."""

RUN_COLUMNS: Final = ("kernel", "repeat", "seed", "validity", *MEASURES)
CURVE_COLUMNS: Final = ("kernel", "repeat", *list(MEASURES)[:7], "simulations", "frames")

DISTANCES: Final = ("tv_goals", "tv_relation")
"""Measures that are distances from the reference, and as uncertain as it is."""

_PRINTED_COLUMNS: Final = 7


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """What several kernels made of one event under the same budget, over repeats.

    Attributes:
        runs: one row per kernel and repeat: ``kernel`` (its label), ``repeat``, ``seed`` (with
            which ``infer`` makes the same run), ``validity``, and every measure of
            :data:`MEASURES`; NaN where there is none.
        curve: the accuracy of every run after ever more simulations: ``kernel``, ``repeat``,
            ``simulations``, and the measures of accuracy.
        settings: all that determines the result: event, model, kernels with their options,
            budget, chains, seed, weights, and ``reference``: its ``description``, ``marginals``,
            its own ``error`` and what it makes of the truth (``truth``).
    """

    runs: pd.DataFrame
    curve: pd.DataFrame
    settings: Mapping[str, Any]

    @property
    def kernels(self) -> list[str]:
        """Labels of the kernels, in the order in which they were given."""
        return [name for name in self.settings["kernels"] if (self.runs["kernel"] == name).any()]

    @property
    def table(self) -> pd.DataFrame:
        """Mean and standard error over repeats.

        A row per kernel. Columns (measure, "mean") and (measure, "se"); ("runs", "n") is the
        number of repeats, with a single one there is no standard error (NaN).
        """
        grouped = self.runs.groupby("kernel", sort=False)
        parts: dict[tuple[str, str], pd.Series] = {("runs", "n"): grouped.size()}
        for name in MEASURES:
            parts[name, "mean"] = grouped[name].mean()
            parts[name, "se"] = grouped[name].sem()
        return pd.DataFrame(parts).loc[self.kernels]

    def reference_error(self, measure: str = "tv_goals") -> float | None:
        """Return how far halves of the reference are apart; None: not known.

        The reference itself is nearer than this to what it estimates, in some nine of ten cases.

        Raises:
            UnknownNameError: ``measure`` is none of :data:`DISTANCES`.
        """
        if measure not in DISTANCES:
            raise unknown_name("distance", measure, DISTANCES)
        value = self.settings["reference"].get("error", {}).get(measure)
        return None if value is None else float(value)

    def ranks(self, measure: str = "tv_goals") -> pd.DataFrame:
        """Return which kernels are nearer to the reference, as far as that can be told.

        Two kernels are told apart if their mean distances differ by more than the reference's own
        error and two standard errors of the difference over repeats, together. Without either,
        with a single repeat or a reference of unknown error, none are.

        Args:
            measure: of :data:`DISTANCES`.

        Returns:
            A row per kernel, the nearest first: ``mean``, and ``best`` and ``worst``, the places
            that the kernel can have, from 1 to the number of kernels.

        Raises:
            UnknownNameError: there is no such distance.
        """
        error = self.reference_error(measure)
        table = self.table
        mean = table[measure, "mean"].to_numpy(float)
        spread = table[measure, "se"].to_numpy(float)
        margin = (np.nan if error is None else error) + 2 * np.hypot(spread[:, None], spread)
        nearer = mean[:, None] + margin < mean  # not a number: no
        best = 1 + nearer.sum(axis=0)
        worst = len(mean) - nearer.sum(axis=1)
        found = pd.DataFrame({"mean": mean, "best": best, "worst": worst}, index=table.index)
        return found.sort_values("mean", kind="stable")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything to ``path`` as JSON, whole or not at all.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .json.
        """
        record = {
            "schema": SCHEMA,
            "settings": dict(self.settings),
            "runs": self.runs.to_dict("list"),
            "curve": self.curve.to_dict("list"),
        }
        write_json(path, plain(record))
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Comparison:
        """Read a comparison that :meth:`save` wrote, or a checkpoint of one.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        source = existing_file(path)
        try:
            record = json.loads(source.read_text(encoding="utf-8"))
            if not isinstance(record, dict) or record.get("schema") != SCHEMA:
                raise ValueError(f"it has no schema {SCHEMA!r}")
            runs = _frame(record["runs"], RUN_COLUMNS)
            curve = _frame(record["curve"], CURVE_COLUMNS)
            settings = dict(record["settings"])
            unknown = set(runs["kernel"]) - set(settings["kernels"])
            if unknown:
                raise ValueError(f"its settings do not name the kernels {sorted(unknown)}")
        except (ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise InvalidEventError(f"{source} is no comparison: {reason}") from None
        return cls(runs, curve, settings)

    def __str__(self) -> str:
        table = self.table
        settings = self.settings
        words = (
            f"{settings['event']}: budget {settings['budget']}, {settings['chains']} chains, "
            f"weights {settings['weights']}; mean ± standard error\n"
            f"{_equalised(settings['budget'])}\n"
            f"reference: {settings['reference']['description']}\n{self._error_in_words()}"
        )
        named = [n for n in MEASURES if np.isfinite(table[n, "mean"].to_numpy(float)).any()]
        blocks = [words]
        width = max(len(name) for name in table.index)
        for start in range(0, len(named), _PRINTED_COLUMNS):
            chosen = named[start : start + _PRINTED_COLUMNS]
            rows = [["", *(MEASURES[name] for name in chosen)]]
            for label in table.index:
                cells = [_cell(*table.loc[label, name].to_numpy(float)) for name in chosen]
                rows.append([label, *cells])
            sizes = [max(len(row[i]) for row in rows) for i in range(1, len(chosen) + 1)]
            blocks.append(
                "\n".join(
                    "  ".join([f"{row[0]:<{width}}", *map(str.rjust, row[1:], sizes)]).rstrip()
                    for row in rows
                )
            )
        blocks.append("\n".join(f"rank by {MEASURES[n]}: {self._ranking(n)}" for n in DISTANCES))
        return "\n\n".join(blocks)

    def _error_in_words(self) -> str:
        errors = {name: self.reference_error(name) for name in DISTANCES}
        known = [f"{MEASURES[n]} {e:.2f}" for n, e in errors.items() if e is not None]
        if not known:
            return "its own error is not known, so kernels are not ranked by it"
        return (
            f"its own error: {', '.join(known)} between halves of it; kernels share a rank\n"
            "whose distances do not differ by more than that and two standard errors together"
        )

    def _ranking(self, measure: str) -> str:
        ranks = self.ranks(measure)
        if len(ranks) > 1 and (ranks["best"] == 1).all() and (ranks["worst"] == len(ranks)).all():
            by = "this reference" if (self.table["runs", "n"] > 1).all() else "a single run"
            return f"not told apart by {by}: {', '.join(ranks.index)}"
        parts = []
        for (best, worst), names in ranks.groupby(["best", "worst"], sort=False).groups.items():
            place = f"{best}" if best == worst else f"{best} to {worst}"
            parts.append(f"{place}: {', '.join(names)}")
        return "; ".join(parts)

    def _repr_html_(self) -> str:
        return preformatted(self)

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.kernels)}: {len(self.runs)} runs>"


def _equalised(budget: str) -> str:
    """Return what equal budgets make equal, and what they do not."""
    unit = budget.rpartition(" ")[2]
    others = [name for name in ("simulations", "frames", "seconds") if name != unit]
    return (
        f"equal are the {unit}, up to the last iteration of a run; {' and '.join(others)} are not"
    )


def _frame(columns: Mapping[str, Any], expected: tuple[str, ...]) -> pd.DataFrame:
    missing = [name for name in expected if name not in columns]
    if missing:
        raise ValueError(f"it lacks {missing}")
    frame = pd.DataFrame({name: columns[name] for name in expected})
    text = ("kernel", "validity")
    return frame.astype({n: int for n in ("repeat", "seed") if n in frame}).astype(
        {n: float for n in frame if n not in (*text, "repeat", "seed")}
    )


def _cell(mean: float, error: float) -> str:
    if not np.isfinite(mean):
        return "-"
    digits = 3 if abs(mean) < 10 else 0
    text = f"{mean:.{digits}f}"
    return text if not np.isfinite(error) else f"{text} ±{error:.{digits}f}"
