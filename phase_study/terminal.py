"""The command ``study``: the paper's studies of people, in the browser."""

from __future__ import annotations

import argparse
import contextlib
import functools
import signal
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

import phase_ppl as ppl

if TYPE_CHECKING:
    from phase_study import Study

_KINDS: Final = ("judgment", "tagging", "likeness", "play")
_INCLUDE: Final = ("unfinished", "excluded")


def add_to(commands: Any, cli: ModuleType) -> None:
    """Add the command, with the help of what the core's own commands are made of."""
    does = "put events before people, in the browser"
    parser = cli.command(commands, "study", None, "phase-ppl study demo", does)
    parser.description = (
        "The paper's studies of people in the browser: judgments, tags, sessions played by hand, "
        "and their likeness to people. docs/studies.md tells how to run one."
    )
    parts = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_new(cli, parts)
    run = _command(cli, parts, "run", _run, "run my-study", "Serve a study until Ctrl-C.")
    _add_server(cli, run)
    says = "Say how many people came, and how far they got."
    _command(cli, parts, "status", _status, "status my-study", says)
    says = "Write what people said: CSV, events and a README."
    export = _command(cli, parts, "export", _export, "export my-study --out data", says)
    cli.add(export, "--out FOLDER", type=Path, required=True)
    says = "people beside those who finished"
    cli.add(export, "--include", says, default=[], choices=_INCLUDE, action="append")
    cli.add(export, "--without-flagged", "leave out who missed a check")
    cli.add(export, "--demographics", "age and gender of each, not only totals")
    says = "Delete all that somebody gave, for good."
    withdraw = _command(cli, parts, "withdraw", _withdraw, "withdraw my-study 4f0c...", says)
    cli.add(withdraw, "participant ID", "the number shown at the study's end")
    example = "exclude my-study 4f0c... --reason 'the same answer throughout'"
    says = "Leave somebody out of exports, and give their videos to others."
    exclude = _command(cli, parts, "exclude", _exclude, example, says)
    cli.add(exclude, "participant ID")
    cli.add(exclude, "--reason TEXT", required=True)
    says = "Make a study of the bundled events and serve it; nothing is kept."
    demo = cli.command(parts, "demo", _demo, "phase-ppl study demo", says)
    cli.add(demo, "--kind", choices=_KINDS, default="judgment")
    _add_server(cli, demo)
    _add_simulate(cli, parts)


def _command(
    cli: ModuleType, parts: Any, name: str, run: Any, example: str, says: str
) -> argparse.ArgumentParser:
    parser = cli.command(parts, name, run, f"phase-ppl study {example}", says)
    cli.add(parser, "folder DIR", "folder of the study", Path)
    return parser


def _add_server(cli: ModuleType, parser: argparse.ArgumentParser) -> None:
    cli.add(parser, "--port N", "default 8000; 0: any", cli.whole(0), 8000)
    cli.add(parser, "--host", "default 127.0.0.1: this machine only", default="127.0.0.1")
    cli.add(parser, "--url", "by which people come, such as https://study.example.org", default="")


def _add_new(cli: ModuleType, parts: Any) -> None:
    parser = _command(
        cli,
        parts,
        "new",
        functools.partial(_new, cli),
        "new my-study --kind judgment events.json",
        "Make a study: a folder with its settings, films and database.",
    )
    cli.add(parser, "events EVENTS", "event files, folders of them, or bundled events", nargs="+")
    cli.add(parser, "--kind", "default judgment", choices=_KINDS, default="judgment")
    says = "of likeness: counterparts of the played events; default: they are simulated"
    cli.add(parser, "--generated EVENTS", says)
    cli.add(parser, "--title", default="What are they doing?")
    number = cli.whole(1)
    cli.add(parser, "--trials N", "videos per person, default 10; sessions per pair, 3", number)
    cli.add(parser, "--raters N", "people per video, default 20; sessions of a scene, 5", number)
    cli.share(parser, "workers", "progress")


