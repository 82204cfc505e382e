"""A posterior that was read step by step, in short: as plain data, and as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from phase_ppl.analysis.summary import answer_lines, answers, plain, wrapped

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior


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
