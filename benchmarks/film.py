"""How well are events read back from films?

    python benchmarks/film.py [--layout] [--width N] [--crf N] [--closed-loop] [--kept FILE]

Real videos are filmed, read, and compared with their tracks. The reader knows the scene, or with
``--layout`` only the world PHASE. Films are smaller by ``--width``, more compressed by ``--crf``.
The closed loop's answers on the tracks as read and on the true tracks are compared by
``--closed-loop``. With ``--kept FILE`` an interrupted run continues.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import common
import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_ppl.world.event import Event

QUANTILES = (0.5, 0.99, 1.0)
ASKED = ("goal_red", "goal_green", "relation")
Task = tuple[Event, dict[str, Any]]


def filmed(event: Event, folder: Path, width: int | None, crf: int | None) -> Path:
    """Return a film of an event, encoded once more where it is to be smaller or worse."""
    film = folder / "film.mp4"
    ppl.render.video(event, film)
    if width is None and crf is None:
        return film
    worse = folder / "worse.mp4"
    program = imageio_ffmpeg.get_ffmpeg_exe()
    change = ["-vf", f"scale={width or 'iw'}:-2", "-crf", str(crf or 18)]
    subprocess.run([program, "-v", "error", "-y", "-i", film, *change, worse], check=True)
    return worse


def errors(read: Event, true: Event) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return (time, entity) errors of positions, units, and (time, agent) of angles, rad."""
    n_agents = len(true.scene.world.agents)
    off = np.linalg.norm(read.observation.positions - true.observation.positions, axis=2)
    turned = (read.observation.angles - true.observation.angles)[:, :n_agents]
    return off, np.abs((turned + np.pi) % (2 * np.pi) - np.pi)


def same_walls(one: Event, other: Event) -> bool:
    first, second = (sorted(e.scene.walls.reshape(-1, 4).tolist()) for e in (one, other))
    return len(first) == len(second) and np.allclose(first, second, atol=0.051)


def answers(event: Event) -> dict[str, dict[str, float]]:
    """Return the closed loop's probabilities of goals and relation."""
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    post = ppl.infer(event, model, seed=0, workers=1, progress=False)
    return {name: {k: float(p) for k, p in post.top(name, 40)} for name in ASKED}


def film_and_read(task: Task) -> dict[str, Any]:
    """Return how far off an event read from a film is, and what the closed loop makes of it."""
    event, settings = task
    with tempfile.TemporaryDirectory() as folder:
        film = filmed(event, Path(folder), settings["width"], settings["crf"])
        what: dict[str, Any] = {"layout": "phase"} if settings["layout"] else {"scene": event.scene}
        try:
            reading = ppl.read_video(film, **what, progress=False)
        except ppl.PhasePPLError as error:
            return {"refused": str(error)}
    off, turned = errors(reading.event, event)
    scene = reading.event.scene
    found = {
        "frames": event.observation.n_frames,
        "off": off.round(5).tolist(),
        "turned": turned.round(5).tolist(),
        "confidence": reading.confidence.tolist(),
        "size": float(np.abs(scene.radius - event.scene.radius).max()),
        "walls": same_walls(reading.event, event),
        "turning": bool(scene.turning == event.scene.turning),
    }
    if settings["closed_loop"]:
        found |= {"read": answers(reading.event), "true": answers(event)}
    return found


def what_changes(event: Event, read: Any, true: Any) -> dict[str, Any]:
    """Return, by quantity, what the closed loop says on the tracks as read and on the true ones."""
    rows: dict[str, Any] = {}
    for name in ASKED:
        truth, one, other = getattr(event.truth, name), read[name], true[name]
        changes = [abs(one.get(label, 0.0) - other.get(label, 0.0)) for label in {**one, **other}]
        rows[name] = {"change": max(changes)}
        for which, shares in (("read", one), ("true", other)):
            right = max(shares, key=shares.__getitem__) == truth
            rows[name][which] = {"right": float(right), "truth": shares.get(truth, 0.0)}
    return rows


