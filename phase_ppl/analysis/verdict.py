"""Whether a posterior can be trusted: an answer, what was checked, and what to do next."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

from phase_ppl.analysis.estimate import with_error
from phase_ppl.analysis.with_arviz import MIN_CHAINS_BETWEEN, MIN_DRAWS, MIN_DRAWS_WITHIN
from phase_ppl.world.picture import LABEL, wrapped

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


State = Literal["ok", "doubt", "fail", "unknown"]
_MARKS: Final[Mapping[State, str]] = {"ok": "+", "doubt": "!", "fail": "x", "unknown": "?"}
_WORST_FIRST: Final = ("fail", "doubt", "unknown", "ok")
_COLOURS: Final[Mapping[State, str]] = {
    "ok": "#1a7f37",
    "doubt": "#9a6700",
    "fail": "#cf222e",
    "unknown": "#57606a",
}
_NAME, _VALUE = 24, 29  # columns of a list of checks


class Check(NamedTuple):
    """One thing that was looked at, to see whether an answer can be trusted."""

    name: str
    state: State  # "fail": do not trust the answer; "doubt": it is not certain
    value: str  # what was found
    limit: str  # what it takes to pass
    says: str = ""  # what that means, in a sentence or two
    advice: str = ""  # what to do about it


def check(name: str, state: State, value: str, limit: str, says: str = "", do: str = "") -> Check:
    """Return a check; there is nothing to do where it was passed."""
    return Check(name, state, value, limit, says, do if state in ("fail", "doubt") else "")


JUDGED: Final = ("trust", "answer", "checks", "next", "verdict")
"""Keys that :func:`judged` makes."""


def judged(
    leaders: Mapping[str, Mapping[str, Any]], checks: Sequence[Check], closing: str = ""
) -> dict[str, Any]:
    """Return the end of a record of diagnostics.

    ``trust`` ("confident", "not certain", "do not trust"), the ``answer`` in a line, the
    ``checks``, what to do ``next``, and the ``verdict``: what the checks say in sentences, the
    worst first, or the ``closing`` where none says anything.
    """
    states = {one.state for one in checks}
    trust = "not certain" if "doubt" in states else "confident"
    trust = "do not trust" if "fail" in states else trust
    ordered = sorted(checks, key=lambda one: _WORST_FIRST.index(one.state))
    said = " ".join(one.says for one in ordered if one.says)
    return {
        "trust": trust,
        "answer": f"{_answer(leaders)}. {_TRUST[trust]}",
        "checks": [one._asdict() for one in checks],
        "next": next((one.advice for one in ordered if one.advice), _ONWARD),
        "verdict": said or closing,
    }


_TRUST: Final = {
    "confident": "The computation can be trusted.",
    "not certain": "The computation is not certain.",
    "do not trust": "Do not trust it yet.",
}
_ONWARD: Final = "post.over_time() and post.why(...) show which frames the answer rests on"


def _answer(leaders: Mapping[str, Mapping[str, Any]]) -> str:
    goals = [name for name in leaders if name.startswith(_GOAL)]
    parts = [f"{_agent(name)}: {_probable(leaders[name])}" for name in goals]
    for name in leaders:
        if name == "relation":
            parts.append(_probable(leaders[name]))
        elif name not in goals:
            parts.append(f"{_pair(name)}: {_probable(leaders[name])}")
    return "; ".join(parts)


def _pair(name: str) -> str:
    return name.removeprefix("relation_").replace("_", " and ")


def _probable(leader: Mapping[str, Any]) -> str:
    return f"{leader['label']} ({leader['probability']:.2f})"


def verdict_lines(found: Mapping[str, Any]) -> list[str]:
    """Return the answer, the checks, what the worst one says, and the next step, as lines."""
    shown = list(wrapped("answer", found["answer"]))
    label = "checks"
    for one in found["checks"]:
        row = f"{one['name']:<{_NAME}}{one['value']:<{_VALUE}}{one['limit']}"
        shown.append(f"{label:<{LABEL}}{_MARKS[one['state']]} {row}".rstrip())
        label = ""
    worst = min(found["checks"], key=lambda one: _WORST_FIRST.index(one["state"]), default=None)
    if worst is not None and worst["state"] != "ok":
        shown += wrapped("why", worst["says"] or worst["name"])
    return [*shown, *wrapped("next", found["next"])]


def as_html(found: Mapping[str, Any]) -> str:
    """Return the answer, the checks as a coloured list, and the next step."""
    rows = []
    for one in found["checks"]:
        mark = f'<strong style="color:{_COLOURS[one["state"]]}">{_MARKS[one["state"]]}</strong>'
        says = f"<br><small>{html.escape(one['says'])}</small>" if one["state"] != "ok" else ""
        value, limit = html.escape(one["value"]), html.escape(one["limit"])
        name = f"<strong>{html.escape(one['name'])}</strong>"
        rows.append(f"<li>{mark} {name}: {value} <small>({limit})</small>{says}</li>")
    return (
        f"<p><strong>{html.escape(found['answer'])}</strong></p><ul>{''.join(rows)}</ul>"
        f"<p>Next: {html.escape(found['next'])}</p>"
    )


# --- of chains and weighted draws -----------------------------------------------------------------

_CLOSED_LOOP: Final = "leave the kernel out: ppl.infer(event, model)"


def of_draws(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether a posterior of draws or simulations with these diagnostics can be trusted."""
    weighted = found["weighted_draws_ess"] is not None
    closing = "Nothing speaks against the leading answers."
    return judged(found["leaders"], list(_of_draws(found, weighted)), closing)


