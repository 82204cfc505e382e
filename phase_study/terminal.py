"""Put events before people, in the browser.

The paper's studies of people: judgments, tags, sessions played by hand, and their likeness
to people. docs/studies.md tells how to run one.

example: phase-ppl study demo
"""

from __future__ import annotations

import contextlib
import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import phase_ppl as ppl

if TYPE_CHECKING:
    from phase_study import Study


def new(options: Any) -> None:
    """Make a study: a folder with its settings, films and database.

    Args:
        FOLDER: of the study
        EVENTS...: event files, folders of them, or bundled events
        --kind judgment|tagging|likeness|play: default judgment
        --generated EVENTS: of likeness: counterparts of the played events; default: they are
            simulated
        --title TEXT: default "What are they doing?"
        --trials N: videos per person, default 10; sessions per pair, 3
        --raters N: people per video, default 20; sessions of a scene, 5
        $workers
        $progress

    example: phase-ppl study new my-study --kind judgment events.json
    """
    first, *more = options.events
    events = [e for name in options.events for e in ppl.all_events(name)] if more else first
    study = options.call(_with_extra().new, events=events)
    print(f"{study}\nIts texts are in {study.folder / 'study.toml'}; say there who is responsible.")
    if options.kind == "play":
        for warning in study.check():
            print(f"phase-ppl: note: {warning}", file=sys.stderr)
    print(f"Try it: phase-ppl study run {options.folder}")


def run(options: Any) -> None:
    """Serve a study until Ctrl-C.

    Args:
        FOLDER: of the study
        --port N: default 8000; 0: any
        --host NAME: default 127.0.0.1: this machine only
        --url URL: address by which people come, such as https://study.example.org

    example: phase-ppl study run my-study
    """
    _serve(_study(options), options)


def status(options: Any) -> None:
    """Print how many people came, and how far they got.

    Args:
        FOLDER: of the study

    example: phase-ppl study status my-study
    """
    print(_study(options).status())


def export(options: Any) -> None:
    """Write people's answers: CSV, events and a README.

    Args:
        FOLDER: of the study
        --out DIR: required
        --include NAME...: people beside those who finished: unfinished or excluded
        --without-flagged: leave out people who missed a check
        --demographics: age and gender of each, not only totals

    example: phase-ppl study export my-study --out data
    """
    flagged = [] if options.without_flagged else ["flagged"]
    found = options.call(_study(options).export, include=[*options.include, *flagged])
    print(f"Written to {found}; {found / 'README.md'} says what is what.")


def withdraw(options: Any) -> None:
    """Delete all data of a participant, for good.

    Args:
        FOLDER: of the study
        PARTICIPANT: the number shown at the study's end

    example: phase-ppl study withdraw my-study 4f0c...
    """
    _study(options).withdraw(options.participant)
    print(
        f"All that {options.participant} gave is deleted here; exports made before still have it."
    )


def exclude(options: Any) -> None:
    """Exclude a participant from exports, and give their videos to others.

    Args:
        FOLDER: of the study
        PARTICIPANT: their number
        --reason TEXT: required

    example: phase-ppl study exclude my-study 4f0c... --reason 'the same answer throughout'
    """
    _study(options).exclude(options.participant, options.reason)
    print(f"{options.participant} is left out of exports.")


def demo(options: Any) -> None:
    """Make a study of the bundled events and serve it; nothing is kept.

    Args:
        --kind judgment|tagging|likeness|play: default judgment
        --port N: default 8000; 0: any
        --host NAME: default 127.0.0.1: this machine only
        --url URL: address by which people come, such as https://study.example.org

    example: phase-ppl study demo
    """
    study = _with_extra()
    with tempfile.TemporaryDirectory(prefix="phase-ppl-study-") as folder:
        print("Making the films, about half a minute ...", flush=True)
        events = [ppl.load_event(name) for name in ppl.bundled_events()[:3]]
        kind = options.kind or "judgment"
        _serve(study.new(Path(folder) / "demo", events, kind, trials=3), options)


def simulate(options: Any) -> None:
    """Send scripted people through a copy of a study, by HTTP, and export their answers.

    The study itself stays as it is.

    Args:
        FOLDER: of the study
        --people N: default 200
        --out DIR: for the export; required
        --model NAME: the model whose posterior gives the answers; default closed_loop
        --predictions DIR: of an evaluation of the same events, instead
        --option NAME=VALUE...: of the model; may be given several times
        --lapse X: share of random answers; default 0.1
        --drop-outs X: share of people who leave midway; default 0.1
        $seed
        $progress

    example: phase-ppl study simulate my-study --people 200 --out simulated
    """
    _with_extra()
    from phase_study.simulate import simulate as simulated

    found = options.call(simulated, study=_study(options), options=options.option)
    print(f"{found}\n\nThese are no people: every file in {options.out} is simulated.")


def _study(options: Any) -> Study:
    from phase_study import Study

    return Study(options.folder)


def _with_extra() -> type[Study]:
    from phase_study.study import Study, check_extra

    check_extra()
    return Study


def _serve(study: Study, options: Any) -> None:
    # clean up if a service is ended; the server has written everything by then
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with contextlib.suppress(KeyboardInterrupt):
        options.call(study.run, ready=lambda url: print(f"{url}   Ctrl-C ends", flush=True))
