"""The command ``fit-people``."""

from __future__ import annotations

from typing import Any

import phase_ppl as ppl


def fit_people(options: Any) -> None:
    """Fit an observer to people's judgments.

    An observer turns a model's evidence about a video into answers of people, and shows where
    they hesitate.

    Args:
        EVENTS: an event file or a folder of event files
        --judgments FILE: people's judgments: a .csv file, or a folder of raters' files; default: in
            the events
        --observer NAME...: default company; if several are given, the best is kept
        --source NAME: the model that gives observers their evidence, or the folder of its
            evaluation, which is not computed again; cues: surface cues alone; default closed_loop
        --out FILE: a .json file; required
        $workers
        $seed
        $progress

    example: phase-ppl fit-people videos.json --source out --observer company --out people.json
    """
    options.suffix(".json")
    events, study, seed = ppl.all_events(options.events), None, options.seed or 0
    if options.judgments is not None:
        study = ppl.load_judgments(options.judgments, events)
        events = ppl.with_judgments(events, study)
    source = None
    if options.source != "cues":
        more = options.given("source", "workers", "progress")
        source = ppl.evidence_from(events, seed=seed, **more)
    fits = []
    for name in options.observer or ["company"]:
        fit = ppl.fit_people(events, study, name, source=source, seed=seed)
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
