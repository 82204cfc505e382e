"""Verdict on whether to trust a posterior: its answer, the checks, and what to do next."""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.analysis.estimate import with_error
from phase_ppl.analysis.with_arviz import MIN_DRAWS
from phase_ppl.data.motion import odd_pace
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import overlaps
from phase_ppl.world.picture import LABEL, wrapped
from phase_ppl.world.scene import Scene

AGREED: Final = 0.8
"""Least share of particles with the same leading goal at which they agree."""

STUCK: Final = 0.05  # acceptance rate below which the particles hardly moved
FEW: Final = 0.1  # effective share of weighted draws below which a few of them decide

FAILED: Final = 0.1  # share of simulations above which their failures decide

MIXED: Final = 1.1  # R-hat above which draws depend on the start of their chain

ALONE: Final = 0.99
"""Probability under a uniform prior over goal pairs that a decided answer needs. It is high because
mean likelihoods of few simulations err by nats (``benchmarks/decided.py``)."""

UNTRIED: Final = 0.05
"""Prior mass of untried pairs of goals from which on the verdict mentions it."""

UNEXPLAINED: Final = 17.0
"""Nats below a perfect match, after the best joint action, at which no action explains a frame: one
body is some 3 units from where it could be. 41 real videos without noise have no such frame (16
nats at most). The model's own videos have noise with heavy tails: 3 % of their frames reach it
(``benchmarks/closed_loop.py calibration``)."""

SURPRISE: Final = 4.0
"""Nats by which the observed actions were less probable than one certain action, beyond what no
action explains. A share ``SURPRISING`` of the frames of the model's own videos is above it
(``benchmarks/closed_loop.py calibration``)."""

SURPRISING: Final = 0.1
TOO_SURPRISING: Final = 0.5
"""Share of such frames from which on the agents do not act as the model expects."""

DISAGREE: Final = 0.15
"""Standard error of a leading probability from which on the sets of searches disagree."""

_LOOKS: Final[Mapping[str, tuple[str, str, str]]] = {
    "fail": ("x", "#cf222e", "failed"),
    "doubt": ("!", "#9a6700", "doubt"),
    "unknown": ("?", "#57606a", "cannot tell"),
    "ok": ("+", "#1a7f37", "passed"),
}
"""State -> its mark, colour and meaning, the worst state first."""

_CLOSED_LOOP: Final = "use the closed loop: infer without kernel="
_TRACKS: Final = "check the tracks of these frames"
_RATE: Final = (
    "a frame is a twelfth of a second, and tracks with another number of frames a second are read "
    "by phase_ppl.Observation.at_rate(trajectory, fps)"
)
ODD_PACE: Final = {
    "slow": "agents change their speed less than the floor's friction alone would make them; "
    f"{_RATE}",
    "fast": f"agents change their speed more than the strongest push could make them; {_RATE}",
}
"""What is odd about tracks that no agents of a world can make."""

_SUCCEEDED: Final = "simulations succeeded"
_ANSWERS: Final = "answers above 1/2"
_APART: Final = ". Each is the most probable by itself"
_NAMED: Final = 3  # frames that are named
_GOAL: Final = "goal_"  # begins the names of goals

Record = Mapping[str, Any]


class Check(NamedTuple):
    """One check of whether an answer can be trusted."""

    name: str
    state: str  # "fail": do not trust the answer; "doubt": it is not certain
    value: str  # the value found
    limit: str  # the limit for passing
    says: str = ""  # meaning of not passing
    advice: str = ""  # remedy


def judged(leaders: Record, checks: Sequence[Check], closing: str = "") -> dict[str, Any]:
    """Return the verdict part of a record of diagnostics.

    Keys: ``trust`` ("confident", "not certain", "do not trust"), the ``answer`` in a line, the
    ``checks``, what to do ``next``, and the ``verdict``. The verdict has the texts of failed
    checks, the worst first, or else ``closing``.
    """
    checks = [one._replace(says="", advice="") if one.state == "ok" else one for one in checks]
    ordered = sorted(checks, key=lambda one: list(_LOOKS).index(one.state))
    worst = ordered[0].state if ordered else "ok"
    trust = {"fail": "do not trust", "doubt": "not certain"}.get(worst, "confident")
    said = trust.capitalize()
    if [(one.name, one.advice) for one in ordered if one.state != "ok"] == [(_ANSWERS, "")]:
        said += ": the computation is fine, but the video does not decide"
    parts = [
        f"{_of(name)}{one['label']} ({one['probability']:.2f})" for name, one in leaders.items()
    ]
    apart = any(
        one.get("of_leading_goals", one["label"]) != one["label"] for one in leaders.values()
    )
    return {
        "trust": trust,
        "answer": f"{'; '.join(parts)}{_APART if apart else ''}. {said}.",
        "checks": [one._asdict() for one in checks],
        "next": next((one.advice for one in ordered if one.advice), _onward(leaders)),
        "verdict": " ".join(one.says for one in ordered if one.says) or closing,
    }


