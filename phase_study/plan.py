"""The path of a participant: the next pages, their contents, and the answers that they accept.

The server owns the path. A browser that starts anew asks for the rest of it. So a reload, a crash,
a second tab and a lost connection are handled alike.
"""

from __future__ import annotations

import functools
import random
from collections.abc import Mapping, Sequence
from typing import Any, Final

import phase_ppl as ppl
from phase_study.experiments import LABELS
from phase_study.settings import Settings
from phase_study.store import Participant

GENDERS: Final = ("female", "male", "non-binary", "other")
GREATEST: Final = 100  # of a slider, which begins at 0
LIKENESS: Final = ("1: very unlikely", "2", "3", "4", "5: very likely")
"""The scale of the paper, from 1 to 5."""

Page = dict[str, Any]
_Colour = tuple[int, int, int]
_Literal = tuple[str, int, int, bool]
"""A predicate's name, subject, target, and whether it shall be true."""


def outcome(settings: Settings, who: Participant) -> str | None:
    """Return how the study ended for somebody: "finished", "declined", "quiz_failed", or None."""
    if any(answer.page == "consent" and not answer.correct for answer in who.answers):
        return "declined"
    quiz = [answer.correct for answer in who.answers if answer.page == "quiz"]
    if len(quiz) >= settings.tries and not any(quiz):
        return "quiz_failed"
    answered = {answer.page for answer in who.answers}
    if who.trials is None and settings.kind != "play":
        return None
    return "finished" if answered >= set(required(settings, who)) else None


def required(settings: Settings, who: Participant) -> list[str]:
    """Return the pages of a complete study, in their order."""
    before = ["consent", "device", "tutorial", *["quiz"] * bool(settings.quiz)]
    if settings.kind == "play":
        main = ["practice", *(f"session-{n + 1}" for n in range(settings.trials))]
    else:
        main = [f"trial-{n + 1}" for n in range(len(who.trials or ()))]
    return [*before, *main, *["person"] * settings.demographics]


def is_prepared(settings: Settings, who: Participant) -> bool:
    """Whether a participant has passed consent, introduction and quiz."""
    return who.passed >= {"consent", "device", "tutorial", *["quiz"] * bool(settings.quiz)}


def next_pages(settings: Settings, who: Participant) -> list[tuple[str, int]]:
    """Return the next pages, with attempts, up to where the server must decide."""
    answered = {answer.page for answer in who.answers}
    if "consent" not in answered:
        return [("consent", 1)]
    if is_prepared(settings, who):
        return [(page, 1) for page in required(settings, who) if page not in answered]
    tries = who.attempts("quiz") + 1
    pages = [("device", 1)] * ("device" not in answered)
    if who.attempts("tutorial") < tries:
        pages.append(("tutorial", tries))
    return [*pages, *[("quiz", tries)] * bool(settings.quiz)]


# --- contents of a page ---------------------------------------------------------------------------


def described(settings: Settings, who: Participant, page: str, attempt: int) -> Page:
    """Return all that the browser needs to show a page."""
    asked = questions(settings, page)
    for question in asked:
        if question["kind"] == "many":  # in the same order on all of a person's pages
            random.Random(who.id).shuffle(question["options"])
    found: Page = {"page": page, "attempt": attempt, "html": "", "questions": asked,
                   "button": "Next"}  # fmt: skip
    texts = settings.texts
    kind, _, number = page.partition("-")
    if kind == "consent":
        found |= {
            "heading": settings.title,
            "html": html(texts["consent"]),
            "button": "",
            "choices": [[True, "I agree and take part"], [False, "I do not agree"]],
        }
    elif kind == "device":
        found |= {
            "heading": "Your screen",
            "html": html(texts["device"]),
            "video": "/clip/moving.mp4",
            "min_width": settings.min_width,
            "refused": html(texts["device_refused"]),
        }
    elif kind == "tutorial":
        steps = [
            {"html": html(text), "video": f"/clip/{clip}.mp4" if clip else None}
            for text, clip in settings.tutorial
        ]
        found |= {"heading": "Introduction", "steps": steps}
        found["html"] = html(texts["wrong"]) if attempt > 1 else ""
    elif kind == "quiz":
        found |= {"heading": "What the introduction said", "button": "Done"}
    elif kind == "person":
        found |= {"heading": "About you", "html": html(texts["person"])}
    elif kind == "trial":
        trials = who.trials or ()
        found |= {
            "heading": f"Animation {number} of {len(trials)}",
            "html": html(texts["trial"]),
            "video": f"/video/{trials[int(number) - 1]}.mp4",
            "wide": True,
            "moments": list(settings.moments),
        }
    else:  # a session; static/play.js shows it, and the server ends it
        heading = f"Session {number}" if number else "Practice"
        found |= {"heading": heading, "html": html(texts["trial"]), "by_server": True}
    return found


def _one(name: str, legend: str, options: Sequence[Any], **more: Any) -> Page:
    given = [list(option) if isinstance(option, tuple) else [option, option] for option in options]
    return {"name": name, "kind": "one", "legend": legend, "options": given, **more}


