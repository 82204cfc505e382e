"""Whether a posterior can be trusted, in a few sentences made of its diagnostics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

from phase_ppl.analysis.estimate import with_error
from phase_ppl.analysis.with_arviz import MIN_CHAINS_BETWEEN, MIN_DRAWS, MIN_DRAWS_WITHIN

AGREED: Final = 0.8
"""Share of particles with the same leading goal from which on they are said to agree."""

STUCK: Final = 0.05  # acceptance rate below which the particles are said to have hardly moved
FEW: Final = 0.1  # effective share of weighted draws below which a few of them are said to decide

MIXED: Final = 1.1  # R-hat above which draws are said to depend on where their chain began

ALONE: Final = 0.99
"""Probability that an answer needs without the prior, for the video to be said to decide: mean
likelihoods of few simulations err by nats (``benchmarks/decided.py``)."""

UNTRIED: Final = 0.05
"""Prior mass of pairs of goals without a simulation from which on it is a sign."""

_NAMED: Final = 2  # goals that are named where particles disagree
_FRAMES_NAMED: Final = 3  # frames that are named


def verdict(found: Mapping[str, Any]) -> str:
    """Return in a few sentences whether a posterior with these diagnostics can be trusted.

    What speaks most against it comes first. Only where nothing does, this is said.
    """
    weighted, particles = found["weighted_draws_ess"] is not None, found["particles"]
    signs = list(_signs(found, weighted))
    if weighted:
        return " ".join(signs)
    sentences = [*signs, *_notes(found)]
    if particles > 1 and not _split(found):
        whose = _by_agents(found, "the agent's goal", "both agents' goals", "all agents' goals")
        agreed = f"The {particles} particles agree on {whose} {_margin(found)}"
        none = ": nothing speaks against the leading goals."
        sentences.append(agreed + ("." if signs else none))
    return " ".join(sentences)


def _signs(found: Mapping[str, Any], weighted: bool) -> Iterator[str]:
    """Yield what speaks against a posterior, the worst first."""
    if found["overlapping_frames"]:
        yield overlap_sign(found["overlapping_frames"])
    if found["weights"] == "likelihood":
        yield "The weights 'likelihood' make every probability too extreme."
    if found["validity"] == "approximate" and found["weights"] != "stratified":
        yield (
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
    yield from undecided(found["leaders"])
    yield from _by_prior(found)
    if n := found["untried_rivals"]:
        yield (
            f"Not ruled out: {n} rival{'' if n == 1 else 's'} of the leading goals, with which one "
            "agent wants the same thing at another landmark, "
            f"{'was' if n == 1 else 'were'} never simulated."
        )
    rate, size, untried = found["acceptance_rate"], found["effective_size"], found["untried"]
    if not weighted and rate == 0:
        yield "No proposal was accepted: this is still the bottom-up guess, not a posterior."
    elif not weighted and rate < STUCK:
        yield (
            f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left "
            "the bottom-up guess."
        )
    needed = found["effective_size_needed"]
    if needed is None:
        yield (
            f"Not enough: goals with {untried:.2f} of the prior's mass were never simulated, and "
            "those that were are no better than chance."
        )
    elif size is not None and size < needed:
        yield (
            f"Not enough: the goals rest on {size:.1f} effective simulations; an answer needs "
            f"{needed:g}. Another run may well differ."
        )
    if weighted:
        yield from _weighted(found)
    else:
        yield from _disagreement(found)
        yield from _mixing(found)
        yield from _other_leaders(found["categories"])
    if untried is not None and untried >= UNTRIED and needed is not None:  # else it is said
        yield (
            f"{_combined(found).capitalize()} with {untried:.2f} of the prior's mass were never "
            "simulated, and count as impossible."
        )
    simulations = found["simulations"]
    if simulations["failed"]:
        yield f"{simulations['failed']} of {simulations['total']} simulations failed."
    if weighted and found["decided"]:
        all_are = "Both goals and the relation are", "All goals and relations are"
        yield f"{_by_agents(found, 'The goal is', *all_are)} decided, by more than their errors."


def _margin(found: Mapping[str, Any]) -> str:
    errors = [error for error in found["monte_carlo_error"].values() if error is not None]
    if not errors:
        return ""
    return f"(Monte-Carlo error of a leading goal's probability: {max(errors):.2f})"


def _split(found: Mapping[str, Any]) -> list[str]:
    return [name for name, share in found["agreement"].items() if share < AGREED]


def _disagreement(found: Mapping[str, Any]) -> Iterator[str]:
    particles, split = found["particles"], _split(found)
    if particles == 1:
        yield "With one particle nothing shows whether another would agree: use more."
    if particles == 1 or not split:
        return
    camps = {name: _camps(found["leading_goals"][name]) for name in split}
    agreed = [name for name in found["agreement"] if name not in split]
    by_agent = "; ".join(f"for {_agent(name)}, {camp}" for name, camp in camps.items())
    if len(split) == 1 and len(agreed) == 1:
        text = f"agree on {_asked(agreed[0])} but not on {_agent(split[0])}'s"
        text += f", where {camps[split[0]]}"
    elif agreed:
        text = f"agree on {' and '.join(map(_asked, agreed))} only: {by_agent}"
    elif len(split) == 1:
        text = f"do not agree on {_asked(split[0])}: {camps[split[0]]}"
    else:
        whose = "neither agent's goal" if len(split) == 2 else "no agent's goal"
        text = f"agree on {whose}: {by_agent}"
    yield (
        f"The {particles} particles {text} {_margin(found)}. More iterations would tell real "
        "uncertainty from chains that have not mixed."
    )


def _camps(leading: Mapping[str, int]) -> str:
    """Return which goals the particles favour, as "7 favour 'A', 5 'B' and 3 something else"."""
    named = [(goal, n) for goal, n in list(leading.items())[:_NAMED] if n > 1]
    rest = sum(leading.values()) - sum(n for _, n in named)
    if not named:
        return f"all {rest} favour different ones"
    (first, most), *others = named
    parts = [f"{most} favour '{first}'", *(f"{n} '{goal}'" for goal, n in others)]
    parts += [f"{rest} something else"] if rest else []
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _mixing(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield which quantities have chains that differ more than draws of one law do."""
    worst = {"the log joint": found["scalars"]["log_joint"]["r_hat"]}
    for name, labels in found["categories"].items():
        known = [entry["r_hat"] for entry in labels.values() if entry["r_hat"] is not None]
        worst[_titled(name)] = max(known, default=None)
    apart = [f"{name} {r:.2f}" for name, r in worst.items() if r is not None and r > MIXED]
    if apart:
        yield (
            "The chains still depend on where they began: R-hat (1 where they have mixed) is "
            f"{', '.join(apart)}."
        )