def _onward(leaders: Record) -> str:
    """Return what to ask of an answer that needs nothing more."""
    *_, (name, one) = leaders.items()
    asked = f"post.why('{name} = {one['label']}')"
    return f"post.over_time(), {asked}: what each frame says"


def _of(name: str) -> str:
    """Return in words whose goal or relation this is, before its label."""
    if name == "relation":
        return ""
    name = name.removeprefix(_GOAL).removeprefix("relation_")
    return f"{name.replace('_', ' and ')}: "


def _asked(name: str) -> str:
    """Return in words what a goal or relation is of."""
    if name.startswith(_GOAL):
        return f"{name.removeprefix(_GOAL)}'s goal"
    return "the relation" if name == "relation" else name.replace("_", " ")


def verdict_lines(found: Record) -> list[str]:
    """Return the answer, the checks, the worst one's text and the next step, as lines."""
    shown, label = list(wrapped("answer", found["answer"])), "checks"
    for one in found["checks"]:
        row = f"{_LOOKS[one['state']][0]} {one['name']:<24}{one['value']:<28} {one['limit']}"
        shown.append(f"{label:<{LABEL}}{row}".rstrip())
        label = ""
    if legend := _legend(found):
        shown.append(f"{'':<{LABEL}}({legend})")
    said = [one["says"] for state in _LOOKS for one in found["checks"] if one["state"] == state]
    # an error in a user's code is told, also where another check is worse
    errors = [one["says"] for one in found["checks"] if one["name"] == _SUCCEEDED]
    for text in filter(None, dict.fromkeys([*said[:1], *errors])):
        shown += wrapped("why", text)
    return [*shown, *wrapped("next", found["next"])]


def _legend(found: Record) -> str:
    """Return what the marks of the checks mean, if not all passed."""
    states = {one["state"] for one in found["checks"]}
    marks = [f"{mark} {means}" for state, (mark, _, means) in _LOOKS.items() if state in states]
    return "; ".join(marks) if states != {"ok"} else ""


def as_html(found: Record) -> str:
    """Return the answer, the checks as a coloured list, and the next step."""
    rows = []
    for one in found["checks"]:
        mark, colour, _ = _LOOKS[one["state"]]
        name, value, limit, says = (
            html.escape(one[key]) for key in ("name", "value", "limit", "says")
        )
        rows.append(
            f'<li><strong style="color:{colour}">{mark}</strong> <strong>{name}</strong>: {value} '
            f"<small>({limit})</small>{says and f'<br><small>{says}</small>'}</li>"
        )
    return (
        f"<p><strong>{html.escape(found['answer'])}</strong></p><ul>{''.join(rows)}</ul>"
        f"<p><small>{_legend(found)}</small></p><p>Next: {html.escape(found['next'])}</p>"
    )


# --- of the tracks --------------------------------------------------------------------------------

_SHRUNK: Final = 0.8
"""Overlap, as a share of their size, at which bodies count as overlapping: in contact they press
into each other a little."""


def overlapping_frames(trajectory: FloatArray, scene: Scene) -> list[int]:
    """Return the frames in which bodies overlap each other or a wall."""
    radius, walls, n_agents = scene.radius, scene.walls, len(scene.world.agents)
    small = _SHRUNK * radius
    near = np.full(len(trajectory), len(walls) > 0)
    for one, other in itertools.combinations(range(trajectory.shape[1]), 2):
        apart = np.hypot(*(trajectory[:, one, :2] - trajectory[:, other, :2]).T)
        # an agent reaches 3 radii from its origin at most
        near |= apart < 3 * (radius[one] + radius[other])
    frames = np.flatnonzero(near).tolist()
    return [t for t in frames if overlaps(trajectory[t], small, walls, n_agents)]


