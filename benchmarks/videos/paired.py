"""Two reports of `hypotheses --json`, such as of two planners: differences, video by video."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import common
import numpy as np

from videos.hypotheses import log_mean_exp


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("report", help="report of `hypotheses --json`")
    parser.add_argument("baseline", help="report on the same videos that is subtracted")


def read(file: str) -> dict[str, Any]:
    """Return a report; where the file is none, end and say so."""
    try:
        report = json.loads(Path(file).read_text())
        videos = report["videos"].values()
        complete = all({"errors", "frames", "better"} <= set(video) for video in videos)
        if videos and complete and "seeds" in report["settings"]:
            return report
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass
    sys.exit(f"{file} is no report of `realism.py hypotheses --json`")


def differences(one: dict[str, Any], other: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the mean differences, one minus the other, with 95 % bootstrap intervals over videos.

    Log-likelihoods and errors are those of the noise seeds that both have. Rates need reports that
    tried wrong pairs, with as many seeds.
    """
    pairs = [(video, other["videos"][name]) for name, video in one["videos"].items()]
    rows: dict[str, list[float]] = {"log_likelihood": [], "mean_error_per_frame": []}
    for mine, theirs in pairs:
        n = min(len(mine["errors"]), len(theirs["errors"]))
        errors = mine["errors"][:n], theirs["errors"][:n]
        rows["log_likelihood"].append(log_mean_exp(errors[0]) - log_mean_exp(errors[1]))
        apart = float(np.mean(errors[0]) - np.mean(errors[1]))
        rows["mean_error_per_frame"].append(apart / mine["frames"])
    as_many = one["settings"]["seeds"] == other["settings"]["seeds"]
    for name, rank in (("true_best_rate", 1), ("true_top5_rate", 5)):
        if as_many and name in one and name in other:
            rows[name] = [
                float(len(mine["better"]) < rank) - float(len(theirs["better"]) < rank)
                for mine, theirs in pairs
            ]
    return {name: common.interval(row) for name, row in rows.items()}


def main(options: argparse.Namespace) -> dict[str, Any]:
    one, other = read(options.report), read(options.baseline)
    odd = sorted(set(one["videos"]) ^ set(other["videos"]))
    if odd:
        sys.exit(f"the reports are of different videos: {odd[0]} is in one of them only")
    figures = differences(one, other)
    n = len(one["videos"])
    print(f"{options.report} minus {options.baseline}, {n} videos, 95 % intervals")
    for name, row in figures.items():
        print(f"{name:22} {common.shown(row, '+7.2f', '+.2f')}")
    return {"n_videos": n, **figures}
