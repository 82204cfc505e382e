"""The paper's other two experiments: people's labels for videos, and ratings of their likeness.

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

Columns come in any order, and there may be others.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar, Final, Literal

import numpy as np
import pandas as pd

from phase_ppl.data.documents import read_columns
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    positive_number,
    shown,
)

LABELS: Final = (
    "not interacting", "interacting unintentionally", "chasing", "running away", "stalking",
    "approaching", "avoiding", "meeting", "gathering together", "guiding",
    "following the lead (of another agent)", "playing a game of tag", "blocking", "fighting",
    "competing", "stealing", "protecting an object", "attacking", "hindering", "bullying",
    "playing tug of war", "helping", "collaborating",
)  # fmt: skip
"""The paper's 23 labels, in its order and words (Appendix A.1)."""

MAJORITY: Final = 0.5 - 1e-12  # least share of viewers that gives a video a category (paper)


@dataclasses.dataclass(frozen=True, eq=False)
class Tags:
    """Labels that people chose for videos; :func:`phase_ppl.load_tags` reads them.

    Attributes:
        table: a row per chosen label, with ``participant``, ``video`` and ``label``; a viewing
            without labels has one row with label None.
        LABELS: the paper's labels.
    """

    LABELS: ClassVar = LABELS

    table: pd.DataFrame

    @functools.cached_property
    def labels(self) -> tuple[str, ...]:
        """The paper's labels, then any other labels that people chose."""
        found = self.table["label"].dropna().unique().tolist()
        return (*LABELS, *(label for label in found if label not in LABELS))

    @functools.cached_property
    def viewers(self) -> pd.Series[int]:
        """Video -> number of people who watched it."""
        return self.table.groupby("video", sort=False)["participant"].nunique()

    @functools.cached_property
    def shares(self) -> pd.DataFrame:
        """A row per video, a column per label: share of the video's viewers who chose the label."""
        chosen = self.table.dropna(subset="label")
        counts = chosen.groupby(["video", "label"])["participant"].nunique().unstack(fill_value=0)
        counts = counts.reindex(index=self.viewers.index, columns=list(self.labels), fill_value=0)
        return counts.div(self.viewers, axis=0)

    def summary(self) -> pd.DataFrame:
        """Return a row per label: ``percent``, share of videos in its category, and ``used``.

        A video is in a label's category if at least half of its viewers chose the label (paper).
        ``used`` is the number of videos for which anybody chose it.
        """
        categories = self.shares >= MAJORITY
        return pd.DataFrame({"percent": 100 * categories.mean(), "used": (self.shares > 0).sum()})


def load_tags(path: str | os.PathLike[str]) -> Tags:
    """Read labels from a CSV file with the columns ``participant``, ``video`` and ``label``.

    A row has one chosen label; a viewing without any label has one row with an empty cell.

    Raises:
        InvalidEventError: there is no such file, columns or cells are missing, or somebody chose a
            label twice for a video; the message names file and line.
    """
    names = ("participant", "video", "label")
    spelled = {label.lower(): label for label in LABELS}

    def check(row: dict[str, Any]) -> None:
        row["label"] = spelled.get(row["label"].lower(), row["label"]) or None

    rows = read_columns(path, names, check, required=names[:2], once=names)
    return Tags(pd.DataFrame(rows, columns=list(names), dtype=object))


# --- likeness -------------------------------------------------------------------------------------

RATINGS: Final = (1, 2, 3, 4, 5)
MARGIN: Final = 0.5
"""Difference of mean ratings below which two groups count as equivalent: half a step."""

By = Literal["participants", "videos"]


