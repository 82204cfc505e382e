"""The report of one run of inference."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import phase_ppl
from phase_ppl.analysis import plots
from phase_ppl.analysis.hypotheses import HDI_PROBABILITY
from phase_ppl.analysis.load import load_posterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.evaluation.folder import POSTERIOR
from phase_ppl.evaluation.observers import MODEL_COLOUR
from phase_ppl.evaluation.report import parts
from phase_ppl.evaluation.report.html import (
    Html,
    facts,
    figure_of,
    film,
    more,
    page,
    rolled,
    section,
    tag,
)
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.names import AGENTS

REPLAY: Final = "replay.mp4"
AnyPosterior = Posterior | StepwisePosterior

_GOALS: Final = dict(zip(("goal_red", "goal_green"), AGENTS, strict=True))
_COLOURS: Final = {"goal_red": "#d62f2f", "goal_green": "#1c8a3c"}
_N_GOALS: Final = 6


def run_report(folder: Path) -> str:
    """Return the page of the run in ``folder``.

    Raises:
        InvalidEventError: its posterior is damaged, or its film cannot be read.
    """
    post = load_posterior(folder / POSTERIOR)
    return page(
        f"{post.event_id}: posterior",
        tag("h1", post.event_id),
        tag("p", "Who wants what: a posterior over goals, relation and strengths.", class_="soft"),
        section("What happens", *_pictures(post, folder / REPLAY)),
        section("Posterior", _answers(post), _figure(post)),
        *_trust(post),
        section(
            "Settings and cost",
            tag("h3", "Cost"),
            facts(parts.flat(post.cost), "Cost"),
            more("Settings", facts(parts.flat(post.settings), "Settings")),
            tag("p", f"phase_ppl {phase_ppl.__version__}", class_="soft"),
        ),
    )


def _trust(post: AnyPosterior) -> list[Html]:
    if isinstance(post, StepwisePosterior):
        return [section("What decided", _decided(post))]
    return [section("Can it be trusted?", parts.diagnostics(post.diagnostics()))]


def _decided(post: StepwisePosterior) -> Html:
    best, second = (name for name, _ in post.top("relation", 2))
    figure = plots.why(post, f"relation={best}", f"relation={second}")
    alt = f"Log odds of {best} over {second} by frame, and the frames that changed them most."
    return tag("figure", figure_of(figure, alt))


def _pictures(post: AnyPosterior, replay: Path) -> list[Html]:
    scene = post.scene
    found = []
    if replay.is_file():
        try:
            content = replay.read_bytes()
        except OSError as error:
            raise InvalidEventError(f"{replay} cannot be read: {error.strerror}") from None
        words = "Film: the observation on the left, "
        simulated = isinstance(post, Posterior)
        words += (
            "the best hypothesis, simulated, on the right."
            if simulated
            else "what can be believed until then on the right."
        )
        found.append(tag("figure", film(content, words), tag("figcaption", words)))
    strips = [("Observed", post.observed())]
    if isinstance(post, Posterior):
        strips.append(("Best hypothesis, simulated", post.replay()))
    for caption, trajectory in strips:
        alt = f"{caption}: film strip of {post.event_id}, from first to last frame."
        found.append(parts.film_strip(trajectory, scene, caption, alt))
    return found


def _answers(post: AnyPosterior) -> Html:
    blocks = []
    for name, agent in _GOALS.items():
        entries = [entry for entry in post.top(name, _N_GOALS) if entry[1] >= parts.LEAST]
        blocks.append(parts.bars(f"Goal of the {agent}", entries, _COLOURS[name]))
    for name in ("relation", "scenario"):
        entries = post.top(name, len(post.marginal(name)))
        blocks.append(parts.bars(name.capitalize(), entries, MODEL_COLOUR))
    strengths = []
    for agent in AGENTS:
        name = f"strength_{agent.split()[0]}"
        low, high = post.hdi(name).values
        interval = f"{HDI_PROBABILITY:.0%} interval {low:.0f} to {high:.0f} N"
        strengths.append((agent, f"{post.mean(name):.0f} N ({interval})"))
    best = post.map_record()
    return tag(
        "div",
        tag("div", blocks, class_="side"),
        tag("h3", "Strengths"),
        facts(strengths, "Strengths"),
        tag("h3", "Best hypothesis"),
        facts(parts.flat(best), "Best hypothesis"),
    )


def _figure(post: AnyPosterior) -> Html:
    alt = "Goals, relation, scenario, tracks and strengths, as listed above."
    return tag("figure", rolled(figure_of(plots.posterior(post), alt), "Figure of the posterior"))