def questions(settings: Settings, page: str) -> list[Page]:
    """Return the questions of a page; ``static/page.js`` and :func:`checked` know their kinds."""
    kind = page.partition("-")[0]
    if kind == "quiz":
        return [
            _one(f"question_{number}", question, options)
            for number, (question, options, _) in enumerate(settings.quiz, 1)
        ]
    if kind == "person":
        return [
            {"name": "age", "kind": "number", "legend": "Your age", "least": 18, "most": 120,
             "optional": True},
            _one("gender", "Your gender", [*GENDERS, ("", "I prefer not to say")], optional=True),
        ]  # fmt: skip
    if kind != "trial":
        return []
    if settings.kind == "tagging":
        return [_one("labels", "What happens? Choose all that fit.", LABELS, kind="many")]
    world, pairs = settings.world, ppl.pairs_of(settings.world)
    options = ppl.questions_of(world)
    found = [goal_question(world, agent, settings.self_goals) for agent in range(len(world.agents))]
    for name, pair in pairs.items():
        who = "they" if len(pairs) == 1 else " and ".join(map(the, pair))
        one = _one(name, f"How do {who} stand to each other?", options[name])
        if settings.answers == "sliders":
            one |= {"kind": "sliders", "most": GREATEST}
        found.append(one)
    if settings.answers == "confidence":
        legend = "How sure are you of your answers?"
        found.append({"name": "confidence", "kind": "slider", "legend": legend, "most": GREATEST})
    if settings.kind == "likeness":
        legend = " ".join(settings.texts["likeness"].split())
        found.append(_one("likeness", legend, list(enumerate(LIKENESS, 1))))
    return found


@functools.lru_cache(maxsize=64)
def goal_question(world: ppl.World, agent: int, self_goals: bool) -> Page:
    """Return the question about an agent's goal: tables of bodies and target places.

    Goals that are in no table are shown in a row below.
    """
    goals = _by_literal(world, agent, self_goals)
    others = [other for other in range(len(world.agents)) if other != agent]
    bodies = [*range(len(world.agents), len(world.entities)), agent, *others]
    words: dict[str, str] = {}  # goal -> its wording, in the order of the page

    def cells(predicate: str, body: int, places: Mapping[int, str]) -> list[str | None]:
        found = []
        for way, positive in (("to", True), ("away from", False)):
            for place, called in places.items():
                found.append(goal := goals.get((predicate, body, place, positive)))
                if goal is not None:
                    mover = f"{who[body]} " * (predicate == "ON" or body != agent)
                    words[goal] = f"get {mover}{way} {called}"
        return found

    def table(of: str, heads: Sequence[tuple[str, _Colour]], rows: Mapping[int, Any]) -> Page:
        return {
            "heads": [f"\u2026 to{of}", f"\u2026 away from{of}"],
            "columns": [[name, _css(world, colour)] for name, colour in heads],
            "rows": [
                [who[body], _css(world, world.entity_colours[body]), row]
                for body, row in rows.items()
            ],
        }

    who = {body: "itself" if body == agent else the(world.entities[body]) for body in bodies}
    places = {n: the(one.name.replace(" lm", " landmark")) for n, one in enumerate(world.landmarks)}
    heads = [(one.name.removesuffix(" lm"), one.colour) for one in world.landmarks]
    tables = [
        table(" the landmark", heads, {b: cells("ON", b, places) for b in bodies}),
    ]
    touched = {
        body: who[body]
        for body in (*bodies[: len(world.items)], *others, *[agent] * self_goals)
        if world.entities[body] in (world.touchable or ())
    }
    rows = {body: cells("TOUCH", body, touched) for body in bodies}
    rows = {body: row for body, row in rows.items() if any(row)}
    if set(rows) - {agent}:
        heads = [(world.entities[body], world.entity_colours[body]) for body in touched]
        tables.append(table("", heads, rows))
    else:  # side by side: to and away from the same place
        both = (goals.get(("TOUCH", agent, body, way))
                for body in touched for way in (True, False))  # fmt: skip
        words |= {goal: words.pop(goal) for goal in both if goal is not None}
    words |= {goal: goal for (predicate, *_), goal in goals.items() if predicate == "USERS"}
    return {
        "name": f"goal_{world.keys[agent]}",
        "kind": "goals",
        "legend": f"What does {the(world.agents[agent])} want?",
        "colour": _css(world, world.entity_colours[agent]),
        "options": [[goal, said] for goal, said in words.items()],
        "tables": tables,
    }


def the(name: str) -> str:
    """Return a name in a sentence: "the ball", but "Anna"."""
    return name if name[0].isupper() or name.startswith("the ") else f"the {name}"


def _css(world: ppl.World, colour: _Colour) -> str | None:
    """Return the colour to show beside a name; None in PHASE, where names tell it."""
    return None if world == ppl.worlds.PHASE else "rgb({}, {}, {})".format(*colour)


