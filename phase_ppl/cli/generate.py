"""The commands ``generate``, ``verify`` and ``train``."""

from __future__ import annotations

import dataclasses
import functools
import re
import shlex
import sys
from collections.abc import Mapping
from typing import Any

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import FAILED, Options
from phase_ppl.world.errors import check_name
from phase_ppl.world.files import writable_folder


def generate(options: Options) -> int:
    """Make a data set of simulated social events.

    Draws situations like those of PHASE, simulates them, and keeps those that show their scenario.

    Args:
        --n N: events, of PHASE in the paper's proportions
        | --preset NAME: phase500, the paper's 500 events; default
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
        --keep-rejected: keep the rejected draws, too
        --videos: film every event, also kept rejected draws, and draw all in one picture
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
    if options.preset is not None:
        from phase_ppl.data.generation.generate import PRESETS

        check_name("preset", options.preset, PRESETS)
        given["cells"] = PRESETS[options.preset]
    if options.cell:
        given["cells"] = {_family(name): number for name, number in options.cell.items()}
    made = options.call(phase_ppl.generate, **given)
    print(made)
    if options.videos:
        rejected = [
            dataclasses.replace(event, id=f"{event.id}-{re.sub(r'[^A-Za-z0-9]+', '-', reason)}")
            for event, reason in made.rejected()
        ]
        films = functools.partial(options.call, phase_ppl.render.videos)
        films(events=made, folder=made.path / "videos")
        sheets = options.call(
            phase_ppl.render.contact_sheet, events=made, path=made.path / "contact_sheet.png"
        )
        names = ", ".join(file.name for file in sheets)
        print(f"{len(made)} films in {made.path / 'videos'}; {names}")
        if rejected:
            folder = made.path / "videos_rejected"
            films(events=rejected, folder=folder)
            print(f"{len(rejected)} films of rejected draws in {folder}")
    given_up = made.manifest["given_up"]
    if given_up:
        print(f"Given up after too many draws: {', '.join(given_up)}", file=sys.stderr)
    return FAILED if given_up else 0


def _family(cell: str) -> str:
    """Return the name of a cell's family, after running the file of ``FILE.py:NAME``."""
    return cell if users_parts.taken(cell, "family") is cell else cell.rpartition(":")[2]


def verify(options: Options) -> int:
    """Compare a generated data set with its checksums.

    Args:
        FOLDER: of the set

    example: phase-ppl verify events
    """
    from phase_ppl.data.generated import verify as wrong_in

    wrong = wrong_in(options.folder)
    print("\n".join(wrong) or f"{options.folder}: all events are as they were made")
    return FAILED if wrong else 0


def train(options: Options) -> None:
    """Train a model of social perception on a generated data set.

    Trains networks from several seeds and averages their answers. Needs the extra neural (PyTorch).

    Args:
        MODEL: socialgnn
        --data DIR: the folder of a generated set, with the splits train and validation; required
        --out DIR: required
        --seeds N: networks; default 5
        --seed N: first one; default 0
        --variant extended|original|message_passing: default extended
        --option NAME=VALUE...: option of training, such as epochs=100 or looks=false; may be given
            several times
        $progress

    example: phase-ppl train socialgnn --data events --out gnn
    """
    from phase_ppl.models.socialgnn.store import TrainingSettings

    check_name("model to train", options.model, ["socialgnn"])
    for name in options.option:
        check_name("option", name, [f.name for f in dataclasses.fields(TrainingSettings)][1:])
    settings = TrainingSettings.of(options.variant or "extended", **options.option)
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
        for figure in (scores.get("goal_accuracy"), scores.get("relation_accuracy")):
            value = figure["value"] if isinstance(figure, dict) else figure
            cells += f"{'-' if value is None else f'{100 * value:.0f}':>12}"
    return cells