def _of_draws(found: Mapping[str, Any], weighted: bool) -> Iterator[Check]:
    longer = f"{_more(found)}, or {_CLOSED_LOOP}"
    yield from _apart(found["overlapping_frames"])
    if found["weights"] == "likelihood":
        says = "The weights 'likelihood' make every probability too extreme."
        yield check("weights", "fail", "likelihood", "any other", says, 'weights="count"')
    if found["validity"] == "approximate" and found["weights"] != "stratified":
        says = (
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
        yield check("kernel", "doubt", "approximate", "exact", says, 'kernel="local_mh"')
    yield from _enough(found, longer)
    yield _decided(found["leaders"], longer)
    yield from _by_prior(found)
    yield from _tried(found, longer)
    rate = found["acceptance_rate"]
    if not weighted:
        says = ""
        if rate == 0:
            says = "No proposal was accepted: this is still the bottom-up guess, not a posterior."
        elif rate < STUCK:
            says = (
                f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left "
                "the bottom-up guess."
            )
        state: State = "fail" if rate == 0 else "doubt" if says else "ok"
        yield check(
            "proposals accepted", state, f"{rate:.0%}", f"{STUCK:.0%} or more", says, longer
        )
        yield from _agreement(found, longer)
        yield _mixing(found, longer)
        yield from _other_leaders(found["categories"])
    elif found["weights"] == "count":  # else all simulations count, not the draws alone
        yield _worth(found, longer)
    simulations = found["simulations"]
    if n := simulations["failed"]:
        says = f"{n} of {simulations['total']} simulations failed."
        yield check("simulations succeeded", "doubt", f"{n} failed", "all", says)


def _more(found: Mapping[str, Any]) -> str:
    """Return how to ask for more simulations."""
    draws, particles = found["iterations"], found["particles"]
    if draws == 1 and found["weighted_draws_ess"] is not None:
        return f"take more particles: chains={4 * particles}"  # a population
    return f"run longer: iterations={max(40, 4 * draws)}"


def _enough(found: Mapping[str, Any], longer: str) -> Iterator[Check]:
    needed, size = found["effective_size_needed"], found["effective_size"]
    name = "enough simulations"
    if needed is None:
        says = (
            "Not enough: goals that the video suggests fit no better than chance, and goals with "
            f"{found['untried']:.2f} of the prior's mass were never simulated to the end."
        )
        learns = 'if simulations take milliseconds, kernel="amis" learns what fits; else '
        can_learn = found["kernel"] != "amis" and len(found["agreement"]) <= 2
        advice = learns * can_learn + longer
        yield check("suggestions fit", "fail", "no better than chance", "better", says, advice)
    elif size is None:
        says = "With one particle nothing tells how much another run would differ."
        yield check(name, "unknown", "one particle", "2 or more", says)
    else:
        says = ""
        if size < needed:
            says = (
                f"Not enough: the goals rest on {size:.1f} effective simulations; an answer needs "
                f"{needed:g}. Another run may well differ."
            )
        state: State = "fail" if says else "ok"
        yield check(name, state, f"{size:.1f} effective", f"{needed:g} or more", says, longer)


def _decided(leaders: Mapping[str, Mapping[str, Any]], longer: str) -> Check:
    sure = sum(one["sure"] for one in leaders.values())
    says = " ".join(undecided(leaders))
    state: State = "doubt" if says else "ok"
    value = f"{sure} of {len(leaders)}, beyond errors"
    return check("answers above 1/2", state, value, "all", says, longer)


def _tried(found: Mapping[str, Any], longer: str) -> Iterator[Check]:
    n, untried = found["untried_rivals"], found["untried"]
    says = (
        f"Not ruled out: {n} rival{'' if n == 1 else 's'} of the leading goals, with another "
        f"landmark for one agent, {'was' if n == 1 else 'were'} never simulated."
    )
    if n:
        yield check("rivals tried", "doubt", f"{n} untried", "none untried", says, longer)
    else:
        yield check("rivals tried", "ok", "all", "none untried")
    if untried is None or found["effective_size_needed"] is None:  # then it is said
        return
    says = (
        f"{_combined(found).capitalize()} with {untried:.2f} of the prior's mass were never "
        "simulated to the end, and count as impossible."
    )
    few = untried >= UNTRIED
    state: State = "unknown" if few else "ok"
    limit = f"{1 - UNTRIED:.2f} or more"
    yield check("goals simulated", state, f"{1 - untried:.2f} of the prior", limit, says * few)


def _margin(found: Mapping[str, Any]) -> str:
    errors = [error for error in found["monte_carlo_error"].values() if error is not None]
    if not errors:
        return ""
    return f"(Monte-Carlo error of a leading goal's probability: {max(errors):.2f})"


def _split(found: Mapping[str, Any]) -> list[str]:
    return [name for name, share in found["agreement"].items() if share < AGREED]


def _agreement(found: Mapping[str, Any], longer: str) -> Iterator[Check]:
    particles, split, name = found["particles"], _split(found), "particles agree"
    limit = f"{AGREED:.0%} or more"
    if particles == 1:
        says = "With one particle nothing shows whether another would agree: use more."
        yield check(name, "unknown", "one particle", limit, says)
        return
    least = min(found["agreement"].values())
    value = f"{least:.0%} on each goal"
    if not split:
        whose = _by_agents(found, "the agent's goal", "both agents' goals", "all agents' goals")
        says = f"The {particles} particles agree on {whose} {_margin(found)}".rstrip() + "."
        yield check(name, "ok", value, limit, says)
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
    says = (
        f"The {particles} particles {text} {_margin(found)}. More iterations would tell real "
        "uncertainty from chains that have not mixed."
    )
    yield check(name, "doubt", value, limit, says, longer)


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


def _mixing(found: Mapping[str, Any], longer: str) -> Check:
    """Return whether chains differ more than draws of one law do."""
    worst = {"the log joint": found["scalars"]["log_joint"]["r_hat"]}
    for name, labels in found["categories"].items():
        of_labels = [one["r_hat"] for one in labels.values() if one["r_hat"] is not None]
        worst[_titled(name)] = max(of_labels, default=None)
    known = {name: r for name, r in worst.items() if r is not None}
    draws, limit, name = found["iterations"], f"{MIXED:g} or less", "chains have mixed"
    if draws < MIN_DRAWS or not known:
        says = (
            f"R-hat and effective sample sizes need {MIN_DRAWS} draws per particle; "
            f"there {'is' if draws == 1 else 'are'} {draws}."
        )
        if draws >= MIN_DRAWS:
            says = "R-hat does not exist where nothing changes within half a chain."
        value = f"{draws} draw{'' if draws == 1 else 's'} each"
        return check(name, "unknown", value, limit, says)
    of = max(known, key=lambda name: known[name])
    value = f"R-hat {known[of]:.2f} of {of}"
    apart = [f"{name} {r:.2f}" for name, r in known.items() if r > MIXED]
    says = ""
    if apart:
        says = (
            "The chains still depend on where they began: R-hat (1 where they have mixed) is "
            f"{', '.join(apart)}."
        )
    elif draws < MIN_DRAWS_WITHIN and found["particles"] < MIN_CHAINS_BETWEEN:
        says = (
            f"Effective sample sizes need {MIN_DRAWS_WITHIN} draws per particle, or "
            f"{MIN_CHAINS_BETWEEN} particles."
        )
    return check(name, "doubt" if apart else "ok", value, limit, says, longer)


def _other_leaders(categories: Mapping[str, Any]) -> Iterator[Check]:
    """Yield for which agent the weighting puts another goal first than the draws do."""
    for name, goals in categories.items():
        if not name.startswith(_GOAL):
            continue
        agent = _agent(name)
        first = max(goals, key=lambda goal: goals[goal]["probability"])
        if goals[first]["share"] < max(entry["share"] for entry in goals.values()):
            says = f"The weights put another goal of {agent} first, '{first}'."
            yield check("weights and draws", "doubt", f"differ on {agent}", "the same goal", says)


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


def _by_prior(found: Mapping[str, Any]) -> Iterator[Check]:
    """Yield whether the video decides what is sure, or the prior."""
    known = {
        name: one
        for name, one in found["leaders"].items()
        if one["sure"] and one["without_prior"] is not None
    }
    if not known:
        return
    # rounded down, so that what is short of a limit is not shown as it
    shown = {n: f"{math.floor(100 * one['without_prior']) / 100:.2f}" for n, one in known.items()}
    below, said = 0.0, []
    for most, says in (
        (0.5, "The prior decides, not the video"),
        (ALONE, f"The video alone does not decide, which takes {ALONE}"),
    ):
        names = [
            f"{shown[name]} for {_asked(name)} '{one['label']}'"
            for name, one in known.items()
            if below <= one["without_prior"] <= most
        ]
        below = math.nextafter(most, 1)
        if names:
            said.append(
                f"{says}: with all {_combined(found)} alike beforehand there would be "
                f"{' and '.join(names)}."
            )
    least = min(known, key=lambda name: known[name]["without_prior"])
    state: State = "doubt" if said else "ok"
    value = f"{shown[least]} were goals alike before"
    yield check("the video decides", state, value, f"above {ALONE}", " ".join(said))


def _worth(found: Mapping[str, Any], longer: str) -> Check:
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    text = f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones {_margin(found)}"
    few = ": so few decide that another run may well differ."
    too_few = ess < FEW and ess * draws < (found["effective_size_needed"] or math.inf)
    says = text.rstrip() + (few if too_few else ".")
    state: State = "doubt" if too_few else "ok"
    value = f"worth {ess:.0%}, {ess * draws:.1f} of {draws}"
    return check("weighted draws", state, value, f"{FEW:.0%} or more", says, longer)


# --- of a reading step by step --------------------------------------------------------------------

UNEXPLAINED: Final = 17.0
"""Nats below a perfect match, after the best joint action, from which on a frame counts as
explained by no action: one body some 3 units from where it could be. 41 real videos without noise
have none (16 at most); of the model's own videos, whose positions have noise of heavy tails, 3 %
of the frames come to as much (``benchmarks/stepwise.py calibration``)."""

SURPRISE: Final = 4.0
"""Nats by which what was done was less probable than one sure action, beyond what is unexplained;
the model's own videos have ``SURPRISING`` of their frames above it
(``benchmarks/stepwise.py calibration``)."""

SURPRISING: Final = 0.1
TOO_SURPRISING: Final = 0.5
"""Share of such frames from which on the agents are said not to do what any goals make likely."""

DISAGREE: Final = 0.1
"""Standard error of a leading probability from which on the sets of searches disagree."""


def of_reading(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether a posterior that was read step by step can be trusted."""
    checks = list(_of_reading(found))
    own, samples, n_sets = found["samples"] is not None, found["samples"], found["planner_seeds"]
    worst = max((one["error"] or 0.0 for one in found["leading"].values()), default=0.0)
    agree = f"agree (largest standard error of a leading probability: {worst:.2g})."
    if own:
        closing = f"Samples come near every frame, and their {n_sets} parts {agree}"
        if not samples:
            closing = (
                "The simulator's own density was summed over all hypotheses: there is no error "
                "but the model's."
            )
    else:
        share = found["surprising_share"] or 0.0
        closing = (
            f"Actions explain every frame, {1 - share:.0%} of them are such as the model expects, "
            f"and the {n_sets} sets of searches {agree}"
        )
    return judged(found["leading"], checks, closing)


def _of_reading(found: Mapping[str, Any]) -> Iterator[Check]:
    n, n_sets, samples = found["frames"] - 1, found["planner_seeds"], found["samples"]
    own = samples is not None
    if n == 0:
        says = "Nothing was seen but the start: this is the prior."
        yield check("frames seen", "doubt", "the start", "2 or more", says, "watch further frames")
        return
    yield _explained(found, own)
    yield from _apart(found["overlapping_frames"])
    if not own:
        yield _expected(found)
    more = _more_sets(n_sets, samples)
    yield _decided(found["leading"], "" if own and not samples else more)
    yield from _searched(found, own)


def _more_sets(n_sets: int, samples: int | None) -> str:
    given = f"samples={4 * samples}" if samples else f"planner_seeds={max(4, 2 * n_sets)}"
    return f"search more: likelihood=ppl.StepwiseLikelihood({given})"


def _explained(found: Mapping[str, Any], own: bool) -> Check:
    frames, most = found["unexplained_frames"], found["unexplained_most"]
    name = "frames are explained"
    if frames:
        which = frames_text(frames)
        says = (
            f"No sample of the simulator comes near {which}: its tails decide, of which samples "
            "say nothing."
            if own
            else f"No action explains {which}: a body is where nothing could have put it. The "
            "probabilities hold only for a video that this is not."
        )
        n = len(frames)
        value = f"all but {n}"
        return check(name, "fail", value, "all", says, "check the tracks of these frames")
    value = "all" if most is None else f"all, within {most:.0f} nats"
    return check(name, "ok", value, "all" if most is None else f"{UNEXPLAINED:.0f} nats")


def _expected(found: Mapping[str, Any]) -> Check:
    share, name, limit = found["surprising_share"], "agents act as expected", TOO_SURPRISING
    if share is None:
        says = "Nothing was kept that would tell whether the model expects such a video."
        return check(name, "unknown", "not kept", f"{limit:.0%} or more", says)
    says = ""
    if share > limit:
        says = (
            f"{share:.0%} of the frames surprise whatever the goals, where the model's own videos "
            f"have {SURPRISING:.0%}: these agents act otherwise than it expects."
        )
    value = f"in {1 - share:.0%} of the frames"
    return check(name, "fail" if says else "ok", value, f"{1 - limit:.0%} or more", says)


def _searched(found: Mapping[str, Any], own: bool) -> Iterator[Check]:
    n_sets, samples = found["planner_seeds"], found["samples"]
    sets = "parts of the samples" if own else "sets of searches"
    name = "samples agree" if own else "searches agree"
    if n_sets == 1:
        if not own:
            says = (
                "With one set of searches nothing tells how much of this is the planner's chance."
            )
            yield check(name, "unknown", "one set", "2 sets or more", says)
        return
    errors = {key: one["error"] for key, one in found["leading"].items()}
    worst = max(errors, key=lambda key: errors[key] if errors[key] == errors[key] else 0.0)
    error, says, more = errors[worst], "", ""
    if error > DISAGREE:
        more = _more_sets(n_sets, samples)
        says = (
            f"The {n_sets} {sets} disagree on {_asked(worst)} (standard error {error:.2f}): "
            "use more."
        )
    value, limit = f"error {error:.2g}, {n_sets} sets", f"{DISAGREE:g} or less"
    yield check(name, "doubt" if says else "ok", value, limit, says, more)


def _apart(frames: list[int]) -> Iterator[Check]:
    """Yield what the frames in which bodies lie on each other say of a posterior, if there are."""
    if frames:
        says = (
            f"Bodies lie on each other or in a wall in {frames_text(frames)}, which bodies of this "
            "world cannot: what they do there says little of goals."
        )
        do = "check the tracks of these frames"
        yield check("bodies are apart", "fail", f"not in {len(frames)} frames", "always", says, do)


def frames_text(frames: list[int]) -> str:
    """Return frames by number, the first few if they are many."""
    named = ", ".join(map(str, frames[:_FRAMES_NAMED]))
    if len(frames) > _FRAMES_NAMED:
        return f"{len(frames)} frames ({named}, ...)"
    return f"frame{'s' if len(frames) > 1 else ''} {named}"
