"""What happens in videos, in people's words: labels that viewers chose, and what most of them say.

A CSV file has a row per label that somebody chose for a video::

    participant,video,label
    p01,collaborate,helping
    p01,collaborate,collaborating
    p02,collaborate,

A viewing without any label has one row with an empty cell. Columns come in any order, and there may
be others. Labels may be others than the paper's.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from typing import Any, Final

import pandas as pd

from phase_ppl.evaluation.csv_file import read_columns
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown

LABELS: Final = (
    "not interacting",
    "interacting unintentionally",
    "chasing",
    "running away",
    "stalking",
    "approaching",
    "avoiding",
    "meeting",
    "gathering together",
    "guiding",
    "following the lead (of another agent)",
    "playing a game of tag",
    "blocking",
    "fighting",
    "competing",
    "stealing",
    "protecting an object",
    "attacking",
    "hindering",
    "bullying",
    "playing tug of war",
    "helping",
    "collaborating",
)
"""The paper's 23 labels, in its order and words (Appendix A.1)."""

MAJORITY: Final = 0.5  # share of the viewers of a video from which on it has a category (paper)


@dataclasses.dataclass(frozen=True, eq=False)
class Tags:
    """Labels that people chose for videos.

    Attributes:
        table: a row per label chosen, with ``participant``, ``video`` and ``label``; of a viewing
            without labels one row, whose label is None.
    """

    table: pd.DataFrame

    @functools.cached_property
    def labels(self) -> tuple[str, ...]:
        """The paper's labels and whatever others there are."""
        found = self.table["label"].dropna().unique().tolist()
        return (*LABELS, *(label for label in found if label not in LABELS))

    @functools.cached_property
    def viewers(self) -> pd.Series[int]:
        """Video -> number of people who watched it."""
        return self.table.groupby("video", sort=False)["participant"].nunique()

    @functools.cached_property
    def shares(self) -> pd.DataFrame:
        """Video x label -> share of its viewers who chose the label."""
        chosen = self.table.dropna(subset="label")
        counts = chosen.groupby(["video", "label"])["participant"].nunique().unstack(fill_value=0)
        counts = counts.reindex(index=self.viewers.index, columns=list(self.labels), fill_value=0)
        return counts.div(self.viewers, axis=0)

    def categories(self, majority: float = MAJORITY) -> pd.DataFrame:
        """Return video x label -> whether at least ``majority`` of its viewers chose it.

        Raises:
            InvalidSettingError: ``majority`` is no share above 0.
        """
        if not (isinstance(majority, int | float) and 0 < majority <= 1):
            raise InvalidSettingError(f"majority={shown(majority)}, expected a share above 0")
        return self.shares >= majority - 1e-12

    def summary(self, majority: float = MAJORITY) -> pd.DataFrame:
        """Return label -> ``percent`` of the videos that have it as a category, and ``used`` in."""
        return pd.DataFrame(
            {"percent": 100 * self.categories(majority).mean(), "used": (self.shares > 0).sum()}
        )

    def __repr__(self) -> str:
        return (
            f"<Tags of {len(self.viewers)} videos, {self.table['participant'].nunique()} "
            f"participants, {self.viewers.sum()} viewings>"
        )


def load_tags(path: str | os.PathLike[str]) -> Tags:
    """Read labels from a CSV file of the form that the module describes.

    Raises:
        InvalidEventError: there is no such file, columns or cells are missing, or somebody chose a
            label twice for a video; the message names file and line.
    """
    names = ("participant", "video", "label")
    spelled = {label.lower(): label for label in LABELS}
    seen: set[tuple[str, str, str | None]] = set()

    def check(row: dict[str, Any]) -> None:
        row["label"] = spelled.get(row["label"].lower(), row["label"]) or None
        choice = row["participant"], row["video"], row["label"]
        if choice in seen:
            raise InvalidEventError(f"the same label for the same video as before: {shown(choice)}")
        seen.add(choice)

    rows = read_columns(path, names, check, names[:2])
    return Tags(pd.DataFrame(rows, columns=list(names), dtype=object))