def _add_simulate(cli: ModuleType, parts: Any) -> None:
    parser = _command(
        cli,
        parts,
        "simulate",
        functools.partial(_simulate, cli),
        "simulate my-study --people 200 --out simulated",
        "Send scripted people through a copy of a study, by HTTP, and export what they say; the "
        "study itself stays as it is.",
    )
    cli.add(parser, "--people N", "default 200", cli.whole(1), 200)
    cli.add(parser, "--out FOLDER", "for the export", Path, required=True)
    says = "whose posterior they answer from; default stepwise"
    cli.add(parser, "--model NAME", says, default="stepwise")
    cli.add(parser, "--predictions DIR", "of an evaluation of the same events, instead", Path)
    cli.add_options(parser, "of the model")
    cli.add(parser, "--lapse", "share of answers at random; default 0.1", float, 0.1)
    cli.add(parser, "--drop-outs", "share who leave midway; default 0.1", float, 0.1)
    cli.share(parser, "seed", "progress")


def _study(options: argparse.Namespace) -> Study:
    from phase_study import Study

    return Study(options.folder)


def _new(cli: ModuleType, options: argparse.Namespace) -> int:
    from phase_study import Study
    from phase_study.study import check_extra

    check_extra()
    first, *more = options.events
    events = [e for name in options.events for e in ppl.all_events(name)] if more else first
    study = Study.new(**cli.arguments(Study.new, options, events=events))
    print(f"{study}\nIts texts are in {study.folder / 'study.toml'}; say there who is responsible.")
    if options.kind == "play":
        for warning in study.check():
            print(f"phase-ppl: note: {warning}", file=sys.stderr)
    print(f"Try it: phase-ppl study run {options.folder}")
    return 0


def _run(options: argparse.Namespace) -> int:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    _serve(_study(options), options)
    return 0


def _serve(study: Study, options: argparse.Namespace) -> None:
    def say(address: str) -> None:
        print(f"{address}   Ctrl-C ends", flush=True)

    with contextlib.suppress(KeyboardInterrupt):
        study.run(options.port, options.host, options.url, ready=say)


def _demo(options: argparse.Namespace) -> int:
    from phase_study import Study
    from phase_study.study import check_extra

    check_extra()
    # clean up where a service is ended; the server has written everything by then
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with tempfile.TemporaryDirectory(prefix="phase-ppl-study-") as folder:
        print("Making the films, about half a minute ...", flush=True)
        names = ppl.bundled_events()[:3]
        events = [ppl.load_event(name) for name in names]
        study = Study.new(Path(folder) / "demo", events, options.kind, trials=3)
        _serve(study, options)
    return 0


def _status(options: argparse.Namespace) -> int:
    print(_study(options).status())
    return 0


def _export(options: argparse.Namespace) -> int:
    flagged = [] if options.without_flagged else ["flagged"]
    found = _study(options).export(
        options.out, include=[*options.include, *flagged], demographics=options.demographics
    )
    print(f"Written to {found}; {found / 'README.md'} says what is what.")
    return 0


def _withdraw(options: argparse.Namespace) -> int:
    _study(options).withdraw(options.participant)
    print(
        f"All that {options.participant} gave is deleted here; exports made before still have it."
    )
    return 0


def _exclude(options: argparse.Namespace) -> int:
    _study(options).exclude(options.participant, options.reason)
    print(f"{options.participant} is left out of exports.")
    return 0


def _simulate(cli: ModuleType, options: argparse.Namespace) -> int:
    from phase_study.simulate import simulate
    from phase_study.study import check_extra

    check_extra()
    of_model = cli.once(options.option)
    found = simulate(_study(options), **cli.arguments(simulate, options, options=of_model))
    print(f"{found}\n\nThese are no people: every file in {options.out} is simulated.")
    return 0
