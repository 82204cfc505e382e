"""The commands on events: ``goals``, ``simulate``, ``render``, ``describe``, ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import Options
from phase_ppl.world.errors import InvalidSettingError, instance_of
from phase_ppl.world.event import Event
from phase_ppl.world.files import atomic_output, writable_folder

_EVENTS, _FILMS = ".json", ".mp4"  # endings of files
_STRIP = 6  # frames of a film strip, if the event has that many


def goals(options: Options) -> None:
    """List the goals that an agent can have, 36 in PHASE.

    Args:
        --world NAME: $WORLDS, or an event file; $FILE

    example: phase-ppl goals
    """
    world = users_parts.taken(options.world or "PHASE", "world")
    if isinstance(world, str):
        if Path(world).suffix == _EVENTS:
            world = phase_ppl.load_events(world)[0].scene.world
        else:
            world = phase_ppl.worlds.named(world)
    instance_of("--world", world, phase_ppl.World, "a phase_ppl.World")
    print("\n".join(world.goals))


def simulate(options: Options) -> None:
    """Run the joint simulator from an event's start under a hypothesis.

    Args:
        $event
        --goal NAME=GOAL...: of each agent that neither helps nor hinders
        --relation WHO=WORD=WHOM...: who helps or hinders whom, as in 'Ann=help=Ben'
        --strength NAME=NEWTON...: of an agent; default 450
        $planner
        --frames N: default: as long as the event
        --overlapping: simulate even if bodies overlap at the start
        --out FILE: .json or .mp4; required

    example: phase-ppl simulate collaborate --goal 'red agent=blue item to red lm'
      --relation 'green agent=help=red agent' --out simulated.mp4
    """
    suffix = options.suffix(_EVENTS, _FILMS)
    event = options.load()
    hypothesis = _roles(options, event)
    given: dict[str, Any] = {"frames": event.observation.n_frames, "id": f"{event.id}-simulated"}
    given |= options.given("frames", "seed", "planner", "overlapping")
    simulated = phase_ppl.simulate(event.scene, hypothesis, **given)
    if suffix == _EVENTS:
        phase_ppl.save_event(simulated, options.out)
    else:
        phase_ppl.render.video(simulated, options.out)
    print(f"{hypothesis}\n{simulated.observation.n_frames} frames written to {options.out}")


def _roles(options: Options, event: Event) -> phase_ppl.Hypothesis:
    """Return the hypothesis of the options."""
    relations = {}
    for text in options.relation:
        parts = [part.strip() for part in text.split("=")]
        if len(parts) != 3:
            raise InvalidSettingError(f"--relation {text}: expected WHO=help=WHOM")
        relations[parts[0], parts[2]] = parts[1]
    return phase_ppl.Hypothesis.of(event.scene.world, options.goal, relations, options.strength)


def render(options: Options) -> None:
    """Film an event, or draw a frame or a film strip of it.

    Args:
        $event
        --frame N: one frame as .png; 0 is the first, -1 the last
        | --strip N: N frames side by side as .png; default 6
        --fields-of-view: show what each agent can see
        --out FILE: .mp4, or .png for pictures; required

    example: phase-ppl render collaborate --fields-of-view --out collaborate.mp4
    """
    picture = options.suffix(_FILMS, ".png") == ".png"
    which = options.given("frame", "strip")
    if which and not picture:
        raise InvalidSettingError(
            f"--{min(which)} draws a picture: --out {options.out} must end in .png"
        )
    event = options.load()
    n_frames = event.observation.n_frames
    n = min(_STRIP, n_frames) if options.strip is None else options.strip
    given = options.given("fields_of_view")
    if not picture:
        shown = f"{n_frames} frames"
        phase_ppl.render.video(event, options.out, **given)
    elif options.frame is not None:
        shown = f"frame {options.frame}"
        phase_ppl.render.image(event, options.frame, options.out, **given)
    else:
        shown = f"{n} frames"
        phase_ppl.render.strip(event, options.out, n, **given)
    print(f"{shown} of {event.id} written to {options.out}")


def describe(options: Options) -> None:
    """Print and draw the statistics of a set of events beside those of PHASE.

    Args:
        EVENTS: a generated set, an event file, or a folder of event files
        --out DIR: write statistics.csv, data_card.png and contact_sheet.png there
        $progress

    example: phase-ppl describe events.json --out out
    """
    out = None if options.out is None else writable_folder(options.out)
    path = Path(options.events)
    made = (path / "manifest.json").is_file()
    events = phase_ppl.load_events(path) if made else phase_ppl.all_events(path)
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
        return
    with atomic_output(out / "statistics.csv", (".csv",)) as part:
        found.to_csv(part)
    phase_ppl.plot.data_card(found, out / "data_card.png")
    options.call(phase_ppl.render.contact_sheet, events=events, path=out / "contact_sheet.png")
    print(f"\nWritten to {out}: statistics.csv, data_card.png, contact_sheet.png")


def export(options: Options) -> None:
    """Write events of any files, also of PHASE's authors, into one file.

    Args:
        EVENTS...: files of events, or bundled events' names
        --out FILE: .json; required

    example: phase-ppl export collaborate compete --out two.json
    """
    options.suffix(_EVENTS)
    events = [event for path in options.events for event in phase_ppl.load_events(path)]
    phase_ppl.save_events(events, options.out)
    print(f"{len(events)} event{'s' * (len(events) != 1)} written to {options.out}")