@dataclasses.dataclass(frozen=True, eq=False)
class Likeness:
    """Ratings of how likely people are to behave as in a video, for two groups of videos.

    Attributes:
        table: a row per rating, with ``participant``, ``video``, ``group`` and ``rating`` (1 to 5).
    """

    table: pd.DataFrame

    @functools.cached_property
    def groups(self) -> tuple[str, str]:
        """Names of the two groups, sorted; a group "played" comes first."""
        found = sorted(self.table["group"].unique(), key=lambda name: (name != "played", name))
        return found[0], found[1]

    def means(self, by: By = "videos") -> Mapping[str, FloatArray]:
        """Return group -> (video,) or (participant,) mean ratings; ``by`` says which."""
        found = self._means(by)
        return {group: found[group].to_numpy(float) for group in self.groups}

    def _means(self, by: By) -> pd.Series[float]:
        return self.table.groupby(["group", by.removesuffix("s")])["rating"].mean()

    def summary(self) -> pd.DataFrame:
        """Return a row per group: ``mean`` rating, standard deviations, and numbers.

        ``sd_videos`` and ``sd_participants`` are over the mean ratings of videos and of
        participants; the paper does not say which it reports. ``videos``, ``participants`` and
        ``ratings`` are numbers.
        """
        found = pd.DataFrame(index=pd.Index(self.groups))
        of_group = self.table.groupby("group")["rating"]
        videos, people = (self._means(by).groupby("group") for by in ("videos", "participants"))
        found["mean"] = videos.mean()
        found["sd_videos"], found["sd_participants"] = videos.std(), people.std()
        found["videos"], found["participants"] = videos.size(), people.size()
        found["ratings"] = of_group.size()
        return found

    def equivalence(self, margin: float = MARGIN) -> dict[str, Any]:
        """Test whether the mean ratings of the groups differ by less than a margin.

        Two one-sided Welch tests (TOST) compare the means of participants, who were assigned to
        groups at random. Equivalence is shown if both reject, that is, if the 90 % interval lies
        within the margin.

        Args:
            margin: the margin, in steps of the rating.

        Returns:
            ``difference``, first group minus second; ``ci_low`` and ``ci_high``, its 90 % interval;
            ``p``, the larger p-value of the two tests; and ``equivalent``, whether ``p`` is below
            0.05. If all means within each group are equal, their variance is unknown: ``ci_low``,
            ``ci_high`` and ``p`` are None, and equivalence is not shown.

        Raises:
            InvalidSettingError: ``margin`` is no positive number.
            InvalidEventError: a group has fewer than two participants.
        """
        from scipy import stats

        positive_number("margin", margin)
        first, second = self.means("participants").values()
        if min(len(first), len(second)) < 2:
            raise InvalidEventError("each group needs two participants or more")
        difference = float(first.mean() - second.mean())
        p = low = high = None
        if not np.ptp(first) == 0 == np.ptp(second):
            with warnings.catch_warnings(action="ignore"):  # one group may have no variance
                found = stats.ttest_ind(first, second, equal_var=False)
                low, high = map(float, found.confidence_interval(0.9))
                tests = [
                    stats.ttest_ind(first + shift, second, equal_var=False, alternative=alternative)
                    for shift, alternative in ((margin, "greater"), (-margin, "less"))
                ]
            p = float(max(test.pvalue for test in tests))
        return {
            "difference": difference,
            "ci_low": low,
            "ci_high": high,
            "p": p,
            "equivalent": p is not None and p < 0.05,
        }


def load_likeness(path: str | os.PathLike[str]) -> Likeness:
    """Read ratings from a CSV file: ``participant``, ``video``, ``group`` and ``rating`` (1 to 5).

    Raises:
        InvalidEventError: there is no such file, it is no such table, a rating is not 1 to 5, there
            are not two groups, or somebody rates a video twice or sees both groups.
    """
    names = ("participant", "video", "group", "rating")
    group_of: dict[str, str] = {}

    def check(row: dict[str, Any]) -> None:
        if row["rating"] not in map(str, RATINGS):
            raise InvalidEventError(f"rating is {shown(row['rating'])}, expected 1 to 5")
        row["rating"] = int(row["rating"])
        who = row["participant"]
        if group_of.setdefault(who, row["group"]) != row["group"]:
            raise InvalidEventError(f"participant {shown(who)} is in two groups")

    rows = read_columns(path, names, check, required=names, once=names[:2])
    groups = sorted({row["group"] for row in rows})
    if len(groups) != 2:
        raise InvalidEventError(f"{path}: groups are {shown(groups)}, expected two")
    return Likeness(pd.DataFrame(rows))
