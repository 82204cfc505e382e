"""``infer --model stepwise``, and with ``--watch`` as the video plays."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import phase_ppl
from phase_ppl.cli.shared import INTERRUPTED, POSTERIOR, report_hint
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import write_json
from phase_ppl.world.observation import SHOWN_SECONDS_PER_FRAME

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
    from phase_ppl.world.event import Event

MODELS: Final = ("simple", "stepwise")

FILM: Final = "watch.mp4"
READING: Final = (POSTERIOR, "summary.json", "posterior.png", "over_time.png", "why.png", FILM)
"""Files of results."""

_BAR: Final = 24
_NAME: Final = 32
_LINES_A_SECOND: Final = 4
"""Frames between two lines where the output is no terminal: one a second of the video."""


def model_of(options: argparse.Namespace) -> phase_ppl.Model:
    """Return the model that the options name."""
    if options.model == "simple":
        return phase_ppl.Model(prior=options.prior, planner=options.planner)
    likelihood = phase_ppl.StepwiseLikelihood()
    return phase_ppl.Model(prior=options.prior, planner=options.planner, likelihood=likelihood)


def watched(event: Event, out: Path | None, options: argparse.Namespace) -> int:
    """Show the posterior after every frame; print and keep the last one."""
    sampling = ("chains", "iterations", "budget", "on_failure", "retries")
    given = [f"--{name.replace('_', '-')}" for name in sampling if getattr(options, name)]
    if given or options.option:
        raise InvalidSettingError(f"{', '.join(given) or '--option'}: nothing is sampled")
    code = 0
    screen = _Screen(sys.stdout.isatty() and not options.quiet)
    with phase_ppl.watch(
        event.scene,
        model_of(options),
        seed=options.seed,
        threads=options.workers,
        event_id=event.id,
    ) as watch:
        try:
            for index, frame in enumerate(event.observation.trajectory):
                post = watch.update(frame)
                if not options.quiet:
                    screen.show(post, index)
        except KeyboardInterrupt:
            print("phase-ppl: interrupted; this is what was seen until then", file=sys.stderr)
            code = INTERRUPTED
        post = watch.posterior()
    screen.end()
    print(post)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, figures and a film.")
        return code
    written = write_reading(post, out)
    print(f"\nWritten to {out}: {', '.join(written)}")
    print(report_hint(out))
    return code


def write_reading(post: StepwisePosterior, out: Path) -> tuple[str, ...]:
    """Write the posterior, a summary, figures and the film into ``out``; return their names."""
    best, second = (name for name, _ in post.top("relation", 2))
    post.save(out / POSTERIOR)
    write_json(out / "summary.json", post.summary())
    phase_ppl.plot.posterior(post, path=out / "posterior.png")
    phase_ppl.plot.over_time(post, path=out / "over_time.png")
    phase_ppl.plot.why(post, f"relation={best}", f"relation={second}", path=out / "why.png")
    phase_ppl.watch_film(post, out / FILM)
    return READING


class _Screen:
    """Bars that move in place on a terminal; elsewhere a line a second of the video."""

    def __init__(self, in_place: bool) -> None:
        self._in_place = in_place
        self._lines = 0

    def show(self, post: StepwisePosterior, frame: int) -> None:
        seconds = frame * SHOWN_SECONDS_PER_FRAME
        if not self._in_place:
            if frame % _LINES_A_SECOND == 0:
                print(f"{seconds:5.1f} s  {_in_a_line(post)}", flush=True)
            return
        width = shutil.get_terminal_size().columns - 1
        lines = [f"{post.event_id}, {seconds:.1f} s", *_bars(post)]
        back = f"\x1b[{self._lines}F" if self._lines else ""
        print(back + "\n".join(f"\x1b[2K{line[:width]}" for line in lines), flush=True)
        self._lines = len(lines)

    def end(self) -> None:
        print()


def _bars(post: StepwisePosterior) -> list[str]:
    lines = []
    for title, name, n in (("red", "goal_red", 3), ("green", "goal_green", 3), ("", "relation", 3)):
        for label, share in post.top(name, n):
            bar = "#" * round(share * _BAR)
            lines.append(f"{title:<6}{label:<{_NAME}}{share:5.2f}  {bar}")
            title = ""
    return lines


def _in_a_line(post: StepwisePosterior) -> str:
    parts = []
    for title, name in (("red", "goal_red"), ("green", "goal_green"), ("relation", "relation")):
        label, share = post.top(name, 1)[0]
        parts.append(f"{title}: {label} {share:.2f}")
    return "; ".join(parts)
