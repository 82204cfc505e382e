"""In words, whether a posterior can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.analysis.convergence import MIN_CHAINS_BETWEEN, MIN_DRAWS, MIN_DRAWS_WITHIN

AGREED: Final = 0.8
"""Share of particles with the same leading goal from which on they are said to agree."""

STUCK: Final = 0.05
"""Acceptance rate below which the particles are said to have hardly moved."""

FEW: Final = 0.1
"""Effective share of weighted draws below which a few of them are said to decide."""

MIXED: Final = 1.1
"""R-hat of the log joint above which draws that count equally are said not to have mixed."""

_NAMES: Final = {"goal_red": "red", "goal_green": "green"}
_NAMED: Final = 2
"""Goals that are named where particles disagree."""


def verdict(found: Mapping[str, Any]) -> str:
    """Return in a few sentences whether the posterior with these diagnostics can be trusted.

    Args:
        found: what :func:`phase_ppl.analysis.diagnostics.diagnostics` returns.
    """
    if found["weighted_draws_ess"] is None:
        sentences = [
            _agreement(found),
            *_acceptance(found["acceptance_rate"]),
            *_mixing(found),
            *_other_leaders(found["categories"]),
        ]
    else:
        sentences = [_weighted(found)]
    if found["weights"] == "visited":
        sentences.append(
            "The weights 'visited' are an approximation; simulations stopped early hide at most "
            f"{found['aborted_mass_bound']:.1%} of their mass."
        )
    elif found["weights"] == "likelihood":
        sentences.append("The weights 'likelihood' make every probability too extreme.")
    if found["validity"] == "approximate":
        sentences.append(
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
    simulations = found["simulations"]
    if simulations["failed"]:
        sentences.append(f"{simulations['failed']} of {simulations['total']} simulations failed.")
    return " ".join(sentences)


def _agreement(found: Mapping[str, Any]) -> str:
    particles = found["particles"]
    if particles == 1:
        return "With one particle nothing shows whether another would agree: use more."
    error = max(found["monte_carlo_error"].values())
    margin = f"(Monte-Carlo error of a leading goal's probability: {error:.2f})"
    split = [name for name, share in found["agreement"].items() if share < AGREED]
    if not split:
        return (
            f"The {particles} particles agree on both agents' goals {margin}: "
            "nothing speaks against the leading goals."
        )
    camps = {name: _camps(found["leading_goals"][name]) for name in split}
    if len(split) == 1:
        agreed = next(name for name in _NAMES if name not in split)
        text = f"agree on {_NAMES[agreed]}'s goal but not on {_NAMES[split[0]]}'s"
        text += f", where {camps[split[0]]}"
    else:
        text = "agree on neither agent's goal: " + "; ".join(
            f"for {_NAMES[name]}, {camp}" for name, camp in camps.items()
        )
    return (
        f"The {particles} particles {text} {margin}. More iterations would tell real "
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


def _acceptance(rate: float) -> list[str]:
    if rate == 0:
        return ["No proposal was accepted: this is still the bottom-up guess, not a posterior."]
    if rate < STUCK:
        return [
            f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left "
            "the bottom-up guess."
        ]
    return []


def _mixing(found: Mapping[str, Any]) -> list[str]:
    """Return what R-hat says where every draw counts, or why there is none."""
    draws = found["iterations"]
    if draws < MIN_DRAWS:
        return [
            f"R-hat and effective sample sizes need {MIN_DRAWS} draws per particle; "
            f"there {'is' if draws == 1 else 'are'} {draws}."
        ]
    r_hat = found["scalars"]["log_joint"]["r_hat"]
    sentences = []
    if found["weights"] == "count" and r_hat is not None and r_hat > MIXED:
        sentences.append(
            f"The log joint's R-hat of {r_hat:.2f} (1 where chains have mixed) says that the "
            "draws still depend on where the particles began."
        )
    if draws < MIN_DRAWS_WITHIN and found["particles"] < MIN_CHAINS_BETWEEN:
        sentences.append(
            f"Effective sample sizes need {MIN_DRAWS_WITHIN} draws per particle, or "
            f"{MIN_CHAINS_BETWEEN} particles."
        )
    return sentences


def _other_leaders(categories: Mapping[str, Any]) -> list[str]:
    """Return for which agent the weighting puts another goal first than the draws do."""
    sentences = []
    for name, agent in _NAMES.items():
        goals = categories[name]
        first = max(goals, key=lambda goal: goals[goal]["probability"])
        if goals[first]["share"] < max(entry["share"] for entry in goals.values()):
            sentences.append(f"The weights put another goal of {agent} first, '{first}'.")
    return sentences


def _weighted(found: Mapping[str, Any]) -> str:
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    text = f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones"
    if found["particles"] > 1:
        error = max(found["monte_carlo_error"].values())
        text += f" (Monte-Carlo error of a leading goal's probability: {error:.2f})"
    return f"{text}: so few decide that another run may well differ." if ess < FEW else f"{text}."
