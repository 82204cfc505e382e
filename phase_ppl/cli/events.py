"""The commands on events: ``simulate``, ``render``, ``describe``, ``export``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.data.generated import MANIFEST
from phase_ppl.data.load import EXPORTS
from phase_ppl.data.load import SUFFIXES as EVENT_SUFFIXES
from phase_ppl.evaluation.judgments import all_events
from phase_ppl.render.video import SUFFIXES as FILM_SUFFIXES
from phase_ppl.world.errors import InvalidSettingError, instance_of
from phase_ppl.world.event import Event
from phase_ppl.world.files import atomic_output, writable_folder

_PICTURE: Final = ".png"
_STRIP: Final = 6
"""Frames of a film strip, where the event has as many."""


def add_to(commands: Any) -> None:
    """Add the commands."""
    goals = cli.command(commands, "goals", _goals, "phase-ppl goals")
    says = (
        f"{', '.join(phase_ppl.worlds.available())} (default PHASE), or an event file; {own.FILE}"
    )
    cli.add(goals, "--world NAME", says)
    _add_simulate(commands)
    _add_render(commands)
    _add_describe(commands)
    _add_export(commands)


def _goals(options: argparse.Namespace) -> int:
    world = own.taken(options.world or "PHASE", "world")
    if isinstance(world, str):
        is_file = Path(world).suffix in EVENT_SUFFIXES
        world = (
            phase_ppl.load_events(world)[0].scene.world
            if is_file
            else phase_ppl.worlds.named(world)
        )
    instance_of("--world", world, phase_ppl.World, "a phase_ppl.World")
    print("\n".join(world.goals))
    return 0


def _add_simulate(commands: Any) -> None:
    parser = cli.event_command(
        commands,
        "simulate",
        _simulate,
        "phase-ppl simulate collaborate --goal-red 'Get blue item to red lm' "
        "--goal-green 'get to red agent' --out simulated.mp4",
    )
    for agent in ("red", "green"):
        cli.add(parser, f"--goal-{agent} GOAL", "in PHASE")
        cli.add(parser, f"--alpha-{agent} A", "-1, 0 or 1", int, 0, choices=(-1, 0, 1))
        cli.add(parser, f"--strength-{agent} NEWTON", "default 450", float, 450.0)
    says = "in any world, of each agent that neither helps nor hinders"
    cli.add(parser, "--goal NAME=GOAL", says, action="append", default=[])
    says = "who helps or hinders whom, as in 'Ann=help=Ben'"
    cli.add(parser, "--relation WHO=WORD=WHOM", says, action="append", default=[])
    says = "of an agent; default 450"
    cli.add(parser, "--strength NAME=NEWTON", says, action="append", default=[])
    cli.share(parser, "planner")
    cli.add(parser, "--frames T", "default: as long as the event", cli.whole(2))
    cli.add(parser, "--overlapping", "though bodies overlap at the start")
    cli.add(parser, "--out FILE", ".json, .nc, .mp4 or .gif", Path, required=True)


def _simulate(options: argparse.Namespace) -> int:
    suffix = cli.check_suffix(options.out, (*EVENT_SUFFIXES, *FILM_SUFFIXES))
    event = cli.load(options)
    writable_folder(options.out.parent)
    hypothesis = _roles(options, event)
    simulated = phase_ppl.simulate(
        event.scene,
        hypothesis,
        frames=options.frames or event.observation.n_frames,
        seed=options.seed,
        planner=options.planner,
        id=f"{event.id}-simulated",
        overlapping=options.overlapping,
    )
    if suffix in EVENT_SUFFIXES:
        phase_ppl.save_event(simulated, options.out)
    else:
        phase_ppl.render.video(simulated, options.out)
    print(f"{hypothesis}\n{simulated.observation.n_frames} frames written to {options.out}")
    return 0


def _roles(options: argparse.Namespace, event: Event) -> phase_ppl.Hypothesis:
    """Return who wants what."""
    named = options.goal, options.relation, options.strength
    of_phase = options.goal_red, options.goal_green
    if any(named):
        if any(of_phase):
            raise InvalidSettingError("give either --goal-red and --goal-green, or --goal")
        goals = {name: goal for name, goal in (_parts(one, "goal", 2) for one in options.goal)}
        told = (_parts(one, "relation", 3) for one in options.relation)
        strengths = (_parts(one, "strength", 2) for one in options.strength)
        return phase_ppl.Hypothesis.of(
            event.scene.world,
            goals,
            {(who, whom): word for who, word, whom in told},
            {name: _newtons(force) for name, force in strengths},
        )
    if event.scene.world != phase_ppl.worlds.PHASE or None in of_phase:
        raise InvalidSettingError(
            "expected --goal-red and --goal-green, or, in any world, --goal NAME=GOAL; the agents "
            f"of {event.scene.world.name!r} are {', '.join(event.scene.world.agents)}"
        )
    return phase_ppl.Hypothesis(
        goal_red=options.goal_red,
        goal_green=options.goal_green,
        alpha=(options.alpha_red, options.alpha_green),
        strength_red=options.strength_red,
        strength_green=options.strength_green,
    )


def _newtons(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidSettingError(f"--strength {text}: expected newtons, a number") from None


def _parts(text: str, option: str, n: int) -> tuple[str, ...]:
    """Return what stands between the equals signs of an option."""
    parts = tuple(part.strip() for part in text.split("="))
    if len(parts) != n:
        form = "NAME=GOAL" if option == "goal" else "NAME=NEWTON" if n == 2 else "WHO=help=WHOM"
        raise InvalidSettingError(f"--{option} {text}: expected {form}")
    return parts


def _add_render(commands: Any) -> None:
    parser = cli.event_command(
        commands,
        "render",
        _render,
        "phase-ppl render collaborate --fields-of-view --out collaborate.gif",
    )
    which = parser.add_mutually_exclusive_group()
    cli.add(which, "--frame N", "one frame as .png; 0 is the first, -1 the last", int)
    cli.add(which, "--strip N", f"N frames side by side as .png; default {_STRIP}", cli.whole(1))
    cli.add(parser, "--fields-of-view", "show what each agent can see")
    cli.add(parser, "--out FILE", ".mp4 or .gif, or .png for pictures", Path, required=True)


def _render(options: argparse.Namespace) -> int:
    suffix = cli.check_suffix(options.out, (*FILM_SUFFIXES, _PICTURE))
    one_frame = options.frame is not None
    if suffix != _PICTURE and (one_frame or options.strip is not None):
        what = "--frame" if one_frame else "--strip"
        raise InvalidSettingError(f"{what} draws a picture: --out {options.out} must end in .png")
    event = cli.load(options)
    writable_folder(options.out.parent)
    n_frames = event.observation.n_frames
    shown = f"{n_frames} frames"
    if suffix != _PICTURE:
        phase_ppl.render.video(event, options.out, fields_of_view=options.fields_of_view)
    elif one_frame:
        shown = f"frame {options.frame}"
        phase_ppl.render.image(
            event, options.frame, options.out, fields_of_view=options.fields_of_view
        )
    else:
        n = options.strip or min(_STRIP, n_frames)
        shown = f"{n} frames"
        phase_ppl.render.strip(event, options.out, n, fields_of_view=options.fields_of_view)
    print(f"{shown} of {event.id} written to {options.out}")
    return 0


def _add_describe(commands: Any) -> None:
    parser = cli.command(
        commands, "describe", _describe, "phase-ppl describe events.json --out out"
    )
    cli.add(
        parser, "events EVENTS", "a generated set, an event file, or a folder of event files", Path
    )
    says = "write statistics.csv, data_card.png and contact_sheet.png there"
    cli.add(parser, "--out DIR", says, Path)
    cli.share(parser, "progress")


def _describe(options: argparse.Namespace) -> int:
    out = None if options.out is None else writable_folder(options.out)
    path: Path = options.events
    made = (path / MANIFEST).is_file()
    events = phase_ppl.load_events(path) if made else all_events(path)
    found = phase_ppl.statistics(events)
    n, units, *unknown = found.attrs.values()
    words = [f"{path.resolve().stem}: {n} event{'s' * (n != 1)}"]
    words += [f"{units} without copies"] * (units != n)
    for number, what in zip(unknown, ("without truth", "agents of unknown strength"), strict=True):
        words += [f"{number} {what}"] * (number > 0)
    print(", ".join(words))
    shown = found[(found["count"] != 0).fillna(True) | found["phase"].notna()]
    print(shown.to_string(float_format="{:.2f}".format, na_rep=""))
    if out is None:
        return 0
    with atomic_output(out / "statistics.csv", (".csv",)) as part:
        found.to_csv(part)
    phase_ppl.plot.data_card(found, out / "data_card.png")
    sheets = phase_ppl.render.contact_sheet(
        events, out / "contact_sheet.png", progress=cli.shows_progress(options)
    )
    names = ", ".join(["statistics.csv", "data_card.png", *(sheet.name for sheet in sheets)])
    print(f"\nWritten to {out}: {names}")
    return 0


def _add_export(commands: Any) -> None:
    parser = cli.command(
        commands,
        "export",
        _export,
        "phase-ppl export collaborate compete --to phase-test --out two.json",
    )
    cli.add(parser, "events EVENTS", "files of events, or bundled events' names", nargs="+")
    cli.add(parser, "--to", choices=tuple(EXPORTS), required=True)
    cli.add(parser, "--out FILE", type=Path, required=True)


def _export(options: argparse.Namespace) -> int:
    writable_folder(options.out.parent)
    events = [event for path in options.events for event in phase_ppl.load_events(path)]
    phase_ppl.export_events(events, options.out, options.to)
    print(f"{len(events)} event{'s' * (len(events) != 1)} written to {options.out}")
    return 0
