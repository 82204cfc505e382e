"""How well are events read back from films? Real videos are filmed, read, and compared.

With their scene, or by the layout PHASE alone; as they are, or smaller and more compressed. With
`--closed-loop N`, what the closed loop says of goals on the tracks as read, beside what it says on
the true ones, for the N shortest videos.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from common import dev_events, write
from numpy.typing import NDArray
from tqdm import tqdm

import phase_ppl as ppl
from phase_ppl.world.event import Event

QUANTILES = (0.5, 0.99, 1.0)


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


def goals(event: Event) -> dict[str, dict[str, float]]:
    model = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=1))
    post = ppl.infer(event, model, seed=0, workers=1, progress=False)
    return {name: dict(post.top(name, 40)) for name in ("goal_red", "goal_green")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--layout", action="store_true", help="nothing is known of the scene")
    parser.add_argument("--limit", type=int, help="so many videos, the shortest")
    parser.add_argument("--width", type=int, help="of the film, pixels")
    parser.add_argument("--crf", type=int, help="H.264's constant rate factor, 18 as made")
    parser.add_argument("--closed-loop", type=int, default=0, metavar="N")
    parser.add_argument("--json")
    options = parser.parse_args()
    events = dev_events()[::-1][: options.limit]
    known = "layout" if options.layout else "scene"
    report: dict[str, Any] = {"known": known, "videos": {}, "refused": {}, "closed_loop": {}}
    kept: list[tuple[NDArray[Any], ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, event in enumerate(tqdm(events, disable=None)):
            film = filmed(event, Path(folder), options.width, options.crf)
            what: dict[str, Any] = {"layout": "phase"} if options.layout else {"scene": event.scene}
            try:
                reading = ppl.read_video(film, **what, progress=False)
            except ppl.PhasePPLError as error:
                report["refused"][event.id] = str(error)
                continue
            found, scene = errors(reading.event, event), reading.event.scene
            kept.append((*found, reading.confidence))
            report["videos"][event.id] = {
                "frames": event.observation.n_frames,
                "position": np.quantile(found[0], QUANTILES).tolist(),
                "angle": np.quantile(found[1], QUANTILES).tolist(),
                "size": float(np.abs(scene.radius - event.scene.radius).max()),
                "walls": same_walls(reading.event, event),
                "turning": scene.turning == event.scene.turning,
            }
            if number < options.closed_loop:
                read, true = goals(reading.event), goals(event)
                report["closed_loop"][event.id] = {
                    name: max(
                        abs(read[name].get(goal, 0.0) - true[name].get(goal, 0.0))
                        for goal in {*read[name], *true[name]}
                    )
                    for name in true
                }
                most = max(report["closed_loop"][event.id].values())
                print(f"{event.id}: a goal's share changes by at most {most:.3f}", flush=True)
    parts = (np.concatenate([part.ravel() for part in each]) for each in zip(*kept, strict=True))
    off, turned, sure = parts
    rows, n = report["videos"].values(), len(report["videos"])
    report["interpolated"] = float((sure == 0).mean())
    print(f"{n} videos read, {len(report['refused'])} refused; median, 99 %, largest error")
    for name, values in (("position", off), ("seen", off[sure > 0]), ("angle", turned)):
        report[name] = np.quantile(values, QUANTILES).tolist()
        print(f"{name:9}" + "".join(f"{value:8.3f}" for value in report[name]))
    print(f"{report['interpolated']:.4f} of all places interpolated")
    if options.layout:
        print(f"sizes off by at most {max(row['size'] for row in rows):.3f} units")
        for name in ("walls", "turning"):
            print(f"{name} right in {sum(row[name] for row in rows)} of {n}")
    write(report, options.json)


if __name__ == "__main__":
    main()
