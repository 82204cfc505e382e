"""Two of the paper's experiments: people's labels for videos, and ratings of their likeness.

*Tags* are labels that viewers chose; the CSV file has a row per chosen label::

    participant,video,label
    p01,collaborate,helping
    p01,collaborate,collaborating
    p02,collaborate,

A viewing without any label has one row with an empty cell. Labels may be others than the paper's.

*Likeness*: rating from 1 to 5 of how likely people are to behave like this, for two groups of
videos (paper, Appendix A.2); a row per participant and video::

    participant,video,group,rating
    p01,played-3,played,4
    p02,event-3,generated,5

Columns come in any order, and there may be others. The files are in UTF-8, with commas.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np
import pandas as pd

import phase_ppl as ppl

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

LABELS: Final = (
    "not interacting", "interacting unintentionally", "chasing", "running away", "stalking",
    "approaching", "avoiding", "meeting", "gathering together", "guiding",
    "following the lead (of another agent)", "playing a game of tag", "blocking", "fighting",
    "competing", "stealing", "protecting an object", "attacking", "hindering", "bullying",
    "playing tug of war", "helping", "collaborating",
)  # fmt: skip
"""The paper's 23 labels, in its order and words (Appendix A.1)."""

MAJORITY: Final = 0.5 - 1e-12  # least share of viewers that gives a video a category (paper)

_GREY: Final = "#666666"
_COLOURS: Final = ("#0072b2", "#d55e00")
_REHEARSAL: Final = "A rehearsal: scripted people, which says nothing about people."


