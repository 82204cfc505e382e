"""The command ``fit-people``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import commands as cli


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "fit-people",
        _fit,
        "phase-ppl fit-people videos.json --source out --observer company --out people.json",
        "Fit an observer to people's judgments: what stands between a model's evidence and the "
        "answers of people, and where they hesitate.",
    )
    cli.add(parser, "events EVENTS", "an event file or a folder of event files")
    cli.add(parser, "--judgments FILE", "a .csv file; default: those in the events", Path)
    cli.add(parser, "--observer NAME", "default company; of several, the best", action="append")
    says = (
        "the model whose evidence observers go by, or the folder of its evaluation, which is "
        "not computed again; cues: surface cues alone"
    )
    cli.add(parser, "--source MODEL|DIR", says, default="stepwise")
    cli.add(parser, "--out FILE", "a .json file", Path, required=True)
    cli.share(parser, "workers", "seed", "progress")


def _fit(options: argparse.Namespace) -> int:
    from phase_ppl.evaluation.doubt import doubt_of
    from phase_ppl.evaluation.judgments import all_events, judged

    cli.check_suffix(options.out, (".json",))
    events = judged(all_events(options.events), options.judgments)
    source = None
    if options.source != "cues":
        source = phase_ppl.evidence_from(
            events,
            options.source,
            workers=options.workers,
            progress=cli.shows_progress(options),
            seed=options.seed,
        )
    fits = []
    for name in options.observer or ["company"]:
        fit = phase_ppl.fit_people(
            events, options.judgments, name, source=source, seed=options.seed
        )
        fits.append(fit)
        found = doubt_of(events, fit.left_out)
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
