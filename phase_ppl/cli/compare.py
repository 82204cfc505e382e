"""The command ``compare``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event

COMPARISON: Final = "comparison.json"
FIGURE: Final = "comparison.png"


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.event_command(
        commands,
        "compare",
        _compare,
        "phase-ppl compare collaborate --kernels local_mh,local_mh:rule=paper,prior_mh "
        "--budget 500 --repeats 8 --out out",
    )
    says = (
        "names, with options as NAME:OPTION=VALUE:OPTION=VALUE; as_printed, as_intended and "
        "default are SIMPLE by a preset, on this planner and these weights; " + own.FILE
    )
    cli.add(parser, "--kernels A,B", says, required=True)
    cli.add(
        parser, "--budget B", f"{cli.BUDGET}; default 500", cli.budget, phase_ppl.simulations(500)
    )
    cli.add(parser, "--repeats R", "default 8", cli.whole(1), 8)
    cli.add(parser, "--chains M", "default 15", cli.whole(1), 15)
    own.add_model(parser)
    cli.add(parser, "--planner", "default fast", choices=("fast", "paper"))
    says = (
        "a posterior's .nc file, 'enumeration' (more precise: enumeration:per_pair=16) or a "
        "kernel, with options as in --kernels; default: what is affordable"
    )
    cli.add(parser, "--reference R", says)
    cli.add(parser, "--weights NAME", "default count", default="count")
    cli.share(parser, "workers", "dask", "shard")
    cli.add(parser, "--checkpoint FILE", ".json; keeps and takes up finished runs", Path)
    cli.add(parser, "--out DIR", "for the runs and a figure", Path)
    cli.share(parser, "overwrite", "progress")


def _compare(options: argparse.Namespace) -> int:
    event = cli.load(options)
    names = [COMPARISON, FIGURE]
    if options.out is not None and options.checkpoint is not None:
        kept = options.checkpoint.resolve()
        names = [name for name in names if (options.out / name).resolve() != kept]
    with cli.results_folder(options.out, names, options.overwrite) as out:
        return _compared(event, out, options)


def _compared(event: Event, out: Path | None, options: argparse.Namespace) -> int:
    interrupted = False
    try:
        arguments = cli.arguments(
            phase_ppl.compare,
            options,
            event=event,
            model=own.model(options, options.planner),
            kernels=_kernels(options.kernels),
            reference=_reference(options.reference),
        )
        found = phase_ppl.compare(**arguments)
    except phase_ppl.ComparisonInterrupted as stopped:
        if stopped.comparison is None:
            print("phase-ppl: interrupted before the first run was finished", file=sys.stderr)
            return cli.INTERRUPTED
        print("phase-ppl: interrupted; this is what was finished until then", file=sys.stderr)
        found, interrupted = stopped.comparison, True
    print(found)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the table, the runs and a figure.")
    else:
        found.save(out / COMPARISON)
        phase_ppl.plot.comparison(found, path=out / FIGURE)
        print(f"\nWritten to {out}: {COMPARISON}, {FIGURE}")
    return cli.INTERRUPTED if interrupted else 0


def _kernels(text: str) -> dict[str, Any]:
    """Return label -> (name, options) of ``a,b:option=value``."""
    found: dict[str, Any] = {}
    for label in (part.strip() for part in text.split(",")):
        if not label.partition(":")[0] or label in found:
            raise InvalidSettingError(f"--kernels {text}: expected different names, as in a,b,c")
        name, given = own.with_settings(label, "--kernels")
        found[label] = own.taken(name, "kernel"), given
    return found


def _reference(text: str | None) -> Any:
    if text is not None and text.endswith(".nc"):
        return phase_ppl.Posterior.load(text)
    if text is None or ":" not in text:
        return text
    name, given = own.with_settings(text, "--reference")
    return own.taken(name, "kernel"), given
