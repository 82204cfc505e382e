"""The command ``train``."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.models.socialgnn.graphs import VARIANTS
from phase_ppl.models.socialgnn.store import TrainingSettings
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.files import writable_folder


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "train",
        _train,
        "phase-ppl train socialgnn --data events --out gnn",
        "Train a model of social perception on a generated data set: networks from several seeds, "
        "whose answers are averaged. Needs the extra neural (PyTorch).",
    )
    cli.add(parser, "model", choices=("socialgnn",))
    says = "the folder of a generated set, with the splits train and validation"
    cli.add(parser, "--data SET", says, Path, required=True)
    cli.add(parser, "--out DIR", type=Path, required=True)
    cli.add(parser, "--seeds K", "networks; default 5", cli.whole(1), 5)
    cli.add(parser, "--seed N", "first one; default 0", cli.whole(0), 0)
    cli.add(parser, "--variant", choices=VARIANTS, default=VARIANTS[0])
    cli.add_options(
        parser, "how to train, such as epochs=100 or looks=false; may be given several times"
    )
    cli.add(parser, "--resume", "go on with what DIR holds")
    cli.share(parser, "progress")


def _train(options: argparse.Namespace) -> int:
    given = cli.once(options.option)
    known = [field.name for field in dataclasses.fields(TrainingSettings)][1:]
    for name in given:
        if name not in known:
            raise unknown_name("option", name, known)
    settings = TrainingSettings.of(options.variant, **given)
    writable_folder(options.out)
    try:
        arguments = cli.arguments(phase_ppl.train_socialgnn, options, settings=settings)
        report = phase_ppl.train_socialgnn(**arguments)
    except KeyboardInterrupt:
        print("phase-ppl: interrupted; go on with the same command and --resume", file=sys.stderr)
        return cli.INTERRUPTED
    _print(report)
    print(f"\nKept in {options.out}; to ask them: phase-ppl evaluate EVENTS --model socialgnn "
          f"--weights {shlex.quote(str(options.out))}")  # fmt: skip
    return 0


def _print(report: dict[str, Any]) -> None:
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