def _notes(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what could not be looked at."""
    draws = found["iterations"]
    if draws < MIN_DRAWS:
        yield (
            f"R-hat and effective sample sizes need {MIN_DRAWS} draws per particle; "
            f"there {'is' if draws == 1 else 'are'} {draws}."
        )
    elif draws < MIN_DRAWS_WITHIN and found["particles"] < MIN_CHAINS_BETWEEN:
        yield (
            f"Effective sample sizes need {MIN_DRAWS_WITHIN} draws per particle, or "
            f"{MIN_CHAINS_BETWEEN} particles."
        )


def _other_leaders(categories: Mapping[str, Any]) -> Iterator[str]:
    """Yield for which agent the weighting puts another goal first than the draws do."""
    for name, goals in categories.items():
        if not name.startswith(_GOAL):
            continue
        agent = _agent(name)
        first = max(goals, key=lambda goal: goals[goal]["probability"])
        if goals[first]["share"] < max(entry["share"] for entry in goals.values()):
            yield f"The weights put another goal of {agent} first, '{first}'."


_GOAL: Final = "goal_"  # begins the names of goals


def _agent(goal: str) -> str:
    return goal.removeprefix(_GOAL)


def _asked(name: str) -> str:
    """Return in words what a goal or relation is of."""
    if name.startswith(_GOAL):
        return f"{_agent(name)}'s goal"
    return "the relation" if name == "relation" else name.replace("_", " ")


def _titled(name: str) -> str:
    return f"goal of {_agent(name)}" if name.startswith(_GOAL) else name.replace("_", " ")


def _by_agents(found: Mapping[str, Any], one: str, two: str, more: str) -> str:
    """Return what to say where there are one, two or more agents."""
    return {1: one, 2: two}.get(len(found["agreement"]), more)


def _combined(found: Mapping[str, Any]) -> str:
    """Return in words what all agents want together, in the plural."""
    return _by_agents(found, "goals", "pairs of goals", "combinations of goals")


def undecided(leaders: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return what is not decided, and between what; see ``Hypotheses.leaders``."""
    open_ones = []
    for name, one in leaders.items():
        if not one["sure"]:
            error = math.nan if one["error"] is None else one["error"]
            first = f"'{one['label']}' ({with_error(one['probability'], error)})"
            second = f"'{one['next']}' ({one['next_probability']:.2f})"
            open_ones.append(f"{_asked(name)} {first} or {second}")
    return [f"Not decided: {'; '.join(open_ones)}."] if open_ones else []


def _by_prior(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is sure by the prior only, or less sure without it."""
    below = 0.0
    for most, says in (
        (0.5, "The prior decides, not the video"),
        (ALONE, f"The video alone does not decide, which takes {ALONE}"),
    ):
        names = [
            # rounded down, so that what is short of a limit is not shown as it
            f"{math.floor(100 * one['without_prior']) / 100:.2f} for {_asked(name)} "
            f"'{one['label']}'"
            for name, one in found["leaders"].items()
            if one["sure"]
            and one["without_prior"] is not None
            and below <= one["without_prior"] <= most
        ]
        below = math.nextafter(most, 1)
        if names:
            yield (
                f"{says}: with all {_combined(found)} alike beforehand there would be "
                f"{' and '.join(names)}."
            )


def _weighted(found: Mapping[str, Any]) -> Iterator[str]:
    if found["weights"] != "count":  # all simulations count, not the draws alone
        return
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    text = f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones {_margin(found)}"
    few = ": so few decide that another run may well differ."
    yield text.rstrip() + (few if ess < FEW else ".")


def overlap_sign(frames: list[int]) -> str:
    """Return what the frames in which bodies lie on each other say of a posterior."""
    return (
        f"Bodies lie on each other or in a wall in {frames_text(frames)}, which bodies of this "
        "world cannot: what they do there says little of goals."
    )


def frames_text(frames: list[int]) -> str:
    """Return frames by number, the first few if they are many."""
    named = ", ".join(map(str, frames[:_FRAMES_NAMED]))
    if len(frames) > _FRAMES_NAMED:
        return f"{len(frames)} frames ({named}, ...)"
    return f"frame{'s' if len(frames) > 1 else ''} {named}"
