"""The command ``study``: the paper's studies of people, in the browser."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.cli.shared import add_progress, command, named_value, shows_progress, whole

if TYPE_CHECKING:
    from phase_ppl.study import Study

_KINDS: Final = ("judgment", "tagging", "likeness", "play")
_INCLUDE: Final = ("unfinished", "excluded")


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "study",
        description="The paper's studies of people in the browser: judgments, tags, sessions "
        "played by hand, and their likeness to people. docs/studies.md tells how to run one.",
        epilog="example: phase-ppl study demo",
    )
    parts = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_new(parts)
    run = _command(parts, "run", _run, "Serve a study until Ctrl-C.", "run my-study")
    _add_server(run)
    _command(
        parts,
        "status",
        _status,
        "Say how many people came, and how far they got.",
        "status my-study",
    )
    export = _command(
        parts,
        "export",
        _export,
        "Write what people said: CSV, events and a README.",
        "export my-study --out data",
    )
    export.add_argument("--out", metavar="FOLDER", type=Path, required=True)
    export.add_argument(
        "--include",
        choices=_INCLUDE,
        action="append",
        default=[],
        help="people beside those who finished",
    )
    export.add_argument(
        "--without-flagged", action="store_true", help="leave out who missed a check"
    )
    export.add_argument(
        "--demographics", action="store_true", help="age and gender of each, not only totals"
    )
    withdraw = _command(
        parts,
        "withdraw",
        _withdraw,
        "Delete all that somebody gave, for good.",
        "withdraw my-study 4f0c...",
    )
    withdraw.add_argument("participant", metavar="ID", help="the number shown at the study's end")
    exclude = _command(
        parts, "exclude", _exclude,
        "Leave somebody out of exports, and give their videos to others.",
        "exclude my-study 4f0c... --reason 'the same answer throughout'",
    )  # fmt: skip
    exclude.add_argument("participant", metavar="ID")
    exclude.add_argument("--reason", metavar="TEXT", required=True)
    demo = command(
        parts, "demo", _demo, "Make a study of the bundled events and serve it; nothing is kept.",
        "phase-ppl study demo",
    )  # fmt: skip
    demo.add_argument("--kind", choices=_KINDS, default="judgment")
    _add_server(demo)
    _add_simulate(parts)


def _command(parts: Any, name: str, run: Any, says: str, example: str) -> argparse.ArgumentParser:
    parser = command(parts, name, run, says, f"phase-ppl study {example}")
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of the study")
    return parser


def _add_server(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port", metavar="N", type=whole(0), default=8000, help="default 8000; 0: any"
    )
    parser.add_argument("--host", default="127.0.0.1", help="default 127.0.0.1: this machine only")
    parser.add_argument(
        "--url", default="", help="by which people come, such as https://study.example.org"
    )


def _add_new(parts: Any) -> None:
    parser = _command(
        parts, "new", _new, "Make a study: a folder with its settings, films and database.",
        "new my-study --kind judgment events.json",
    )  # fmt: skip
    parser.add_argument(
        "events",
        metavar="EVENTS",
        nargs="+",
        help="event files, folders of them, or bundled events",
    )
    parser.add_argument("--kind", choices=_KINDS, default="judgment", help="default judgment")
    parser.add_argument(
        "--generated", metavar="EVENTS", help="of likeness: counterparts of the played events; "
        "default: they are simulated",
    )  # fmt: skip
    parser.add_argument("--title", default="What are they doing?")
    parser.add_argument(
        "--trials",
        metavar="N",
        type=whole(1),
        help="videos per person, default 10; sessions per pair, 3",
    )
    parser.add_argument(
        "--raters",
        metavar="N",
        type=whole(1),
        help="people per video, default 20; sessions of a scene, 5",
    )
    parser.add_argument("--workers", metavar="N", type=whole(1), help="default one per usable core")
    add_progress(parser)


def _add_simulate(parts: Any) -> None:
    parser = _command(
        parts, "simulate", _simulate,
        "Send scripted people through a copy of a study, by HTTP, and export what they say; the "
        "study itself stays as it is.",
        "simulate my-study --people 200 --out simulated",
    )  # fmt: skip
    parser.add_argument("--people", metavar="N", type=whole(1), default=200, help="default 200")
    parser.add_argument("--out", metavar="FOLDER", type=Path, required=True, help="for the export")
    parser.add_argument(
        "--model",
        metavar="NAME",
        default="stepwise",
        help="whose posterior they answer from; default stepwise",
    )
    parser.add_argument(
        "--predictions",
        metavar="DIR",
        type=Path,
        help="of an evaluation of the same events, instead",
    )
    parser.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=named_value,
        action="append",
        default=[],
        help="of the model",
    )
    parser.add_argument(
        "--lapse", type=float, default=0.1, help="share of answers at random; default 0.1"
    )
    parser.add_argument(
        "--drop-outs", type=float, default=0.1, help="share who leave midway; default 0.1"
    )
    parser.add_argument("--seed", metavar="N", type=whole(0), default=0, help="default 0")
    add_progress(parser)


def _study(options: argparse.Namespace) -> Study:
    from phase_ppl.study import Study

    return Study(options.folder)


def _new(options: argparse.Namespace) -> int:
    from phase_ppl.evaluation.judgments import all_events
    from phase_ppl.study import Study
    from phase_ppl.study.study import check_extra

    check_extra()
    several = len(options.events) > 1
    events = (
        [e for name in options.events for e in all_events(name)] if several else options.events[0]
    )
    study = Study.new(
        options.folder,
        events,
        options.kind,
        generated=options.generated,
        title=options.title,
        trials=options.trials,
        raters=options.raters,
        workers=options.workers,
        progress=shows_progress(options),
    )
    print(f"{study}\nIts texts are in {study.folder / 'study.toml'}; say there who is responsible.")
    if options.kind == "play":
        for warning in study.check():
            print(f"phase-ppl: note: {warning}", file=sys.stderr)
    print(f"Try it: phase-ppl study run {options.folder}")
    return 0


def _run(options: argparse.Namespace) -> int:
    from phase_ppl.study.study import check_extra

    check_extra()
    _serve(_study(options), options)
    return 0


def _end_by_sigterm() -> None:
    """Clean up where a service is ended; the server has written everything by then."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))


def _serve(study: Study, options: argparse.Namespace) -> None:
    def say(address: str) -> None:
        print(f"{address}   Ctrl-C ends", flush=True)

    _end_by_sigterm()
    with contextlib.suppress(KeyboardInterrupt):
        study.run(options.port, options.host, options.url, ready=say)


def _demo(options: argparse.Namespace) -> int:
    import phase_ppl
    from phase_ppl.study import Study
    from phase_ppl.study.study import check_extra

    check_extra()
    _end_by_sigterm()
    with tempfile.TemporaryDirectory(prefix="phase-ppl-study-") as folder:
        print("Making the films, about half a minute ...", flush=True)
        names = phase_ppl.bundled_events()[:3]
        events = [phase_ppl.load_event(name) for name in names]
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


def _simulate(options: argparse.Namespace) -> int:
    from phase_ppl.study.simulate import simulate
    from phase_ppl.study.study import check_extra

    check_extra()
    found = simulate(
        _study(options),
        options.out,
        options.people,
        model=options.model,
        predictions=options.predictions,
        options=dict(options.option),
        lapse=options.lapse,
        drop_outs=options.drop_outs,
        seed=options.seed,
        progress=shows_progress(options),
    )
    print(f"{found}\n\nThese are no people: every file in {options.out} is simulated.")
    return 0