def of_tracks(trajectory: FloatArray, scene: Scene, joint: bool) -> dict[str, Any]:
    """Return what diagnostics have of the trajectories themselves.

    Keys: ``n_frames``; ``unseen_frames``, in which each entity, or an agent's angle, was not seen,
    of those that were not at times; and ``sealed_agents``, who start in a room without a door.
    What the joint simulator alone cannot do: ``overlapping_frames``, in which bodies overlap each
    other or a wall, else none; and ``odd_pace``, see :func:`phase_ppl.data.motion.odd_pace`, else
    "".
    """
    rooms, agents = scene.rooms, scene.world.agents
    starts = rooms.room_of(scene.start[: len(agents), :2]).tolist()
    gone = dict(zip(scene.world.entities, np.isnan(trajectory[..., 0]).T, strict=True))
    turned = zip(agents, np.isnan(trajectory[..., 2]).T, strict=False)  # items' angles say nothing
    gone |= {f"{name}'s angle": unseen & ~gone[name] for name, unseen in turned}
    return {
        "n_frames": len(trajectory),
        "overlapping_frames": overlapping_frames(trajectory, scene) if joint else [],
        "odd_pace": odd_pace(trajectory, scene) if joint else "",
        "sealed_agents": [
            name
            for name, room in zip(agents, starts, strict=True)
            if len(rooms) > 1 and not rooms.exits(room)
        ],
        "unseen_frames": {
            name: np.flatnonzero(unseen).tolist() for name, unseen in gone.items() if unseen.any()
        },
    }


# --- of draws, and of the closed loop -------------------------------------------------------------


def _of_tracks(found: Record) -> Iterator[Check]:
    """Yield the checks of what was seen itself that it does not pass."""
    if frames := found["overlapping_frames"]:
        says = (
            f"Bodies lie on each other or in a wall in {_frames(frames)}, which bodies of this "
            "world cannot: what they do there says little of goals."
        )
        value = f"not in {len(frames)} frames"
        yield Check("bodies are apart", "fail", value, "always", says, _TRACKS)
    if pace := found["odd_pace"]:
        says = f"{ODD_PACE[pace][0].upper()}{ODD_PACE[pace][1:]}."
        value = f"too {pace}"
        yield Check("agents move as they can", "fail", value, "as pushes do", says, "check fps")
    if sealed := found["sealed_agents"]:
        who = f"The {' and the '.join(sealed)} {'starts' if len(sealed) == 1 else 'start'}"
        says = (
            f"{who} in a room that walls close: no goal elsewhere can be reached from there, so "
            "what is done there says little of such goals. Check the walls of the scene."
        )
        yield Check("agents can leave their room", "unknown", ", ".join(sealed), "all", says)
    if unseen := found["unseen_frames"]:
        told = ", ".join(f"{name} in {_frames(frames)}" for name, frames in unseen.items())
        says = (
            f"Not seen: {told}. There the frames say nothing of it; it is the model's guess, and "
            "what was done unseen counts for no goal."
        )
        value = f"not in {len(set().union(*unseen.values()))} of {found['n_frames']} frames"
        yield Check("all bodies are seen", "unknown", value, "always", says)


def _frames(frames: list[int]) -> str:
    """Return frames by number, the first few if they are many."""
    named = ", ".join(map(str, frames[:_NAMED]))
    if len(frames) > _NAMED:
        return f"{len(frames)} frames ({named}, ...)"
    return f"frame{'s' if len(frames) > 1 else ''} {named}"


def _decided(leaders: Record, advice: str) -> Check:
    """Return the check of whether leading answers are surely above 1/2.

    The advice is for answers that smaller errors could decide.
    """
    unsure = {name: one for name, one in leaders.items() if not one["sure"]}
    told = [f"{_asked(name)} {_rivalling(one)}" for name, one in unsure.items()]
    says = f"Not decided: {'; '.join(told)}."
    if not any(_may_be_sure(one) for one in unsure.values()):
        says, advice = f"{says} Smaller errors would not decide it.", ""
    value = f"{len(leaders) - len(unsure)} of {len(leaders)}, allowing for errors"
    return Check(_ANSWERS, "doubt" if unsure else "ok", value, "all", says, advice)