@dataclasses.dataclass(frozen=True, eq=False)
class Tags:
    """Labels that people chose for videos.

    Attributes:
        table: a row per chosen label, with ``participant``, ``video`` and ``label``; a viewing
            without labels has one row with label None.
        LABELS: the paper's labels.
        PAPER: how many labels the paper's people used, and how many are a category of a video.
    """

    LABELS: ClassVar = LABELS
    PAPER: ClassVar = {"used": 23, "category": 18}

    table: pd.DataFrame

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Tags:
        """Read labels from a CSV file, in the format that the module describes.

        Raises:
            InvalidEventError: there is no such file, columns or cells are missing, or somebody
                chose a label twice for a video; the message names file and line.
        """
        names = ["participant", "video", "label"]
        table = _read(path, names, filled=names[:2])
        spelled = {label.lower(): label for label in LABELS}
        given = [spelled.get(label.lower(), label) or None for label in table["label"]]
        table["label"] = pd.Series(given, dtype=object)
        _refuse(path, table, "label", table.duplicated(), "is there for that video a second time")
        return cls(table)

    @functools.cached_property
    def viewers(self) -> pd.Series[int]:
        """Video -> number of people who watched it."""
        return self.table.groupby("video", sort=False)["participant"].nunique()

    @functools.cached_property
    def shares(self) -> pd.DataFrame:
        """Video x label -> share of its viewers who chose it; the paper's labels, then others."""
        counts = pd.crosstab(self.table["video"], self.table["label"])
        labels = list(dict.fromkeys([*LABELS, *self.table["label"].dropna()]))
        counts = counts.reindex(index=self.viewers.index, columns=labels, fill_value=0)
        return counts.div(self.viewers, axis=0)

    def summary(self) -> pd.DataFrame:
        """Return label -> ``percent`` of videos with it as a category, and ``used`` in how many.

        At least half of a video's viewers chose its categories (paper).
        """
        categories = self.shares >= MAJORITY
        return pd.DataFrame({"percent": 100 * categories.mean(), "used": (self.shares > 0).sum()})

    def counts(self) -> pd.DataFrame:
        """Return how many labels were ``used``, and are a ``category``: here and in the paper."""
        found = self.summary()
        here = {"used": (found["used"] > 0).sum(), "category": (found["percent"] > 0).sum()}
        return pd.DataFrame({"here": here, "paper": self.PAPER})

    @ppl.plot.in_style
    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the share of videos in each category, as the paper does for its 23 labels.

        With a ``path`` (.png, .pdf, .svg) the figure is also written there.
        """
        found = self.summary()[::-1]
        used, category = self.counts().itertuples()
        figure = ppl.plot.new_figure(
            *(6.4, 1.0 + 0.19 * len(found)),
            title=_rehearsal(self.table),
            note=f"Percentage of the {len(self.viewers)} videos for which at least half of their "
            "viewers chose the label. Hollow: chosen by somebody, in no video by that many. "
            f"Labels used: {used.here}, in the paper {used.paper}; a category of a video: "
            f"{category.here}, in the paper {category.paper}.",
        )
        axes = figure.subplots()
        bars = axes.barh(found.index, found["percent"], 0.68, color=_COLOURS[0])
        axes.bar_label(bars, fmt="%.0f", padding=5, color=_GREY)
        for label in found.index[(found["percent"] == 0) & (found["used"] > 0)]:
            style: dict[str, Any] = {"mfc": "white", "mec": _COLOURS[0], "clip_on": False}
            axes.plot(0, label, "o", ms=3.5, zorder=3, **style)
        axes.set(xlim=(0, max(10.0, 1.12 * found["percent"].max())), ylim=(-0.6, len(found) - 0.4))
        axes.set_xlabel("videos, %")
        axes.grid(axis="x")
        return ppl.plot.written(figure, path)


# --- likeness -------------------------------------------------------------------------------------

RATINGS: Final = (1, 2, 3, 4, 5)
MARGIN: Final = 0.5
"""Difference of mean ratings below which two groups count as equivalent: half a step."""

By = Literal["participants", "videos"]


@dataclasses.dataclass(frozen=True, eq=False)
class Likeness:
    """Ratings of two groups of videos.

    Attributes:
        table: a row per rating, with ``participant``, ``video``, ``group`` and ``rating``.
        PAPER: the paper's means and standard deviations.
    """

    PAPER: ClassVar = {
        "paper_mean": {"played": 4.06, "generated": 3.98},
        "paper_sd": {"played": 0.36, "generated": 0.42},
    }

    table: pd.DataFrame

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Likeness:
        """Read ratings from a CSV file, in the format that the module describes.

        Raises:
            InvalidEventError: there is no such file, it is no such table, a rating is not 1 to 5,
                there are not two groups, or somebody rates a video twice or sees both groups.
        """
        names = ["participant", "video", "group", "rating"]
        table = _read(path, names, filled=names)
        _refuse(path, table, "rating", ~table["rating"].isin([*map(str, RATINGS)]), "is not 1 to 5")
        twice = table.duplicated(names[:2])
        _refuse(path, table, "video", twice, "is there for that participant a second time")
        groups = table.groupby("participant")["group"].transform("nunique")
        _refuse(path, table, "participant", groups > 1, "is in two groups")
        if table["group"].nunique() != 2:
            given = sorted(table["group"].unique())
            raise ppl.errors.InvalidEventError(f"{path}: groups are {given}, expected two")
        return cls(table.astype({"rating": int}))

    @functools.cached_property
    def groups(self) -> tuple[str, str]:
        """Names of the groups, sorted, "played" first where it is one."""
        found = sorted(self.table["group"].unique(), key=lambda name: (name != "played", name))
        return found[0], found[1]

    def means(self, by: By = "videos") -> Mapping[str, NDArray[np.float64]]:
        """Return group -> mean rating of each video, or of each participant."""
        found = self._means(by)
        return {group: found[group].to_numpy(float) for group in self.groups}

    def _means(self, by: By) -> pd.Series[float]:
        return self.table.groupby(["group", by.removesuffix("s")])["rating"].mean()

    def summary(self) -> pd.DataFrame:
        """Return group -> mean rating, and its standard deviation over videos and participants.

        ``ci_low`` and ``ci_high`` are the 95 % interval of the mean over videos. The paper's
        numbers are beside ours. It does not say of what its standard deviations are.
        """
        from scipy import stats

        videos, people = (
            self._means(by).groupby("group").agg(["mean", "std", "size"])
            for by in ("videos", "participants")
        )
        half = stats.t.ppf(0.975, videos["size"] - 1) * videos["std"] / np.sqrt(videos["size"])
        found = {
            "mean": videos["mean"],
            **{"ci_low": videos["mean"] - half, "ci_high": videos["mean"] + half},
            **{"sd_videos": videos["std"], "sd_participants": people["std"]},
            **{"videos": videos["size"], "participants": people["size"]},
            "ratings": self.table.groupby("group").size(),
        }
        return pd.DataFrame(found).loc[list(self.groups)].join(pd.DataFrame(self.PAPER))

    def equivalence(self, margin: float = MARGIN) -> dict[str, Any]:
        """Test whether the mean ratings of the groups differ by less than a margin.

        Two one-sided Welch tests (TOST) of the means of participants, who were assigned to groups
        at random. Equivalence is shown if both reject, that is, if the 90 % interval lies within
        the margin.

        Args:
            margin: in steps of the rating.

        Returns:
            ``difference``, first group minus second; ``ci_low`` and ``ci_high``, 90 %; ``p``, the
            larger of the two; and ``equivalent``, whether it is below 0.05. If all means within
            each group are equal, their variance is unknown: ``ci_low``, ``ci_high`` and ``p`` are
            None, and equivalence is not shown.

        Raises:
            InvalidSettingError: ``margin`` is no positive number.
            InvalidEventError: a group has fewer than two participants.
        """
        from scipy import stats

        if not margin > 0:
            raise ppl.errors.InvalidSettingError(f"margin={margin!r}, expected a number > 0")
        first, second = self.means("participants").values()
        if min(len(first), len(second)) < 2:
            raise ppl.errors.InvalidEventError("each group needs two participants or more")
        difference = float(first.mean() - second.mean())
        found: dict[str, Any] = dict.fromkeys(("ci_low", "ci_high", "p"))
        if np.ptp(first) or np.ptp(second):
            with warnings.catch_warnings(action="ignore"):  # one group may have no variance
                df = stats.ttest_ind(first, second, equal_var=False).df
            error = np.hypot(stats.sem(first), stats.sem(second))
            low, high = stats.t.interval(0.9, df, difference, error)
            p = stats.t.sf((margin - abs(difference)) / error, df)
            found = {"ci_low": float(low), "ci_high": float(high), "p": float(p)}
        equivalent = found["p"] is not None and found["p"] < 0.05
        return {"difference": difference, **found, "equivalent": equivalent}

    @ppl.plot.in_style
    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the ratings of the two groups; the note has the test of equivalence.

        With a ``path`` (.png, .pdf, .svg) the figure is also written there.
        """
        test = self.equivalence()
        told = f"Difference of participants' means: {test['difference']:.2f}"
        if test["p"] is not None:
            told += f" [{test['ci_low']:.2f}, {test['ci_high']:.2f}] (90 %)"
        is_shown = "shown" if test["equivalent"] else "not shown"
        found = self.summary()
        paper = "; ".join(
            f"{group} {row['paper_mean']} ± {row['paper_sd']}"
            for group, row in found.dropna(subset="paper_mean").iterrows()
        )
        figure = ppl.plot.new_figure(
            *(5.4, 3.1),
            title=_rehearsal(self.table),
            note="Left: share of each rating. Right: mean rating of each video, and mean over "
            f"videos ± standard deviation. {told}; equivalence within {MARGIN} is {is_shown} (two "
            f"one-sided tests).{f' In the paper: {paper}.' if paper else ''}",
        )
        shares, means = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
        pairs = zip(self.means("videos").items(), _COLOURS, strict=True)
        for index, ((group, values), colour) in enumerate(pairs):
            ratings = self.table.loc[self.table["group"] == group, "rating"]
            share = ratings.value_counts(normalize=True).reindex(RATINGS, fill_value=0)
            places = np.array(RATINGS) + 0.4 * (index - 0.5)
            shares.bar(places, share, width=0.38, color=colour, label=group)
            means.plot([index] * len(values), values, "o", ms=3, color=colour, alpha=0.5, mew=0)
            means.plot([index - 0.25, index + 0.25], [values.mean()] * 2, color="#222222", lw=1.5)
        shares.set(xticks=RATINGS, xlabel="rating", ylabel="share")
        shares.legend(loc="upper left")
        labels = [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()]
        means.set_xticks([0, 1], labels)
        means.set(xlim=(-0.5, 1.5), ylim=(0.9, 5.1), yticks=RATINGS)
        return ppl.plot.written(figure, path)


