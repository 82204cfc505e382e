"""A posterior that was read step by step, in short: as plain data, and as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from phase_ppl.analysis.summary import answer_lines, answers, plain, wrapped

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior


def stepwise_summary(post: StepwisePosterior) -> dict[str, Any]:
    """Return ``post`` in JSON's types.

    Keys: ``goals``, ``relation``, ``scenario``, ``strengths`` as of a sampled posterior; ``map``,
    ``log_evidence`` (nats), ``frame``, ``settings``, ``cost``.
    """
    record = {
        **answers(post),
        "map": post.map_record(),
        "log_evidence": post.log_evidence,
        "frame": post.frame,
        "settings": post.settings,
        "cost": post.cost,
    }
    return {name: plain(value) for name, value in record.items()}


def stepwise_table(post: StepwisePosterior) -> str:
    """Return ``post`` as a table of at most 88 columns."""
    n = len(post.observed())
    head = f"{post.event_id}: read step by step, {n} frames; all hypotheses, no sampling"
    lines = [*wrapped("posterior", head), "", *answer_lines(post), ""]
    lines += wrapped("evidence", f"log p(video) = {post.log_evidence:.1f} nats")
    return "\n".join([*lines, *wrapped("cost", _cost(post.cost, n))])


def _cost(cost: dict[str, Any], n: int) -> str:
    words = f"{cost['searches']} searches, {cost['searches'] / max(1, n - 1):.0f} a step"
    if isinstance(cost.get("seconds"), int | float):
        words += f", in {cost['seconds']:.1f} s; the video lasts {cost['video_seconds']:.1f} s"
    return words