def allowed_goals(agent: int, self_goals: bool, world: ppl.World = ppl.worlds.PHASE) -> list[str]:
    """Return the goals that people can choose for an agent, in the world's order."""
    return list(_by_literal(world, agent, self_goals).values())


def _by_literal(world: ppl.World, agent: int, self_goals: bool) -> dict[_Literal, str]:
    """Return literal -> goal of an agent; of equivalent goals, the first."""
    found: dict[_Literal, str] = {}
    for goal in range(len(world.goals)) if self_goals else ppl.goals.possible_goals(agent, world):
        literal = ppl.goals.goal_literal(goal, agent, world)
        found.setdefault((literal.predicate.name, *literal[1:]), world.goals[goal])
    return found


@functools.lru_cache(maxsize=256)
def html(text: str) -> str:
    """Return Markdown as HTML; HTML and pictures in it are shown as text, links open a new page."""
    from markdown_it import MarkdownIt

    reader = MarkdownIt("js-default").disable("image")
    found: str = reader.render(text)
    return found.replace("<a href=", '<a target="_blank" rel="noopener noreferrer" href=')


# --- accepted answers -----------------------------------------------------------------------------


class Unfit(ValueError):
    """An answer that the page does not accept; the message says why."""


def checked(
    settings: Settings, page: str, answers: Mapping[str, Any]
) -> tuple[dict[str, Any], bool | None]:
    """Return the answers to a page; for quiz and consent, also whether the study may go on."""
    kind, asked = page.partition("-")[0], questions(settings, page)
    stops = kind == "trial" and bool(settings.moments)
    names = {"consent": ["agree"], "tutorial": ["views"]}.get(kind, [one["name"] for one in asked])
    names = [*names, *["moments"] * stops]
    if sorted(answers) != sorted(names):
        raise Unfit(f"expected answers to {', '.join(names) or 'nothing'}")
    if kind == "consent":
        if not isinstance(answers["agree"], bool):
            raise Unfit("agree: expected true or false")
        return dict(answers), answers["agree"]
    if kind == "tutorial":
        views = answers["views"]
        fits = isinstance(views, list) and len(views) <= 500
        if not (fits and all(is_number(view, 1e9) for view in views)):
            raise Unfit("views: expected milliseconds")
        return dict(answers), None
    found = {question["name"]: _fitting(question, answers[question["name"]]) for question in asked}
    if stops:
        found["moments"] = _stopped(settings.moments, asked, answers["moments"])
    if kind != "quiz":
        return found, None
    right = [answer for _, _, answer in settings.quiz]
    return found, list(found.values()) == right


def is_number(value: object, most: float) -> bool:
    """Whether a value of JSON is a number from 0 to below ``most``."""
    return type(value) in (int, float) and 0 <= value < most  # type: ignore[operator]


def _stopped(moments: Sequence[float], asked: Sequence[Page], given: Any) -> list[dict[str, Any]]:
    """Return the answers at the moments at which a film stopped: a shorter one has fewer."""
    if not isinstance(given, list) or len(given) > len(moments):
        raise Unfit(f"moments: expected the answers at {len(moments)} at most")
    found = []
    for at, stop in zip(moments, given, strict=False):
        names = {"at", "rt", *(question["name"] for question in asked)}
        if not isinstance(stop, dict) or {*stop} != names or stop["at"] != at:
            raise Unfit("moments: expected the answers at each")
        if not is_number(stop["rt"], 1e9):
            raise Unfit("moments: expected milliseconds")
        answers = {one["name"]: _fitting(one, stop[one["name"]]) for one in asked}
        found.append({"at": at, "rt": stop["rt"], **answers})
    return found


def _fitting(question: Page, answer: Any) -> Any:
    """Return an answer to a question; several options are put in order."""
    if question.get("optional") and answer in ("", None):
        return None
    options = [option for option, _ in question.get("options", ())]
    if question["kind"] == "number":
        least, most = question["least"], question["most"]
        if not (type(answer) is int and least <= answer <= most):
            raise Unfit(f"{question['name']}: expected {least} to {most}, or none")
        return answer
    if question["kind"] == "slider":
        if not (is_number(answer, GREATEST + 1) and answer <= GREATEST):
            raise Unfit(f"{question['name']}: expected 0 to {GREATEST}")
        return answer
    if question["kind"] == "sliders":
        given = answer if isinstance(answer, dict) else {}
        fits = sorted(given) == sorted(options) and any(given.values())
        if not (fits and all(is_number(v, GREATEST + 1) and v <= GREATEST for v in given.values())):
            raise Unfit(f"{question['name']}: expected 0 to {GREATEST} for each, not all 0")
        return {option: given[option] for option in options}
    if question["kind"] == "many":
        several = answer if isinstance(answer, list) else []
        answer = [option for option in options if option in several]
        fits = bool(several) and len(answer) == len(several)
    else:
        # 3.0 and True equal options, but are not allowed
        fits = any(type(answer) is type(one) and answer == one for one in options)
    if not fits:
        raise Unfit(f"{question['name']}: no such answer")
    return answer