# --- files ----------------------------------------------------------------------------------------


def _read(
    path: str | os.PathLike[str], names: Sequence[str], filled: Sequence[str]
) -> pd.DataFrame:
    """Return columns of a CSV file as text; cells of ``filled`` ones must not be empty."""
    source = ppl.files.existing_file(path)
    given: dict[str, Any] = {"dtype": object, "keep_default_na": False, "index_col": False}
    try:
        with warnings.catch_warnings(action="error"):  # of a row with more cells than columns
            read = pd.read_csv(source, **given)[list(names)]
    except (ValueError, KeyError, pd.errors.ParserWarning) as error:
        what = f"no table with the columns {', '.join(names)}: {str(error).strip()}"
        raise ppl.errors.InvalidEventError(f"{path}: {what}") from None
    table = read.apply(lambda cells: cells.str.strip())
    if table.empty:
        raise ppl.errors.InvalidEventError(f"{path}: holds no rows")
    for name in filled:
        _refuse(path, table, name, table[name] == "", "must not be empty")
    return table


def _refuse(
    path: str | os.PathLike[str], table: pd.DataFrame, name: str, wrong: pd.Series[bool], why: str
) -> None:
    """Raise InvalidEventError about the first row that is wrong, if there is one."""
    if wrong.any():
        row = wrong.to_numpy().argmax()
        cell = table[name].iloc[row]
        raise ppl.errors.InvalidEventError(f"{path}: line {row + 2}: {name} {cell!r} {why}")


def _rehearsal(table: pd.DataFrame) -> str:
    scripted = table["participant"].str.startswith(ppl.Judgments.SCRIPTED).any()
    return _REHEARSAL if scripted else ""
