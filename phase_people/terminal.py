"""The command ``fit-people``."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from types import ModuleType
from typing import Any

import phase_ppl as ppl


def add_to(commands: Any, cli: ModuleType) -> None:
    """Add the command, with the help of what the core's own commands are made of."""
    parser = cli.command(
        commands,
        "fit-people",
        functools.partial(_fit_people, cli),
        "phase-ppl fit-people videos.json --source out --observer company --out people.json",
        "fit an observer to people's judgments",
    )
    parser.description = (
        "Fit an observer to people's judgments: what stands between a model's evidence and the "
        "answers of people, and where they hesitate."
    )
    cli.add(parser, "events EVENTS", "an event file or a folder of event files")
    says = "people's judgments: a .csv file, or a folder of raters' files; default: in the events"
    cli.add(parser, "--judgments FILE", says, Path)
    cli.add(parser, "--observer NAME", "default company; of several, the best", action="append")
    says = (
        "the model whose evidence observers go by, or the folder of its evaluation, which is "
        "not computed again; cues: surface cues alone"
    )
    cli.add(parser, "--source MODEL|DIR", says, default="stepwise")
    cli.add(parser, "--out FILE", "a .json file", Path, required=True)
    cli.share(parser, "workers", "seed", "progress")


def _fit_people(cli: ModuleType, options: argparse.Namespace) -> int:
    cli.check_suffix(options.out, (".json",))
    events, study = ppl.all_events(options.events), None
    if options.judgments is not None:
        study = ppl.load_judgments(options.judgments, events)
        events = ppl.with_judgments(events, study)
    source = None
    if options.source != "cues":
        source = ppl.evidence_from(
            events,
            options.source,
            workers=options.workers,
            progress=cli.shows_progress(options),
            seed=options.seed,
        )
    fits = []
    for name in options.observer or ["company"]:
        fit = ppl.fit_people(events, study, name, source=source, seed=options.seed)
        fits.append(fit)
        found = ppl.evaluate_predictions(events, fit.left_out)["doubt"]
        print(f"{name}: ELPD {fit.elpd.sum():.1f} nats, each video left out in turn")
        for label in ("relation_r", "relation_r_given_truth", "log_score_gap"):
            if found is not None and found[label] is not None:
                print(f"  {label.replace('_', ' ')} {found[label]['value']:.2f}")
    best = max(fits, key=lambda fit: float(fit.elpd.sum()))
    best.save(options.out)
    print(
        f"\nKept in {options.out}: {best.name}; phase-ppl evaluate --observer {options.out} asks it"
    )
    return 0
