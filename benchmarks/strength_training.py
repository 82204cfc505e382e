"""Train the network of strengths.

    python benchmarks/strength_training.py FOLDER

Simulates events (or reads them from --events-file), blurs them with jitter, cuts windows of all
lengths, and trains. Writes FOLDER/strength_weights.npz and the report
FOLDER/strength_weights.json. Needs the extra ``neural`` (PyTorch).

Scenes have PHASE's layouts, sizes and start positions. Goals and relations are drawn so that
agents mostly have something to do; PHASE's own families of events are narrower.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import common
import numpy as np
from numpy.typing import NDArray
from tqdm.auto import tqdm

from phase_ppl.data.generation.situation import LAYOUTS, SIZES, SPOTS, walls_of
from phase_ppl.inference.strength import (
    FARTHEST,
    SD_RANGE,
    StrengthEstimates,
    StrengthNetwork,
    window_features,
)
from phase_ppl.models.socialgnn.store import needs_torch, torch_threads
from phase_ppl.simulator.joint import JointSimulator, simulate
from phase_ppl.simulator.processes import mapped
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError
from phase_ppl.world.goals import goal_literal, literal_goal
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_LEVELS, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.names import (
    AGENTS,
    BLUE_ITEM,
    GREEN,
    LANDMARKS,
    PINK_ITEM,
    RED,
    Literal,
    PredicateKind,
)
from phase_ppl.world.scene import TURNINGS, Scene

Result = TypeVar("Result")

SIZE_SHARES: Final = (0.55, 0.16, 0.11, 0.18)
"""How often PHASE's sizes are drawn: about as often as there."""

LEVEL_SHARE: Final = 0.5
"""Share of the strengths that are one of the original world's four levels; the rest is uniform
on the support of the prior."""

OWN_GOALS: Final = {"item": 0.65, "self": 0.2, "agents": 0.15}
"""What agents want for themselves, and how often: about as in PHASE."""

COMPANY: Final = {"same": 0.3, "rival": 0.15, "social": 0.25, "alone": 0.3}
"""The two goals: the same, the same item on another landmark, one agent helps or hinders, each
its own."""


class Simulated(NamedTuple):
    """Simulated events of equal length."""

    trajectory: NDArray[np.float32]  # (event, time, entity, coord) x, y [units], angle [rad]
    radius: FloatArray  # (event, entity) sizes, units
    strength: FloatArray  # (event, agent) newtons


def draw_scene(rng: np.random.Generator) -> Scene:
    """Return a scene with a layout, sizes and start positions of PHASE."""
    layout = list(LAYOUTS)[rng.integers(len(LAYOUTS))]
    places = np.reshape(SPOTS, (-1, 2)).astype(np.float64)
    spots = places[rng.choice(len(places), 4, replace=False)]
    angles = np.append(rng.uniform(-2 * np.pi, 2 * np.pi, 2), [0.0, 0.0])
    return Scene(
        start=np.column_stack([spots, angles]),
        radius=rng.choice(SIZES, 4, p=SIZE_SHARES),
        walls=walls_of(layout),
        turning=TURNINGS[rng.integers(len(TURNINGS))],
    )


def draw_hypothesis(rng: np.random.Generator) -> Hypothesis:
    """Return goals, relation and strengths."""
    first, second = _own_goal(rng, RED), _own_goal(rng, GREEN)
    alpha = (0, 0)
    company = rng.choice(list(COMPANY), p=list(COMPANY.values()))
    literal = goal_literal(first, RED)
    if company == "social":
        alpha = ALPHAS[rng.integers(1, len(ALPHAS))]
    elif company == "same" and literal.predicate is PredicateKind.ON:
        second = first
    elif company == "rival" and literal.predicate is PredicateKind.ON:
        others = [landmark for landmark in range(len(LANDMARKS)) if landmark != literal.target]
        second = literal_goal(literal._replace(target=int(rng.choice(others))))
    levels = rng.random(2) < LEVEL_SHARE
    strengths = np.where(levels, rng.choice(STRENGTH_LEVELS, 2), rng.uniform(*STRENGTH_RANGE, 2))
    return Hypothesis(first, second, alpha, *map(float, strengths))


