"""The commands on events: ``goals`` to ``export``, ``generate``, and ``train`` on such a set."""

from __future__ import annotations

import dataclasses
import functools
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import FAILED, Options
from phase_ppl.world.errors import InvalidSettingError, check_name, instance_of
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


def generate(options: Options) -> int:
    """Make a data set of simulated social events.

    Draws situations like those of PHASE, simulates them, and keeps those that show their scenario.

    Args:
        --n N: events, of PHASE in the paper's proportions; default there the paper's 500
        | --cell FAMILY=N...: events of a family, such as chasing=10 or hinder:LMA=5; hinder=6 has
            as many of each variant; may be given several times; $FILE, which registers it
        --out DIR: required
        --world NAME: $WORLDS; other worlds than PHASE without --cell, and all with --prior, give
            random scenes; $FILE
        --prior NAME: of goals and relations in random scenes, default uniform; $FILE
        $planner
        $seed
        --copies N: of each event, with other reflections and colours; default 0
        --turning both|ccw|cw: which way agents can turn, before any reflection; default both
        $cluster
        --videos: film every event, and draw all in one picture
        --resume: continue the set in DIR
        $progress
        $versions

    example: phase-ppl generate --n 20 --seed 1 --out events
    """
    given: dict[str, Any] = {}
    if options.world is not None:
        given["world"] = users_parts.taken(options.world, "world")
    if options.prior is not None:
        from phase_ppl.models import priors

        prior = users_parts.taken(options.prior, "prior")
        prior = priors.named(prior) if isinstance(prior, str) else prior
        given["roles"] = functools.partial(phase_ppl.roles.draw, prior=prior)
    if options.cell:
        given["cells"] = {_family(name): number for name, number in options.cell.items()}
    made = options.call(phase_ppl.generate, **given)
    print(made)
    if options.videos:
        folder = made.path / "videos"
        options.call(phase_ppl.render.videos, events=made, folder=folder)
        sheet = made.path / "contact_sheet.png"
        options.call(phase_ppl.render.contact_sheet, events=made, path=sheet)
        print(f"{len(made)} films in {folder}; {sheet.name}")
    given_up = made.manifest["given_up"]
    if given_up:
        print(f"Given up after too many draws: {', '.join(given_up)}", file=sys.stderr)
    return FAILED if given_up else 0


def _family(cell: str) -> str:
    """Return the name of a cell's family, after running the file of ``FILE.py:NAME``."""
    return cell if users_parts.taken(cell, "family") is cell else cell.rpartition(":")[2]


def train(options: Options) -> None:
    """Train a model of social perception on a generated data set.

    Trains networks from several seeds and averages their answers. Needs the extra neural (PyTorch).

    Args:
        MODEL: socialgnn
        --data DIR: the folder of a generated set, with the splits train and validation; required
        --out DIR: required
        --seeds N: networks; default 5
        --seed N: first one; default 0
        --variant extended|original: default extended
        --option NAME=VALUE...: option of training, such as epochs=100; may be given several times
        $progress

    example: phase-ppl train socialgnn --data events --out gnn
    """
    from phase_ppl.models.socialgnn.store import TrainingSettings

    check_name("model to train", options.model, ["socialgnn"])
    for name in options.option:
        check_name("option", name, [f.name for f in dataclasses.fields(TrainingSettings)][1:])
    settings = TrainingSettings(options.variant or "extended", **options.option)
    writable_folder(options.out)
    report = options.call(phase_ppl.train_socialgnn, settings=settings)
    splits = list(report["together"])
    print("right answers, %" + "".join(f"{split:>24}" for split in splits))
    print(" " * 16 + f"{'goals':>12}{'relation':>12}" * len(splits) + f"{'epochs':>8}{'CPU s':>8}")
    for member in report["members"]:
        told = f"{member['epochs']:>8}{member['cpu_seconds']:>8.0f}"
        print(f"seed {member['seed']:<11}{_scores(member['accuracy'])}{told}")
    print(f"all together    {_scores(report['together'])}")
    print(f"\nKept in {options.out}; to ask them: phase-ppl evaluate EVENTS --model socialgnn "
          f"--weights {shlex.quote(str(options.out))}")  # fmt: skip


def _scores(by_split: Mapping[str, Mapping[str, Any]]) -> str:
    """Return shares of right answers about goals and relation by split, as columns in percent."""
    cells = ""
    for scores in by_split.values():
        for figure in (scores["goal_accuracy"], scores["relation_accuracy"]):
            value = "-" if figure is None else f"{100 * figure['value']:.0f}"
            cells += f"{value:>12}"
    return cells
