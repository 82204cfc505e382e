"""How many transitions a second does a GPU make, beside one core of this machine?

    python benchmarks/gpu.py [--worlds N ...] [--steps T] [--json FILE]

The GPU runs the same source as the processor. Each thread advances its own world by random actions
of both agents, in double precision. Worlds start in a crowded room or from a bundled event. The
table has transitions a second by the number of worlds, and the largest difference from the
processor after one transition and after all. Needs the package numba-cuda and a GPU; without them
it ends with the reason.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import common
import numba
import numpy as np
from speed.scenes import STRENGTHS, crowded

import phase_ppl as ppl
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.physics.flat import BIAS_SPIN, CONTACTS_PER_BODY, Params, Scratch
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import State
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.scene import Scene

cuda: Any
try:
    from numba import cuda
except ImportError as error:
    sys.exit(f"skipped: numba has no CUDA target here ({error})")

THREADS = 64  # of a block; 32 to 256 are as fast
AHEAD = 20  # random steps before what is measured, so that worlds differ
COMPARED = 2_000  # worlds, of which this machine's processor advances each too
CLOSE = 1e-9
REPEATS = 5
N_BODIES, N_AGENTS, N_COLUMNS = len(ENTITIES), len(AGENTS), BIAS_SPIN + 1
N_CORNERS, N_CONTACTS = 4, CONTACTS_PER_BODY * len(ENTITIES)


class Worlds(NamedTuple):
    """States of many worlds, and what their agents do next."""

    bodies: FloatArray  # (world, body, column)
    held: IntArray  # (world, agent)
    weld: FloatArray  # (world, agent, 3)
    actions: IntArray  # (world, step, agent)


@numba.njit(nogil=True)
def on_the_processor(worlds: Worlds, params: Params, scratch: Scratch) -> None:
    """Advance worlds by their actions, one after the other."""
    bodies, held, weld, actions = worlds
    for world in range(len(bodies)):
        for t in range(actions.shape[1]):
            compiled.step(
                bodies[world], held[world], weld[world], actions[world, t], params, scratch
            )


def moving(scene: Scene, params: Params, n: int, steps: int) -> Worlds:
    """Return ``n`` states of random motion that began with ``scene``, and further actions."""
    rng = np.random.default_rng(0)
    start: tuple[Any, ...] = compiled.from_state(State.at_start(scene), scene.radius)
    bodies, held, weld = (np.repeat(x[None], n, axis=0) for x in start)
    before = rng.integers(0, N_ACTIONS, (n, AHEAD, N_AGENTS))
    on_the_processor(Worlds(bodies, held, weld, before), params, compiled.make_scratch())
    return Worlds(bodies, held, weld, rng.integers(0, N_ACTIONS, (n, steps, N_AGENTS)))


def kernel_of_the_gpu() -> Any:
    """Return the same as a kernel of the GPU: one world a thread, worlds along the last axis."""
    step, f8, i8 = compiled.step, numba.float64, numba.int64

    @cuda.jit
    def advance(bodies: Any, held: Any, weld: Any, actions: Any, params: Any) -> None:
        world = cuda.grid(1)
        if world >= bodies.shape[2]:
            return
        scratch = Scratch(
            cuda.local.array((N_BODIES, 2), f8),
            cuda.local.array((N_BODIES, 4), f8),
            cuda.local.array((N_AGENTS, N_CORNERS, 2), f8),
            cuda.local.array((N_AGENTS, N_CORNERS, 2), f8),
            cuda.local.array((N_AGENTS, 3), f8),
            cuda.local.array((N_CONTACTS, 2), i8),
            cuda.local.array((N_CONTACTS, 8), f8),
            cuda.local.array(N_BODIES, numba.boolean),
            cuda.local.array((N_BODIES, 2), f8),
            cuda.local.array((N_AGENTS, 11), f8),
            cuda.local.array((N_BODIES, 3), f8),
        )
        my_bodies = cuda.local.array((N_BODIES, N_COLUMNS), f8)
        my_held = cuda.local.array(N_AGENTS, i8)
        my_weld = cuda.local.array((N_AGENTS, 3), f8)
        my_actions = cuda.local.array(N_AGENTS, i8)
        for body in range(N_BODIES):
            scratch.rotation[body, 0], scratch.rotation[body, 1] = 1.0, 0.0
            for column in range(N_COLUMNS):
                my_bodies[body, column] = bodies[body, column, world]
        for agent in range(N_AGENTS):
            my_held[agent] = held[agent, world]
            for column in range(3):
                my_weld[agent, column] = weld[agent, column, world]
        for t in range(actions.shape[0]):
            for agent in range(N_AGENTS):
                my_actions[agent] = actions[t, agent, world]
            step(my_bodies, my_held, my_weld, my_actions, params, scratch)
        for body in range(N_BODIES):
            for column in range(N_COLUMNS):
                bodies[body, column, world] = my_bodies[body, column]
        for agent in range(N_AGENTS):
            held[agent, world] = my_held[agent]
            for column in range(3):
                weld[agent, column, world] = my_weld[agent, column]

    return advance


def on_the_gpu(kernel: Any, worlds: Worlds, params: Params, timed: int) -> tuple[Worlds, float]:
    """Return the worlds after their actions, and the least seconds of so many runs."""
    given = [np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in worlds]
    actions = cuda.to_device(given.pop())
    kept = Params._make(cuda.to_device(x) if isinstance(x, np.ndarray) else x for x in params)
    blocks = -(-len(worlds.bodies) // THREADS)
    seconds = math.inf
    for _ in range(1 + timed):  # the first compiles
        states = [cuda.to_device(x) for x in given]
        cuda.synchronize()
        clock = time.perf_counter()
        kernel[blocks, THREADS](*states, actions, kept)
        cuda.synchronize()
        seconds = min(seconds, time.perf_counter() - clock)
    after = [np.moveaxis(x.copy_to_host(), -1, 0) for x in states]
    return Worlds._make([*after, worlds.actions]), seconds


def compared(kernel: Any, worlds: Worlds, params: Params) -> dict[str, float]:
    """Return how far poses and velocities are from the processor's, after the actions."""
    theirs, _ = on_the_gpu(kernel, worlds, params, 0)
    ours = Worlds._make(x.copy() for x in worlds)
    on_the_processor(ours, params, compiled.make_scratch())
    apart = np.abs(ours.bodies - theirs.bodies).max(axis=(1, 2))
    return {
        "equal": float((apart == 0).mean()),
        "close": float((apart <= CLOSE).mean()),
        "median": float(np.median(apart)),
        "largest": float(apart.max()),
        "same_holds": float((ours.held == theirs.held).mean()),
    }