def say_closed_loop(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print and return means over videos, and of differences with paired bootstrap intervals."""
    table: dict[str, Any] = {}
    print(f"closed loop, {len(rows)} videos: on tracks as read, on true ones, difference")
    for title, names in {"goals": ASKED[:2], "relation": ASKED[2:]}.items():
        for what in ("right", "truth"):
            read, true = (
                np.array([[row[name][which][what] for name in names] for row in rows]).mean(1)
                for which in ("read", "true")
            )
            of = {"read": read, "true": true, "by": read - true}
            found = table[f"{title} {what}"] = {k: common.interval(x) for k, x in of.items()}
            said = (common.shown(x, "8.3f", ".3f") for x in found.values())
            print(f"{title + ' ' + what:16}" + "".join(said))
    most = [max(row[name]["change"] for name in ASKED[:2]) for row in rows]
    table["change"] = np.quantile(most, [0.25, 0.5, 0.75, 1.0]).tolist()
    print("largest change of a goal's share: quartiles and most", np.round(table["change"], 3))
    return table


def main() -> None:
    parser = common.parser(__doc__, "workers", "json")
    parser.add_argument("--layout", action="store_true", help="read without the scene")
    parser.add_argument("--limit", type=int, help="only this many videos, the shortest")
    parser.add_argument("--width", type=int, help="of the film, pixels")
    parser.add_argument("--crf", type=int, help="H.264's constant rate factor; default 18")
    parser.add_argument("--closed-loop", action="store_true", help="compare its answers too")
    parser.add_argument(
        "--kept", type=Path, metavar="FILE", help="keeps results; a second run continues"
    )
    options = parser.parse_args()
    events = common.dev_events()[::-1][: options.limit]
    settings = {name: getattr(options, name) for name in ("layout", "width", "crf", "closed_loop")}
    tasks = [(event, settings) for event in events]
    found = common.resumed(
        film_and_read,
        tasks,
        lambda task: task[0].id,
        "videos",
        options.kept,
        settings,
        options.workers,
    )
    rows = {e.id: row for e, row in zip(events, found, strict=True) if "refused" not in row}
    refused = {
        e.id: row["refused"] for e, row in zip(events, found, strict=True) if e.id not in rows
    }
    report: dict[str, Any] = {"known": "layout" if options.layout else "scene", "refused": refused}
    off, turned, sure = (
        np.concatenate([np.ravel(row[name]) for row in rows.values()])
        for name in ("off", "turned", "confidence")
    )
    report["interpolated"] = float((sure == 0).mean())
    print(f"{len(rows)} videos read, {len(refused)} refused; median, 99 %, largest error")
    for name, values in (("position", off), ("seen", off[sure > 0]), ("angle", turned)):
        report[name] = np.quantile(values, QUANTILES).tolist()
        print(f"{name:9}" + "".join(f"{value:8.3f}" for value in report[name]))
    print(f"{report['interpolated']:.4f} of all places interpolated")
    if options.layout:
        print(f"sizes off by at most {max(row['size'] for row in rows.values()):.3f} units")
        for name in ("walls", "turning"):
            print(f"{name} right in {sum(row[name] for row in rows.values())} of {len(rows)}")
    report["videos"] = {
        name: {key: row[key] for key in ("frames", "size", "walls", "turning")}
        | {"position": np.quantile(row["off"], QUANTILES).tolist()}
        | {"angle": np.quantile(row["turned"], QUANTILES).tolist()}
        for name, row in rows.items()
    }
    if options.closed_loop:
        read = [event for event in events if event.id in rows]
        each = [what_changes(e, rows[e.id]["read"], rows[e.id]["true"]) for e in read]
        report["closed_loop"] = say_closed_loop(each)
        for event, row in zip(read, each, strict=True):
            report["videos"][event.id]["closed_loop"] = row
    common.write(report, options.json)


if __name__ == "__main__":
    main()
