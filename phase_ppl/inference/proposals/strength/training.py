"""Training the network of strengths.

    python -m phase_ppl.inference.proposals.strength.training FOLDER

Simulates events (or reads them from --events-file), blurs them with jitter, cuts windows of all
lengths, trains, and writes FOLDER/weights.npz and the report FOLDER/weights.json. Needs the extra
``neural`` (PyTorch).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from phase_ppl.inference.proposals.strength.estimates import StrengthEstimates, quality
from phase_ppl.inference.proposals.strength.examples import (
    VALIDATION_JITTER,
    VALIDATION_LENGTHS,
    Examples,
    training_examples,
    validation_examples,
)
from phase_ppl.inference.proposals.strength.network import (
    FARTHEST,
    HIDDEN,
    SD_RANGE,
    StrengthNetwork,
)
from phase_ppl.inference.proposals.strength.scenes import Simulated, cached_events, simulate_events
from phase_ppl.models.neural import needs_torch, threads
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError
from phase_ppl.world.hypothesis import STRENGTH_RANGE

_HALF_LOG_2PI: Final = 0.5 * np.log(2 * np.pi)

SMALLEST_SCALE: Final = 0.05
"""Features that hardly vary in the training are not blown up."""


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """How the network is made.

    Attributes:
        events: number of simulated events; a tenth of them validates.
        frames: length of each.
        rounds: how often each event is blurred and cut anew.
        epochs: passes over all examples; the best by validation counts.
        batch: examples per step.
        learning_rate: at the start; it falls to zero along a cosine.
        weight_decay: of the weights.
        dropout: share of hidden units left out in each step.
        seed: of everything random.
    """

    events: int = 1500
    frames: int = 61
    rounds: int = 6
    epochs: int = 20
    batch: int = 512
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    dropout: float = 0.2
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("events", 10), ("frames", 12), ("rounds", 1), ("epochs", 1)):
            if getattr(self, name) < least:
                raise InvalidSettingError(f"{name}={getattr(self, name)}, expected >= {least}")


def train(events: Simulated, settings: TrainingSettings) -> tuple[StrengthNetwork, dict[str, Any]]:
    """Return the trained network and the report on it."""
    torch = needs_torch()
    n_validation = len(events.strength) // 10
    used, held_out = events.part(n_validation, None), events.part(0, n_validation)
    examples = training_examples(used, settings.rounds, settings.seed)
    validation = validation_examples(held_out, settings.seed)
    centre = examples.features.mean(axis=0)
    scale = np.maximum(examples.features.std(axis=0), SMALLEST_SCALE)

    def tensors(data: Examples) -> tuple[Any, Any]:
        x = np.clip((data.features - centre) / scale, -FARTHEST, FARTHEST)
        return torch.from_numpy(x), torch.from_numpy(data.strength)

    # sums, and so the weights, depend on the number of threads
    with threads(1), torch.random.fork_rng(devices=[]):
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
            linear = [layer for layer in net if hasattr(layer, "weight")]
            kept = [
                (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
                for layer in linear
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where weights.npz and weights.json go")
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
    network.save(options.folder / "weights.npz")
    (options.folder / "weights.json").write_text(json.dumps(report, indent=1) + "\n")
    for cell in report["validation"]:
        print("  ".join(f"{name} {value}" for name, value in cell.items()))


if __name__ == "__main__":
    main()
