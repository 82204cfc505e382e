"""Names on the pages and figures of an evaluation."""

from __future__ import annotations

import pytest

from phase_ppl.analysis.figures.style import SMALL
from phase_ppl.evaluation.figures.sheet import fitting, in_lines


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("SIMPLE", ["SIMPLE"]),
        ("predicate planning", ["predicate", "planning"]),
        ("full observation", ["full", "observation"]),  # a hair too long for its line
        ("Donaudampfschifffahrt", ["Donaudampf", "schifffahr", "t"]),
        ("", [""]),
    ],
)
def test_words_stay_whole_unless_they_are_far_too_long(name: str, lines: list[str]) -> None:
    ten_characters = 10.5 * 0.69 * 7.5 / 72  # inches, at the smallest size that is used
    assert in_lines(name, ten_characters) == lines


def test_a_word_that_stays_whole_is_written_smaller_but_not_much() -> None:
    lines = in_lines("full observation", 0.75)
    assert lines == ["full", "observation"]
    assert SMALL / 1.3 <= min(fitting(line, 0.75) for line in lines) < SMALL