def _own_goal(rng: np.random.Generator, holder: int) -> int:
    """Return an item or the agent itself on a landmark, or the agents together or apart."""
    kind = rng.choice(list(OWN_GOALS), p=list(OWN_GOALS.values()))
    if kind == "agents":
        return literal_goal(
            Literal(PredicateKind.TOUCH, holder, 1 - holder, bool(rng.random() < 0.5))
        )
    subject = int(rng.choice((BLUE_ITEM, PINK_ITEM))) if kind == "item" else holder
    return literal_goal(Literal(PredicateKind.ON, subject, int(rng.integers(len(LANDMARKS))), True))


def in_processes(draw: Callable[[int], Result], n: int, workers: int) -> list[Result]:
    """Return ``draw(0)``, ..., ``draw(n - 1)``, each of which simulates an event."""
    JointSimulator().warm_up()
    return list(mapped(draw, [(index,) for index in range(n)], workers, "event"))


def _simulated(seed: int, frames: int, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return trajectory, sizes and strengths of one drawn event."""
    rng = np.random.default_rng([seed, index])
    scene, hypothesis = draw_scene(rng), draw_hypothesis(rng)
    of_event = int(rng.integers(2**31))
    event = simulate(scene, hypothesis, frames=frames, seed=of_event, overlapping=True)
    return event.observation.trajectory, scene.radius, np.array(hypothesis.strengths)


def simulate_events(n: int, frames: int, seed: int, workers: int = 1) -> Simulated:
    """Return ``n`` drawn events, the same for any number of workers."""
    found = in_processes(functools.partial(_simulated, seed, frames), n, workers)
    trajectory, radius, strength = zip(*found, strict=True)
    return Simulated(np.array(trajectory, np.float32), np.array(radius), np.array(strength))


def cached_events(file: Path, n: int, frames: int, seed: int, workers: int = 1) -> Simulated:
    """Return drawn events, from a file if they are there, else simulated and written to it."""
    wanted: dict[str, Any] = {"events": n, "frames": frames, "seed": seed}
    if file.exists():
        with np.load(file) as kept:
            found = json.loads(str(kept["settings"]))
            if found != wanted:
                raise InvalidSettingError(f"{file} holds events of {found}, not of {wanted}")
            return Simulated(*(kept[name] for name in Simulated._fields))
    events = simulate_events(n, frames, seed, workers)
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(file, settings=json.dumps(wanted), **events._asdict())
    return events


# --- examples: windows of events, blurred and cut ------------------------------------------------

LARGEST_JITTER: Final = 0.35  # of the positions in the training, units

ANGLE_SHARE: Final = 0.2
"""Jitter of the angles in rad, for one unit of jitter of the positions. It fits an agent of size 1
with about ten points of its rim seen at that precision. The training goes up to twice as far."""

WINDOWS_PER_CUT: Final = 5

VALIDATION_JITTER: Final = (0.0, 0.05, 0.1, 0.3)
VALIDATION_LENGTHS: Final = (1, 2, 5, 10, 20, 0)
"""Steps of the windows; 0 stands for the whole event."""


class Examples(NamedTuple):
    """One window and one agent each."""

    features: NDArray[np.float32]  # (example, feature)
    strength: NDArray[np.float32]  # (example,) newtons
    jitter: FloatArray  # (example,) of the positions, units
    length: NDArray[np.int64]  # (example,) steps of the window; 0 where it is the whole event


def blurred(
    trajectory: FloatArray, jitter: float, rng: np.random.Generator, angle: float = ANGLE_SHARE
) -> FloatArray:
    """Return a trajectory (time, entity, coord) with independent normal noise on all coordinates.

    Of standard deviation ``jitter`` [units] for x and y, and ``angle`` [rad] per unit of it for
    angles.
    """
    return trajectory + rng.normal(0, 1, trajectory.shape) * [jitter, jitter, jitter * angle]


def training_examples(events: Simulated, rounds: int, seed: int) -> Examples:
    """Return examples of each event, blurred and cut anew in each round.

    A third of the rounds has no jitter. Half of the events are cut short before their jitter is
    estimated. Windows are short, of SIMPLE's length, or the whole cut.
    """
    parts = []
    cuts = list(np.ndindex(rounds, len(events.strength)))
    for round_, index in tqdm(cuts, desc="examples", disable=None):
        rng = np.random.default_rng([seed, 1, round_, index])
        trajectory = events.trajectory[index].astype(np.float64)
        if rng.random() < 0.5:
            length = int(np.exp(rng.uniform(np.log(2), np.log(len(trajectory)))))
            first = int(rng.integers(len(trajectory) - length + 1))
            trajectory = trajectory[first : first + length]
        jitter = _drawn_jitter(rng)
        trajectory = blurred(trajectory, jitter, rng, 2 * ANGLE_SHARE * rng.random())
        windows = _drawn_windows(len(trajectory), rng)
        parts.append(_of_windows(events, index, trajectory, windows, jitter))
    return Examples(*map(np.concatenate, zip(*parts, strict=True)))


def validation_examples(events: Simulated, seed: int) -> Examples:
    """Return one window of each length, with each jitter, of each event."""
    parts = []
    for index in range(len(events.strength)):
        for jitter in VALIDATION_JITTER:
            rng = np.random.default_rng([seed, 2, index])
            trajectory = blurred(events.trajectory[index].astype(np.float64), jitter, rng)
            last = len(trajectory) - 1
            windows = []
            for length in VALIDATION_LENGTHS:
                steps = length or last
                first = int(rng.integers(max(last - steps, 0) + 1))
                windows.append((first, min(first + steps, last)))
            found = _of_windows(events, index, trajectory, np.array(windows), jitter)
            lengths = np.repeat(VALIDATION_LENGTHS, len(AGENTS))
            parts.append(found._replace(length=lengths))
    return Examples(*map(np.concatenate, zip(*parts, strict=True)))


def _drawn_jitter(rng: np.random.Generator) -> float:
    kind = rng.integers(3)
    if kind == 0:
        return 0.0
    if kind == 1:
        return float(np.exp(rng.uniform(np.log(0.003), np.log(LARGEST_JITTER))))
    return float(rng.uniform(0.0, LARGEST_JITTER))


def _drawn_windows(n_frames: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return windows (window, 2): the whole, some of ten steps, some of any length."""
    windows = [(0, n_frames - 1)]
    for number in range(WINDOWS_PER_CUT):
        steps = 10 if number % 2 == 0 else int(np.exp(rng.uniform(0, np.log(n_frames))))
        steps = min(steps, n_frames - 1)
        first = int(rng.integers(n_frames - steps))
        windows.append((first, first + steps))
    return np.unique(windows, axis=0)


def _of_windows(
    events: Simulated, index: int, trajectory: FloatArray, windows: NDArray[np.int64], jitter: float
) -> Examples:
    features = window_features(trajectory, events.radius[index], windows)
    n = len(windows) * len(AGENTS)
    return Examples(
        features.reshape(n, -1),
        np.tile(events.strength[index], len(windows)).astype(np.float32),
        np.full(n, jitter),
        np.repeat(windows[:, 1] - windows[:, 0], len(AGENTS)),
    )


# --- training -----------------------------------------------------------------------------------

_HALF_LOG_2PI: Final = 0.5 * np.log(2 * np.pi)
HIDDEN: Final = 64  # units of each of the two hidden layers, as in the paper
SMALLEST_SCALE: Final = 0.05  # features that hardly vary in the training are not blown up


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """How the network is made."""

    events: int = 1500  # number of simulated events; a tenth of them validates
    frames: int = 61  # length of each
    rounds: int = 6  # how often each event is blurred and cut anew
    epochs: int = 20  # passes over all examples; the best by validation counts
    batch: int = 512  # examples per step
    learning_rate: float = 2e-3  # at the start; it falls to zero along a cosine
    weight_decay: float = 1e-2  # of the weights
    dropout: float = 0.2  # share of hidden units left out in each step
    seed: int = 0  # of everything random

    def __post_init__(self) -> None:
        for name, least in (("events", 10), ("frames", 12), ("rounds", 1), ("epochs", 1)):
            if getattr(self, name) < least:
                raise InvalidSettingError(f"{name}={getattr(self, name)}, expected >= {least}")


def train(events: Simulated, settings: TrainingSettings) -> tuple[StrengthNetwork, dict[str, Any]]:
    """Return the trained network and the report on it."""
    torch = needs_torch()
    n_validation = len(events.strength) // 10
    held_out = Simulated._make(column[:n_validation] for column in events)
    used = Simulated._make(column[n_validation:] for column in events)
    examples = training_examples(used, settings.rounds, settings.seed)
    validation = validation_examples(held_out, settings.seed)
    centre = examples.features.mean(axis=0)
    scale = np.maximum(examples.features.std(axis=0), SMALLEST_SCALE)

    def tensors(data: Examples) -> tuple[Any, Any]:
        x = np.clip((data.features - centre) / scale, -FARTHEST, FARTHEST)
        return torch.from_numpy(x), torch.from_numpy(data.strength)

    # sums, and so the weights, depend on the number of threads
    with torch_threads(1), torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        curves, layers = _fit(torch, tensors(examples), tensors(validation), settings)
    weights = {"centre": centre, "scale": scale}
    for number, layer in enumerate(layers, start=1):
        weights |= {f"weight_{number}": layer[0].T, f"bias_{number}": layer[1]}
    network = StrengthNetwork(weights)
    report = {
        "settings": dataclasses.asdict(settings),
        "examples": {"training": len(examples.strength), "validation": len(validation.strength)},
        "torch": str(torch.__version__),
        "curves": curves,
        "validation": _by_cell(network, validation),
    }
    return network, report


def _fit(
    torch: Any, training: tuple[Any, Any], validation: tuple[Any, Any], settings: TrainingSettings
) -> tuple[dict[str, list[float]], list[tuple[NDArray[Any], NDArray[Any]]]]:
    """Return the losses per epoch, and (weight, bias) of the layers of the best epoch."""
    nn = torch.nn
    x, y = training
    net = nn.Sequential(
        nn.Linear(x.shape[1], HIDDEN), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(HIDDEN, 2),
    )  # fmt: skip
    optimizer = torch.optim.AdamW(
        net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    n_steps = settings.epochs * -(-len(x) // settings.batch)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, n_steps)
    curves: dict[str, list[float]] = {"training": [], "validation": []}
    best, kept = np.inf, []
    for _ in tqdm(range(settings.epochs), desc="epochs", disable=None):
        losses = []
        net.train()
        for batch in torch.randperm(len(x)).split(settings.batch):
            optimizer.zero_grad()
            loss = _negative_log_density(torch, net(x[batch]), y[batch])
            loss.backward()
            optimizer.step()
            schedule.step()
            losses.append(loss.item())
        net.eval()
        with torch.no_grad():
            loss = _negative_log_density(torch, net(validation[0]), validation[1]).item()
        curves["training"].append(round(float(np.mean(losses)), 4))
        curves["validation"].append(round(loss, 4))
        if loss < best:
            best = loss
            kept = [
                (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
                for layer in net
                if hasattr(layer, "weight")
            ]
    return curves, kept


def _negative_log_density(torch: Any, outputs: Any, strength: Any) -> Any:
    """Return the mean loss: that of a normal distribution cut to the range of strengths."""
    (low, high), (least, most) = STRENGTH_RANGE, np.log(SD_RANGE)
    mean = low + (high - low) * torch.sigmoid(outputs[:, 0])
    sd = torch.exp(least + (most - least) * torch.sigmoid(outputs[:, 1]))
    cdf = torch.special.ndtr
    mass = cdf((high - mean) / sd) - cdf((low - mean) / sd)
    return (0.5 * ((strength - mean) / sd) ** 2 + torch.log(sd * mass)).mean() + _HALF_LOG_2PI


_GRID: Final = np.linspace(*STRENGTH_RANGE, 901)


class Quality(NamedTuple):
    """How good estimates are, as proposals from normal distributions cut to the range."""

    share: float  # of estimates among all
    rmse: float  # of the proposals' mean, newtons; without an estimate, of the prior's mean
    # mean log density of the true strength; without an estimate the uniform prior's, -6.11
    log_density: float
    log_mixture: float  # the same with a tenth of the prior mixed in, as in SIMPLE's proposal
    # share of estimates within one standard deviation of the truth; nan if there are none
    coverage: float


def quality(estimates: StrengthEstimates, strength: FloatArray) -> Quality:
    """Return how good estimates are, given the true strengths (of the same shape), newtons."""
    known = ~np.isnan(estimates.mean).ravel()
    mean = np.where(known, estimates.mean.ravel(), 0.0)[:, None]
    sd = np.where(known, estimates.sd.ravel(), math.inf)[:, None]  # cut, that is uniform
    truth = strength.ravel()[:, None]
    density = np.exp(-0.5 * ((_GRID - mean) / sd) ** 2)
    mass = np.trapezoid(density, _GRID, axis=1)
    middle = np.trapezoid(density * _GRID, _GRID, axis=1) / mass
    log_density = -0.5 * ((truth - mean) / sd)[:, 0] ** 2 - np.log(mass)
    log_prior = -math.log(STRENGTH_RANGE[1] - STRENGTH_RANGE[0])
    mixture = np.logaddexp(log_density + math.log(0.9), log_prior + math.log(0.1))
    inside = (np.abs(truth - mean) <= sd)[known]
    return Quality(
        share=float(known.mean()),
        rmse=float(np.sqrt(((middle - truth[:, 0]) ** 2).mean())),
        log_density=float(log_density.mean()),
        log_mixture=float(mixture.mean()),
        coverage=float(inside.mean()) if known.any() else math.nan,
    )


def _by_cell(network: StrengthNetwork, validation: Examples) -> list[dict[str, float]]:
    """Return the quality on the validation events by jitter and length of the window."""
    mean, sd = network.outputs(validation.features)
    cells = []
    for jitter in VALIDATION_JITTER:
        for length in VALIDATION_LENGTHS:
            cell = (validation.jitter == jitter) & (validation.length == length)
            found = quality(StrengthEstimates(mean[cell], sd[cell]), validation.strength[cell])
            figures = {name: round(value, 3) for name, value in found._asdict().items()}
            cells.append({"jitter": jitter, "steps": length or "all", **figures})
    return cells


def main(arguments: list[str] | None = None) -> None:
    """Train as the command line says."""
    parser = common.parser(__doc__)
    parser.add_argument("folder", type=Path, help="where strength_weights.npz and .json go")
    parser.add_argument("--events-file", type=Path, help="keeps the simulated events (npz)")
    parser.add_argument("--workers", type=int, default=1, help="processes that simulate")
    for field in dataclasses.fields(TrainingSettings):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default)
    options = parser.parse_args(arguments)
    try:
        settings = TrainingSettings(
            **{f.name: getattr(options, f.name) for f in dataclasses.fields(TrainingSettings)}
        )
        needs_torch()  # before the long simulation
        wanted = settings.events, settings.frames, settings.seed, options.workers
        if options.events_file is None:
            events = simulate_events(*wanted)
        else:
            events = cached_events(options.events_file, *wanted)
        network, report = train(events, settings)
    except PhasePPLError as error:
        parser.exit(2, f"{error}\n")
    options.folder.mkdir(parents=True, exist_ok=True)
    single = {name: array.astype(np.float32) for name, array in network.weights.items()}
    np.savez_compressed(options.folder / "strength_weights.npz", allow_pickle=False, **single)
    (options.folder / "strength_weights.json").write_text(json.dumps(report, indent=1) + "\n")
    for cell in report["validation"]:
        print("  ".join(f"{name} {value}" for name, value in cell.items()))


if __name__ == "__main__":
    main()
