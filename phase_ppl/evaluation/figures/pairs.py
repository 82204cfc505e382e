"""Differences between models, pair by pair, and between models and people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.comparison.statistics import ALPHA
from phase_ppl.evaluation.figures.accuracies import TITLES
from phase_ppl.evaluation.figures.sheet import (
    GREY,
    NothingToDrawError,
    Sheet,
    fitting,
    in_words,
    label_column,
    tint,
)
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.evaluation.comparison.results import ComparedResults

_CELL: Final = 0.4
_HIGH: Final = 0.27
_ROW: Final = 0.21
_PANEL: Final = 1.45
_SIGN: Final = "\N{MINUS SIGN}"
_HIGHER, _LOWER = "#1b6ca8", "#b5482a"


def differences(results: ComparedResults) -> Figure:
    """Draw the differences in right answers between models: row minus column.

    They are those of every two models, or of all from one where the comparison is against one.

    Raises:
        NothingToDrawError: no two models answered the same question of an event with truth.
    """
    comparison = results.comparison
    kinds = {kind: _pairs(comparison.differences, kind) for kind in TITLES}
    kinds = {kind: found for kind, found in kinds.items() if found}
    if not kinds:
        raise NothingToDrawError("no two models answered the same question of an event with truth")
    labels = {o.name: (o.label, o.colour) for o in results.observers}
    left = label_column(label for label, _ in labels.values())
    against = comparison.settings["against"]
    grids = {}
    for kind, found in kinds.items():
        names = [n for n in comparison.models if any(n in pair for pair in found)]
        grids[kind] = (
            [name for name in names if name != against],
            names if against is None else [against],
        )
    # the slanted names of the columns reach up, and beyond the last one
    named = {name for _, columns in grids.values() for name in columns}
    slanted = 0.7 * (label_column(labels[name][0] for name in named) - 0.2)
    apart = max(0.15, slanted - 0.58 * _CELL)
    sheet = Sheet(
        max(sum(left + _CELL * len(columns) + apart for _, columns in grids.values()), 4.2),
        0.5 + slanted + _HIGH * max(len(rows) for rows, _ in grids.values()) + 0.34,
    )
    size = min(fitting(label, 1.19 * (left - 0.16)) for label, _ in labels.values())
    start, top = 0.0, 0.5 + slanted
    for kind, (rows, columns) in grids.items():
        sheet.write(start + 0.08, 0.24, TITLES[kind], size=NORMAL + 1, weight="bold")
        for place, name in enumerate(rows):
            label, colour = labels[name]
            y = top + _HIGH * (place + 0.5)
            sheet.write(
                start + left - 0.08, y, label, size=size, colour=colour, ha="right",
                va="center_baseline",
            )  # fmt: skip
        for place, name in enumerate(columns):
            label, colour = labels[name]
            sheet.figure.text(
                (start + left + _CELL * (place + 0.42)) / sheet.width,
                1 - (top - 0.06) / sheet.height, label, fontsize=size, color=colour,
                rotation=45, rotation_mode="anchor", ha="left", va="baseline", parse_math=False,
            )  # fmt: skip
        axes = sheet.axes(start + left, top, _CELL * len(columns), _HIGH * len(rows))
        _matrix(axes, rows, columns, kinds[kind])
        start += left + _CELL * len(columns) + apart
    note = "Row minus column, in right answers. Bold: p up to 0.05 after Holm's correction."
    size = fitting(note, 1.3 * (sheet.width - 0.16), SMALL - 0.5)  # the font is not bold
    sheet.write(0.08, sheet.height - 0.09, note, colour=GREY, size=size)
    return sheet.figure


def _pairs(
    rows: Sequence[Mapping[str, Any]], kind: str
) -> dict[tuple[str, str], Mapping[str, Any]]:
    return {
        (row["one"], row["other"]): row
        for row in rows
        if row["scenario"] is None and row["measure"] == f"{kind}_accuracy"
    }


def _matrix(
    axes: Axes,
    rows: Sequence[str],
    columns: Sequence[str],
    found: Mapping[tuple[str, str], Mapping[str, Any]],
) -> None:
    axes.set_xlim(0, len(columns))
    axes.set_ylim(len(rows), 0)
    axes.set_axis_off()
    for i, one in enumerate(rows):
        for j, other in enumerate(columns):
            style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL}
            row, sign = found.get((one, other)), 1
            if row is None:
                row, sign = found.get((other, one)), -1
            if row is None:
                text = "" if one == other else "\N{EN DASH}"
                axes.text(j + 0.5, i + 0.5, text, color=GREY, **style)
                continue
            value = sign * row["value"]
            colour = tint(_HIGHER if value > 0 else _LOWER, min(0.75, abs(value)))
            axes.fill([j, j + 1, j + 1, j], [i, i, i + 1, i + 1], color=colour, ec="white", lw=1.2)
            sure = row["p_holm"] is not None and row["p_holm"] <= ALPHA
            words = f"{value:+.2f}".replace("-", _SIGN) if round(value, 2) else "0.00"
            weight = "bold" if sure else "normal"
            axes.text(j + 0.5, i + 0.5, words, color=INK, fontweight=weight, **style)


def equivalence(results: ComparedResults) -> Figure:
    """Draw how much more often models are right than people, beside the margin of equivalence.

    Raises:
        NothingToDrawError: people judged no event with truth.
    """
    rows = results.comparison.equivalence
    if not rows:
        raise NothingToDrawError("people judged no event whose truth is known")
    labels = {o.name: (o.label, o.colour) for o in results.observers}
    kinds = [kind for kind in TITLES if any(r["measure"] == f"{kind}_accuracy" for r in rows)]
    columns = [None, *(s for s in SCENARIOS if any(r["scenario"] == s for r in rows))]
    left = label_column(label for label, _ in labels.values())
    by_kind = {
        kind: list(dict.fromkeys(r["model"] for r in rows if r["measure"] == f"{kind}_accuracy"))
        for kind in kinds
    }
    heights = {kind: 0.5 + _ROW * len(models) + 0.4 for kind, models in by_kind.items()}
    sheet = Sheet(left + _PANEL * max(len(columns), 3) + 0.1, sum(heights.values()) + 0.34)
    ends = [abs(r[k]) for r in rows for k in ("value", "ci_low", "ci_high") if r[k] is not None]
    reach = max(0.5, *ends)
    top = 0.0
    for kind, models in by_kind.items():
        sheet.write(0.08, top + 0.24, TITLES[kind], size=NORMAL + 1, weight="bold")
        for place, name in enumerate(models):
            label, colour = labels[name]
            sheet.write(
                left - 0.08, top + 0.5 + _ROW * (place + 0.5), label, colour=colour, ha="right",
                va="center_baseline", size=fitting(label, 1.19 * (left - 0.16)),
            )  # fmt: skip
        for column, scenario in enumerate(columns):
            x = left + column * _PANEL
            sheet.write(x, top + 0.24, scenario or "all")
            axes = sheet.axes(x, top + 0.5, _PANEL - 0.2, _ROW * len(models))
            found = {
                r["model"]: r
                for r in rows
                if r["measure"] == f"{kind}_accuracy" and r["scenario"] == scenario
            }
            n = in_words(r["n_events"] for r in found.values()) if found else "n = 0"
            sheet.write(x, top + 0.4, n, size=SMALL, colour=GREY)
            _against_people(axes, [(found.get(m), labels[m][1]) for m in models],
                            results.comparison.settings["margin"], reach)  # fmt: skip
        top += heights[kind]
    notes = (
        "Share right, model minus people, event by event. Thin: 95 %, thick: 90 % intervals.",
        "Band: margin of equivalence. Filled: equivalence is shown, after Holm's correction.",
    )
    for line, note in enumerate(notes):
        y = sheet.height - 0.21 + 0.12 * line
        sheet.write(0.08, y, note, size=SMALL - 0.5, colour=GREY)
    return sheet.figure


def _against_people(
    axes: Axes,
    rows: Sequence[tuple[Mapping[str, Any] | None, str]],
    margin: float,
    reach: float,
) -> None:
    axes.axvspan(-margin, margin, color="#dfe7dc", lw=0)
    axes.axvline(0, color="#8a8a8a", lw=0.8)
    for place, (row, colour) in enumerate(rows):
        if row is None:
            continue
        for low, high, width in (("ci_low", "ci_high", 0.9), ("low", "high", 2.4)):
            if row[low] is not None:
                axes.plot([row[low], row[high]], [place, place], color=colour, lw=width,
                          solid_capstyle="butt")  # fmt: skip
        filled = "equivalent" in row["verdict"]
        axes.plot([row["value"]], [place], "o", ms=5, mec=colour, mew=1.2,
                  mfc=colour if filled else "white")  # fmt: skip
    bare(axes, "left")
    axes.set_xlim(-reach * 1.05, reach * 1.05)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_yticks([])
    ticks = [-0.5, 0, 0.5]
    axes.set_xticks(ticks, [f"{t:g}".replace("-", _SIGN) for t in ticks])