def measure(scene: Scene, kernel: Any, counts: Sequence[int], steps: int) -> dict[str, Any]:
    """Return transitions a second of one core and of the GPU, and how far they are apart."""
    params = compiled.make_params(scene, STRENGTHS, inner_steps=1)
    few = moving(scene, params, COMPARED, steps)
    scratch, seconds = compiled.make_scratch(), math.inf
    for _ in range(REPEATS):
        copied = Worlds._make(x.copy() for x in few)
        clock = time.perf_counter()
        on_the_processor(copied, params, scratch)
        seconds = min(seconds, time.perf_counter() - clock)
    found: dict[str, Any] = {"one_core": COMPARED * steps / seconds, "gpu": {}}
    for n in counts:
        _, seconds = on_the_gpu(kernel, moving(scene, params, n, steps), params, REPEATS)
        found["gpu"][n] = n * steps / seconds
    found["after_one"] = compared(kernel, few._replace(actions=few.actions[:, :1]), params)
    found["after_all"] = compared(kernel, few, params)
    return found


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1_024, 16_384, 131_072])
    parser.add_argument("--steps", type=int, default=20)
    options = parser.parse_args()
    if not cuda.is_available():
        sys.exit("skipped: numba-cuda finds no GPU with a driver that it can use")
    card = cuda.get_current_device().name
    print(card if isinstance(card, str) else card.decode())
    kernel, report = kernel_of_the_gpu(), {}
    for name, scene in {
        "crowded": crowded(),
        "collaborate": ppl.load_event("collaborate").scene,
    }.items():
        found = report[name] = measure(scene, kernel, options.worlds, options.steps)
        print(f"{name}: one core {found['one_core'] / 1e6:.2f} million transitions a second")
        for n, rate in found["gpu"].items():
            print(
                f"  {n:>9,} worlds: {rate / 1e6:8.1f} million, {rate / found['one_core']:.0f} cores"
            )
        for steps, when in ((1, "after_one"), (options.steps, "after_all")):
            f = found[when]
            print(
                f"  after {steps} steps the same bits in {f['equal']:.4f} of the worlds, within"
                f" {CLOSE:g} in {f['close']:.4f}, holds in {f['same_holds']:.4f};"
                f" apart {f['median']:.1e} in the median, {f['largest']:.1e} at most"
            )
    common.write(report, options.json)


if __name__ == "__main__":
    main()
