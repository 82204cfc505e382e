"""The command ``diagnose``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

import phase_ppl
from phase_ppl.analysis.summary import LABEL, plain, wrapped
from phase_ppl.cli.shared import posterior, writable_folder
from phase_ppl.world.errors import InvalidSettingError

_NAME: Final = 38
_BLOCKS: Final = 10
"""Stretches of iterations whose acceptance is printed, at most."""


def add_to(commands: Any) -> None:
    """Add the command."""
    about = "say whether the chains of a posterior can be trusted"
    parser = commands.add_parser(
        "diagnose",
        help=about,
        description=about,
        epilog="example: phase-ppl diagnose out --out out",
    )
    parser.set_defaults(run=_diagnose)
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a posterior's .nc file, or the folder of infer"
    )
    parser.add_argument(
        "--weights",
        metavar="NAME",
        help="count, importance, visited or likelihood; default: the file's",
    )
    parser.add_argument("--json", action="store_true", help="JSON instead of a table")
    parser.add_argument("--out", metavar="DIR", type=Path, help="for the figures")


def _plain_json(found: Mapping[str, Any]) -> str:
    return json.dumps(plain(dict(found)), indent=1, ensure_ascii=False, allow_nan=False)


def _diagnose(options: argparse.Namespace) -> int:
    post = posterior(options.file, options.weights)
    found = post.diagnostics()
    if not isinstance(post, phase_ppl.Posterior):
        if options.out is not None:
            raise InvalidSettingError(
                f"--out: {options.file} was read step by step, it has no chains to draw"
            )
        print(_plain_json(found) if options.json else post)
        return 0
    written = [] if options.out is None else _figures(post, writable_folder(options.out))
    if options.json:
        print(_plain_json(found))
        return 0
    print(table(post.event_id, found))
    if options.out is None:
        print("\nNothing was drawn; --out DIR keeps figures.")
    else:
        print(f"\nWritten to {options.out}: {', '.join(written)}")
    return 0


def _figures(post: Any, out: Path) -> list[str]:
    phase_ppl.plot.diagnostics(post, out / "diagnostics.png")
    if "step_log_likelihood" not in post.tree["simulations"].dataset:
        return ["diagnostics.png"]
    phase_ppl.plot.over_time(post, out / "over_time.png")
    return ["diagnostics.png", "over_time.png"]


# --- the table -------------------------------------------------------------------------------


def table(event_id: str, found: Mapping[str, Any]) -> str:
    """Return diagnostics as a table of at most 88 columns."""
    head = (
        f"{event_id}: {found['particles']} particles x {found['iterations']} iterations, "
        f"{found['kernel']} ({found['validity']}), weights {found['weights']}"
    )
    lines = [
        *wrapped("diagnostics", head),
        "",
        *wrapped("accepted", _accepted(found)),
        *wrapped("moved", _moved(found)),
        *wrapped("windows", _windows(found["windows"])),
        *wrapped("simulations", _simulations(found)),
        "",
        _row("", ("R-hat", "bulk ESS", "tail ESS"), 12),
        *_scalars(found["scalars"]),
        "",
        _row("", ("P", "draws", "MCSE", "ESS", "R-hat"), 7),
        *_categories(found),
        *wrapped("verdict", found["verdict"]),
    ]
    return "\n".join(lines)


def _scalars(scalars: Mapping[str, Any]) -> Iterator[str]:
    for name, entry in scalars.items():
        sizes = (_whole(entry["ess_bulk"]), _whole(entry["ess_tail"]))
        yield _row(name.replace("_", " "), (_two(entry["r_hat"]), *sizes), 12)


def _categories(found: Mapping[str, Any]) -> Iterator[str]:
    for name, categories in found["categories"].items():
        label = name.replace("_", " ")
        for category, entry in categories.items():
            numbers = (_two(entry["probability"]), _two(entry["share"]), _two(entry["mcse"]))
            cells = (*numbers, _whole(entry["ess"]), _two(entry["r_hat"]))
            yield _row(f"{label:<{LABEL}}{category}", cells, 7)
            label = ""
        apart = found["between_chain_tv"].get(name)
        if apart is not None:
            yield from wrapped(
                "",
                f"the same goal leads in {found['agreement'][name]:.0%} of the particles; two "
                f"differ by {apart['mean']:.2f} on average, by {apart['max']:.2f} at most "
                "(total variation)",
            )
        yield ""


def _row(label: str, cells: tuple[str, ...], width: int) -> str:
    room = LABEL + _NAME
    return (f"{label[: room - 1]:<{room}}" + "".join(f"{cell:>{width}}" for cell in cells)).rstrip()


def _accepted(found: Mapping[str, Any]) -> str:
    rates = found["acceptance_by_iteration"]
    blocks = np.array_split(np.array(rates), min(len(rates), _BLOCKS))
    shares = " ".join(f"{100 * part.mean():.0f}" for part in blocks)
    of_what = (
        "by iteration" if len(rates) <= _BLOCKS else f"by tenth of the {len(rates)} iterations"
    )
    return f"{found['acceptance_rate']:.0%} of the proposals; {of_what}, in percent: {shares}"


def _moved(found: Mapping[str, Any]) -> str:
    distinct = (
        f"{found['distinct_hypotheses']} distinct hypotheses, "
        f"{found['distinct_goal_pairs']} pairs of goals"
    )
    if found["move_rate"] is None:
        return distinct
    return f"to another pair of goals in {found['move_rate']:.0%} of the iterations; {distinct}"


def _windows(windows: Mapping[str, Any]) -> str:
    if not windows["proposals"]:
        return "no proposal came from a window"
    starts = np.repeat(windows["starts"], windows["counts"])
    low, high = np.quantile(starts, (0.25, 0.75)).round().astype(int)
    text = f"{windows['proposals']} proposals from {len(windows['starts'])} windows"
    if windows["frames"] is not None:
        text += f" of {windows['frames']} frames"
    text += f", half of which begin in frames {low} to {high}"
    return f"{text}; {windows['without']} from none" if windows["without"] else text


def _simulations(found: Mapping[str, Any]) -> str:
    counts = found["simulations"]
    return (
        f"{counts['total']}: {counts['completed']} completed, {counts['aborted']} stopped early "
        f"(saved {found['frames_saved_share']:.0%} of the frames), {counts['failed']} failed; the "
        f"best draw is {found['best_error_per_frame']:.2f} units per frame from the observation"
    )


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _whole(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"