def _rivalling(one: Record) -> str:
    """Return in words the leading answer, the next, and those about as probable."""
    error = math.nan if one["error"] is None else one["error"]
    named = [f"'{one['label']}' ({with_error(one['probability'], error)})"]
    named.append(f"'{one['next']}' ({one['next_probability']:.3g})")
    if len(alike := one["alike"]) == 1:
        named += [f"'{label}' ({probability:.3g})" for label, probability in alike.items()]
    elif alike:
        named.append(f"one of {len(alike)} others about as probable")
    return f"{', '.join(named[:-1])} or {named[-1]}"


def _may_be_sure(one: Record) -> bool:
    """Return whether the leading answer's probability may be above 1/2, given its error."""
    return one["error"] is None or one["probability"] + 2 * one["error"] > 0.5


# --- of chains and weighted draws -----------------------------------------------------------------


def of_draws(found: Record) -> dict[str, Any]:
    """Return the verdict on a posterior of draws or simulations, from its diagnostics."""
    draws, particles, weights = found["iterations"], found["particles"], found["weights"]
    weighted = found["weighted_draws_ess"] is not None
    more = f"run longer: iterations={max(40, 4 * draws)}"
    if draws == 1 and weighted:  # a population
        more = f"take more particles: chains={4 * particles}"
    longer = f"{more}, or {_CLOSED_LOOP}"
    checks = [*_succeeded(found), *_of_tracks(found)]
    if found["validity"] == "approximate" and weights != "stratified":
        says = (
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
        checks.append(Check("kernel", "doubt", "approximate", "exact", says, 'kernel="local_mh"'))
    checks += [_enough(found, longer), _decided(found["leaders"], longer), *_by_prior(found)]
    checks += _tried(found, longer)
    if not weighted:
        checks += [_accepted(found, longer), _agreement(found, longer), _mixing(found, longer)]
        checks += _other_leaders(found["categories"])
    elif weights == "count":  # else all simulations count, not the draws alone
        checks.append(_worth(found, longer))
    return judged(found["leaders"], checks, "Nothing speaks against the leading answers.")


def _succeeded(found: Record) -> Iterator[Check]:
    n, total = found["simulations"]["failed"], found["simulations"]["total"]
    if n:
        first = found["first_failure"]
        says = f"{n} of {total} simulations failed, and count as impossible"
        says += f"; the first, {first}." if first else "."
        state = "fail" if n > FAILED * total else "doubt"
        advice = (
            "mend the simulator, which raises an error or takes too long; on_failure='raise' stops "
            "at the first"
        )
        yield Check(_SUCCEEDED, state, f"{n} of {total} failed", "all", says, advice)


def _enough(found: Record, longer: str) -> Check:
    needed, size = found["effective_size_needed"], found["effective_size"]
    name = "enough simulations"
    if needed is None:
        says = (
            "Not enough: goals that the video suggests fit no better than chance, and goals with "
            f"{found['untried']:.2f} of the prior's mass were never simulated to the end."
        )
        if found["kernel"] != "amis" and len(found["agreement"]) <= 2:
            learns = 'if simulations take milliseconds, kernel="amis" learns what fits'
            longer = f"{learns}; else {longer}"
        return Check("suggestions fit", "fail", "no better than chance", "better", says, longer)
    if size is None:
        says = "With one particle nothing tells how much another run would differ."
        return Check(name, "unknown", "one particle", "2 or more", says)
    says = (
        f"Not enough: the goals rest on {size:.1f} effective simulations; an answer needs "
        f"{needed:g}. Another run may well differ."
    )
    state, value = "fail" if size < needed else "ok", f"{size:.1f} effective, by weight"
    return Check(name, state, value, f"{needed:g} or more", says, longer)


def _by_prior(found: Record) -> Iterator[Check]:
    """Yield the check of whether the video or the prior decides the sure answers."""
    leaders = found["leaders"].items()
    known = {n: one["without_prior"] for n, one in leaders if one["sure"]}
    known = {name: share for name, share in known.items() if share is not None}
    if known:
        # rounded down, so that a value just below a limit does not look like the limit
        shown = {name: f"{math.floor(1000 * share) / 1000:.3f}" for name, share in known.items()}
        short = [f"{shown[name]} for {_asked(name)}" for name in known if known[name] <= ALONE]
        says = (
            f"Under a uniform prior over simulated pairs there would be {' and '.join(short)}: "
            f"above {ALONE} the video decides, up to 1/2 the prior."
        )
        value = f"lowest {min(shown.values())}"
        state = "doubt" if short else "ok"
        yield Check("answers without prior", state, value, f"above {ALONE}", says)


def _tried(found: Record, longer: str) -> Iterator[Check]:
    n, untried = found["untried_rivals"], found["untried"]
    says = f"Never simulated: {n} rival{'s' * (n > 1)} of the leading goals, at another landmark."
    state, value = ("doubt", f"{n} untried") if n else ("ok", "all")
    yield Check("rivals tried", state, value, "all", says, longer)
    if untried is not None and found["effective_size_needed"] is not None:  # else it is said
        says = (
            f"Goals with {untried:.2f} of the prior's mass were never simulated to the end, and "
            "count as impossible."
        )
        # below the bound it is no doubt: some kernels need not try all
        few, limit = "unknown" if untried >= UNTRIED else "ok", f"{1 - UNTRIED:.2f} to tell"
        yield Check("goals simulated", few, f"{1 - untried:.2f} of the prior", limit, says)


def _accepted(found: Record, longer: str) -> Check:
    rate = found["acceptance_rate"]
    state = "fail" if rate == 0 else "doubt" if rate < STUCK else "ok"
    says = (
        f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left the "
        "bottom-up guess."
        if rate
        else "No proposal was accepted: this is still the bottom-up guess, not a posterior."
    )
    limit = f"{STUCK:.0%} or more"
    return Check("proposals accepted", state, f"{rate:.0%}", limit, says, longer)


def _agreement(found: Record, longer: str) -> Check:
    n, name, limit = found["particles"], "particles agree", f"{AGREED:.0%} or more"
    if n == 1:
        says = "With one particle nothing shows whether another would agree: use more."
        return Check(name, "unknown", "one particle", limit, says)
    lowest = min(found["agreement"], key=lambda goal: found["agreement"][goal])
    split = [
        f"on {_asked(goal)}: {_camps(found['leading_goals'][goal])}"
        for goal, share in found["agreement"].items()
        if share < AGREED
    ]
    says = (
        f"The {n} particles do not agree {'; '.join(split)}. Either the video does not decide, or "
        "the chains have not mixed; more iterations would tell."
    )
    value = f"{found['agreement'][lowest]:.0%} on {_asked(lowest)}"
    return Check(name, "doubt" if split else "ok", value, limit, says, longer)


def _camps(leading: Mapping[str, int]) -> str:
    """Return which goals the particles favour: "7 favour 'A', 5 favour 'B', 3 others"."""
    named = [(goal, n) for goal, n in list(leading.items())[:2] if n > 1]
    rest = sum(leading.values()) - sum(n for _, n in named)
    if not named:
        return f"all {rest} favour different ones"
    parts = [f"{n} favour '{goal}'" for goal, n in named]
    parts += [f"{rest} others" if rest > 1 else "1 another"] if rest else []
    return ", ".join(parts)


def _mixing(found: Record, longer: str) -> Check:
    """Return the check of whether chains differ more than draws of one distribution."""
    known = {"the log joint": (found["scalars"]["log_joint"]["r_hat"], "")}
    for name, labels in found["categories"].items():
        each = [(one["r_hat"], f" '{label}'") for label, one in labels.items()]
        known[_asked(name)] = max(each, key=lambda one: one[0] or 0.0, default=(None, ""))
    known = {name: one for name, one in known.items() if one[0] is not None}
    draws, limit, name = found["iterations"], f"{MIXED:g} or less", "chains have mixed"
    if draws < MIN_DRAWS or not known:
        says = "R-hat does not exist where nothing changes within half a chain."
        if draws < MIN_DRAWS:
            says = (
                f"R-hat and effective sample sizes need {MIN_DRAWS} draws per particle; "
                f"there {'is' if draws == 1 else 'are'} {draws}."
            )
        return Check(name, "unknown", f"{draws} draw{'s' * (draws != 1)} each", limit, says)
    of = max(known, key=lambda name: known[name][0])
    apart = [f"{r:.2f} of {name}{label}" for name, (r, label) in known.items() if r > MIXED]
    says = f"R-hat {', '.join(apart)}; below 1.01 chains agree, above {MIXED:g} they do not."
    value = f"R-hat {known[of][0]:.2f} of {of}"
    return Check(name, "doubt" if apart else "ok", value, limit, says, longer)


def _other_leaders(categories: Record) -> Iterator[Check]:
    """Yield a check for each agent whose leading goal differs between weighting and draws."""
    for name, goals in categories.items():
        agent, first = name.removeprefix(_GOAL), max(goals, key=lambda g: goals[g]["probability"])
        others = max(entry["share"] for entry in goals.values()) > goals[first]["share"]
        if name.startswith(_GOAL) and others:
            says = f"The weights put another goal of {agent} first, '{first}'."
            yield Check("weights and draws", "doubt", f"differ on {agent}", "the same goal", says)


def _worth(found: Record, longer: str) -> Check:
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    says = (
        f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones: so few decide that "
        "another run may well differ."
    )
    too_few = ess < FEW and ess * draws < (found["effective_size_needed"] or math.inf)
    state = "doubt" if too_few else "ok"
    value = f"worth {ess:.0%}, {ess * draws:.1f} of {draws}"
    return Check("weighted draws", state, value, f"{FEW:.0%} or more", says, longer)


# --- of the closed loop ---------------------------------------------------------------------------


def of_reading(found: Record) -> dict[str, Any]:
    """Return the verdict on a posterior of the closed loop."""
    n_sets, samples, leaders = found["planner_seeds"], found["samples"], found["leading"]
    users_simulator = samples is not None
    if found["frames"] == 1:
        says = "Nothing was seen but the start: this is the prior."
        see = "watch further frames"
        return judged(leaders, [Check("frames seen", "doubt", "the start", "2 or more", says, see)])
    given = f"samples={4 * samples}" if samples else f"planner_seeds={max(4, 2 * n_sets)}"
    more = f"search more: likelihood=ppl.ClosedLoopLikelihood({given})"
    checks = [_explained(found, users_simulator), *_of_tracks(found)]
    checks += [] if users_simulator else [_expected(found)]
    checks.append(_decided(leaders, "" if users_simulator and not samples else more))
    errors = {key: one["error"] or 0.0 for key, one in leaders.items()}
    worst = max(errors, key=lambda key: errors[key])
    sets, name = (
        ("parts of the samples", "samples") if users_simulator else ("sets of searches", "searches")
    )
    if n_sets > 1:
        says = (
            f"The {n_sets} {sets} disagree on {_asked(worst)} (standard error "
            f"{errors[worst]:.2f}): use more."
        )
        state = "doubt" if errors[worst] > DISAGREE else "ok"
        value = f"answers' errors up to {errors[worst]:.2g}"
        checks.append(Check(f"{name} agree", state, value, f"{DISAGREE:g} or less", says, more))
    elif not users_simulator:
        says = "With one set of searches nothing tells how much of this is the planner's chance."
        checks.append(Check(f"{name} agree", "unknown", "one set", "2 sets or more", says))
    closing = "Samples come near every frame, and their parts agree."
    if not users_simulator:
        closing = "Actions explain every frame, as the model expects them, and the searches agree."
    elif not samples:
        closing = (
            "The simulator's own density was summed over all hypotheses: there is no error but "
            "the model's."
        )
    return judged(leaders, checks, closing)


def _explained(found: Record, users_simulator: bool) -> Check:
    frames, most, name = (
        found["unexplained_frames"],
        found["unexplained_most"],
        "frames are explained",
    )
    if frames:
        says = (
            f"No sample of the simulator comes near {_frames(frames)}: the tails of its density "
            "decide there, and samples say nothing about these."
            if users_simulator
            else f"No action explains {_frames(frames)}: a body is where nothing could have put "
            "it. So do not use the probabilities: this video is outside the model."
        )
        return Check(name, "fail", f"all but {len(frames)}", "all", says, _TRACKS)
    if most is None:
        return Check(name, "ok", "all", "all")
    return Check(name, "ok", f"all, within {most:.0f} nats", f"{UNEXPLAINED:.0f} nats or less")


def _expected(found: Record) -> Check:
    share, name, limit = found["surprising_share"], "agents act as expected", TOO_SURPRISING
    if share is None:
        says = "Nothing was kept that would tell whether the model expects such a video."
        return Check(name, "unknown", "not kept", f"{limit:.0%} or more", says)
    says = (
        f"The agents act otherwise than the model expects: in {share:.0%} of the frames "
        f"their actions surprise, given what was believed before (the model's own videos: "
        f"{SURPRISING:.0%})."
    )
    state = "fail" if share > limit else "ok"
    value = f"in {1 - share:.0%} of the frames"
    return Check(name, state, value, f"{1 - limit:.0%} or more", says)
