"""The commands ``generate``, ``verify`` and ``train``."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import re
import shlex
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.data.generated import GeneratedEvents, verify
from phase_ppl.data.generation.generate import PRESETS, GenerationInterrupted, generate
from phase_ppl.models.socialgnn.graphs import VARIANTS
from phase_ppl.models.socialgnn.store import TrainingSettings
from phase_ppl.world.errors import check_name
from phase_ppl.world.files import writable_folder
from phase_ppl.world.scene import TURNINGS

VIDEOS: Final = "videos"
REJECTED_VIDEOS: Final = "videos_rejected"
"""Folders of films in that of the data set; those of rejected draws end in the reason."""


def add_to(commands: Any) -> None:
    """Add the commands."""
    parser = cli.command(
        commands,
        "generate",
        _generate,
        "phase-ppl generate --n 20 --seed 1 --out events",
        "Make a data set like PHASE: draw situations, simulate them, keep those that show what "
        "they should.",
    )
    size = parser.add_mutually_exclusive_group()
    cli.add(size, "--n N", "events, of PHASE in the paper's proportions", cli.whole(1))
    cli.add(size, "--preset", "the paper's 500 events; default", choices=tuple(PRESETS))
    says = "events of a family, such as chasing=10 or hinder:LMA=5; may be given several times; "
    says += f"{own.FILE}, which registers it"
    cli.add(size, "--cell FAMILY=N", says, _cell, action="append")
    cli.add(parser, "--out DIR", type=Path, required=True)
    says = f"{', '.join(phase_ppl.worlds.available())} (default PHASE); without --cell events of "
    says += f"others than PHASE, or with --prior, are random scenes with roles; {own.FILE}"
    cli.add(parser, "--world NAME", says)
    says = f"over who wants what in random scenes, default uniform; {own.FILE}"
    cli.add(parser, "--prior NAME", says)
    cli.share(parser, "planner", "seed")
    says = "of each event, with other reflections and colours; default 0"
    cli.add(parser, "--copies K", says, cli.whole(0), 0)
    says = (
        "copies of each event simulated anew in a layout of the same kind, or with sizes and "
        "strengths moved by one, as far as its family allows; default 0"
    )
    cli.add(parser, "--replans K", says, cli.whole(0), 0)
    says = "which way agents can turn, before any reflection; default both"
    cli.add(parser, "--turning", says, choices=TURNINGS, default="both")
    cli.share(parser, "workers", "dask")
    cli.add(parser, "--keep-rejected", "keep the draws that were not good enough")
    says = "film every event, rejected draws too if they are kept, and draw all on one picture"
    cli.add(parser, "--videos", says)
    cli.add(parser, "--resume", "go on with what DIR holds")
    cli.share(parser, "progress", "other_versions")

    check = cli.command(commands, "verify", _verify, "phase-ppl verify events")
    cli.add(check, "folder DIR", type=Path)

    train = cli.command(
        commands,
        "train",
        _train,
        "phase-ppl train socialgnn --data events --out gnn",
        "Train a model of social perception on a generated data set: networks from several seeds, "
        "whose answers are averaged. Needs the extra neural (PyTorch).",
    )
    cli.add(train, "model", choices=("socialgnn",))
    says = "the folder of a generated set, with the splits train and validation"
    cli.add(train, "--data SET", says, Path, required=True)
    cli.add(train, "--out DIR", type=Path, required=True)
    cli.add(train, "--seeds K", "networks; default 5", cli.whole(1), 5)
    cli.add(train, "--seed N", "first one; default 0", cli.whole(0), 0)
    cli.add(train, "--variant", choices=VARIANTS, default=VARIANTS[0])
    cli.add_options(
        train, "how to train, such as epochs=100 or looks=false; may be given several times"
    )
    cli.add(train, "--resume", "go on with what DIR holds")
    cli.share(train, "progress")


def _generate(options: argparse.Namespace) -> int:
    given: dict[str, Any] = {}
    if options.world is not None:
        given["world"] = own.taken(options.world, "world")
    if options.prior is not None:
        from phase_ppl.models import priors

        prior = own.taken(options.prior, "prior")
        prior = priors.named(prior) if isinstance(prior, str) else prior
        given["roles"] = functools.partial(phase_ppl.roles.draw, prior=prior)
    cells = {_family(name): number for name, number in options.cell or ()}
    try:
        given["cells"] = cells or PRESETS.get(options.preset)
        made = generate(**cli.arguments(generate, options, **given))
    except GenerationInterrupted as stopped:
        print(f"phase-ppl: {stopped}: phase-ppl generate ... --resume", file=sys.stderr)
        return cli.INTERRUPTED
    _print(made)
    if options.videos:
        _film(made, options)
    given_up = made.manifest["given_up"]
    if given_up:
        print(f"Given up after too many draws: {', '.join(given_up)}", file=sys.stderr)
    return cli.FAILED if given_up else 0


def _film(made: GeneratedEvents, options: argparse.Namespace) -> None:
    shown = cli.shows_progress(options)
    folder = made.path / VIDEOS
    phase_ppl.render.videos(made, folder, workers=options.workers, progress=shown)
    sheets = phase_ppl.render.contact_sheet(made, made.path / "contact_sheet.png", progress=shown)
    print(f"{len(made)} films in {folder}; {', '.join(file.name for file in sheets)}")
    rejected = [
        dataclasses.replace(event, id=f"{event.id}-{re.sub(r'[^A-Za-z0-9]+', '-', reason)}")
        for event, reason in made.rejected()
    ]
    if rejected:
        folder = made.path / REJECTED_VIDEOS
        phase_ppl.render.videos(rejected, folder, workers=options.workers, progress=shown)
        print(f"{len(rejected)} films of rejected draws in {folder}")


def _print(made: GeneratedEvents) -> None:
    """Print how many draws of each kind were kept, and why others were not."""
    manifest = made.manifest
    for cell, kept in manifest["kept"].items():
        if not kept:
            continue
        refused = manifest["rejected"][cell]
        print(f"{cell:<22}{_kept(kept, refused, 'draws')}")
        replans = manifest.get("replans", {}).get(cell)
        if replans and (replans["kept"] or replans["rejected"]):
            told = _kept(replans["kept"], replans["rejected"], "simulations of re-planned copies")
            print(f"{'':<22}{told}")
    splits = Counter(entry["split"] for entry in made.entries)
    parts = ", ".join(f"{n} {name}" for name, n in splits.items())
    print(f"{len(made)} events ({parts}) in {made.path}")
    anew = made.cost.get("made_anew")
    if anew:
        print(f"Made anew, since their parts were damaged: {', '.join(anew)}", file=sys.stderr)


def _kept(kept: int, refused: Mapping[str, int], what: str) -> str:
    why = "; ".join(f"{reason} {n}" for reason, n in refused.items())
    return f"{kept:>4} of {kept + sum(refused.values()):>4} {what}{'   ' + why if why else ''}"


def _verify(options: argparse.Namespace) -> int:
    wrong = verify(options.folder)
    for line in wrong:
        print(line)
    if wrong:
        return cli.FAILED
    print(f"{options.folder}: all events are as they were made")
    return 0


def _family(cell: str) -> str:
    """Return what a cell is called when the file of ``FILE.py:NAME`` has been run."""
    if own.taken(cell, "family") is cell:
        return cell
    return cell.rpartition(":")[2]


def _cell(text: str) -> tuple[str, int]:
    name, equals, number = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form FAMILY=N")
    return name, cli.whole(1)(number)


def _train(options: argparse.Namespace) -> int:
    given = cli.once(options.option)
    for name in given:
        check_name("option", name, [f.name for f in dataclasses.fields(TrainingSettings)][1:])
    settings = TrainingSettings.of(options.variant, **given)
    writable_folder(options.out)
    try:
        arguments = cli.arguments(phase_ppl.train_socialgnn, options, settings=settings)
        report = phase_ppl.train_socialgnn(**arguments)
    except KeyboardInterrupt:
        print("phase-ppl: interrupted; go on with the same command and --resume", file=sys.stderr)
        return cli.INTERRUPTED
    _print_scores(report)
    print(f"\nKept in {options.out}; to ask them: phase-ppl evaluate EVENTS --model socialgnn "
          f"--weights {shlex.quote(str(options.out))}")  # fmt: skip
    return 0


def _print_scores(report: dict[str, Any]) -> None:
    """Print the accuracies of each network and of all together, by split."""
    splits = list(report["together"])
    print("right answers, %" + "".join(f"{split:>24}" for split in splits))
    print(" " * 16 + f"{'goals':>12}{'relation':>12}" * len(splits) + f"{'epochs':>8}{'CPU s':>8}")
    for member in report["members"]:
        scores = "".join(_cells(member["accuracy"][split]) for split in splits)
        print(
            f"seed {member['seed']:<11}{scores}{member['epochs']:>8}{member['cpu_seconds']:>8.0f}"
        )
    print("all together    " + "".join(_cells(report["together"][split]) for split in splits))


def _cells(scores: dict[str, Any]) -> str:
    """Return goals and relation as two columns."""
    cells = ""
    for name in ("goal_accuracy", "relation_accuracy"):
        figure = scores.get(name)
        value = figure["value"] if isinstance(figure, dict) else figure
        cells += f"{'-' if value is None else f'{100 * value:.0f}':>12}"
    return cells
