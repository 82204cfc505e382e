"""The network and its training. Importing this module needs PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from phase_ppl.models.socialgnn.graphs import (
    Batch,
    Example,
    Graphs,
    Variant,
    batch,
    edge_slots,
    frame_graphs,
)
from phase_ppl.models.socialgnn.store import (
    HEADS,
    Arrays,
    Trained,
    TrainingSettings,
    halved,
    shapes,
    torch_threads,
)
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation
from phase_ppl.world.scene import Scene


class Outputs(NamedTuple):
    """The heads' outputs before the softmax."""

    relation: Any  # (event, relation)
    goals: Any  # (event, agent, goal); None in the original variant


class SocialGNN(nn.Module):
    """A network of either variant."""

    def __init__(self, variant: Variant) -> None:
        super().__init__()
        made = shapes(variant)
        self.register_buffer("slots", torch.from_numpy(edge_slots(variant)), persistent=False)
        self.edge = nn.Linear(*made["edge.weight"][::-1])
        units, wide = made["lstm.weight_ih_l0"]
        self.lstm = nn.LSTM(wide, units // 4, batch_first=True)
        self.heads = nn.ModuleDict(
            {name: nn.Linear(units // 4, n) for name, n in HEADS[variant].items()}
        )

    def forward(self, given: Batch) -> Outputs:
        """Return the heads' outputs for the events of a batch."""
        frames = self._frames(given)
        lengths = torch.from_numpy(given.lengths)
        padded = nn.utils.rnn.pad_sequence(frames.split(given.lengths.tolist()), batch_first=True)
        states, _ = self.lstm(padded)
        last = states[torch.arange(len(lengths)), lengths - 1]
        said = {name: head(last) for name, head in self.heads.items()}
        goals = [said[name] for name in said if name != "relation"]
        return Outputs(said["relation"], torch.stack(goals, dim=1) if goals else None)

    def _frames(self, given: Batch) -> Any:
        """Return (frame, number) the LSTM's input of every frame."""
        nodes = torch.from_numpy(given.nodes)
        frame, sender, receiver = torch.from_numpy(given.edges).T
        context = torch.from_numpy(given.context)[torch.from_numpy(given.event)[frame]]
        parts = [nodes[frame, sender], nodes[frame, receiver], context]
        edges = self.edge(torch.cat(parts, dim=1))
        n = int(self.slots.max()) + 1
        place = frame * n + self.slots[sender, receiver]
        empty = edges.new_zeros(len(nodes) * n, edges.shape[1])
        return empty.index_copy(0, place, edges).view(len(nodes), -1)


# --- predictions of trained networks --------------------------------------------------------------


class Ensemble:
    """Trained networks that answer together: the mean of their probabilities."""

    def __init__(self, trained: Trained, n_threads: int = 1) -> None:
        self._variant: Variant = trained.variant
        self._threads = n_threads
        self._networks = [_network(arrays, trained.variant) for arrays in trained.members]

    def __call__(self, scene: Scene, observation: Observation) -> dict[str, NDArray[np.float64]]:
        """Return the probabilities of the answers of each head, by its name."""
        return self.of(frame_graphs(scene, observation, self._variant))

    def of(self, graphs: Graphs) -> dict[str, NDArray[np.float64]]:
        """Return the same for the graphs of an event's frames."""
        given = batch([graphs])
        with torch_threads(self._threads), torch.no_grad():
            said = [network(given) for network in self._networks]
            found = {"relation": _mean([one.relation[0] for one in said])}
            if said[0].goals is not None:
                for agent, name in enumerate(("goal_red", "goal_green")):
                    found[name] = _mean([one.goals[0, agent] for one in said])
        return found


def _mean(scores: Sequence[torch.Tensor]) -> NDArray[np.float64]:
    shares = torch.stack([one.double().softmax(dim=-1) for one in scores]).mean(dim=0)
    return np.asarray(shares.numpy(), np.float64)


def _network(arrays: Arrays, variant: Variant) -> SocialGNN:
    with torch.random.fork_rng(devices=[]):
        network = SocialGNN(variant)
    network.load_state_dict(
        {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    )
    return network.eval()


Curves = dict[str, list[float]]

NEUTRAL_TWICE: Final = (1.0, 2.0, 1.0)
"""Weights of the relations in the authors' loss. A batch's loss is the weighted mean: in batches of
one event they have no effect."""


class Fitted(NamedTuple):
    """A trained network."""

    arrays: dict[str, NDArray[np.float16]]  # by name, in half precision
    # per epoch "training" and "validation" loss without decay, and the share of the validation
    # events with the right answer: "relation", and "goals" where it names them
    curves: Curves


def fit(
    training: Sequence[Example],
    validation: Sequence[Example],
    settings: TrainingSettings,
    seed: int,
    after_epoch: Callable[[], object] = lambda: None,
) -> Fitted:
    """Return the network trained from a seed.

    The seed decides the first weights and the order of events. ``after_epoch`` is called after each
    epoch.

    Raises:
        InvalidSettingError: the loss is no number any more.
    """
    with torch_threads(settings.threads), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        rng, network = np.random.default_rng(seed), SocialGNN(settings.variant)
        optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        curves: Curves = {name: [] for name in ("training", "validation", "relation", "goals")}
        for epoch in range(settings.epochs):
            mean = _epoch(network, training, settings, optimizer, rng)
            if not np.isfinite(mean):
                raise InvalidSettingError(
                    f"the loss is no number any more after {epoch + 1} epochs with "
                    f"learning_rate={settings.learning_rate:g}; try a smaller one"
                )
            for name, value in {"training": mean, **_scores(network, validation)}.items():
                curves[name].append(value)
            after_epoch()
        arrays = halved({name: values.numpy() for name, values in network.state_dict().items()})
        return Fitted(arrays, {name: values for name, values in curves.items() if values})


def _epoch(
    network: SocialGNN, training: Sequence[Example], settings: TrainingSettings,
    optimizer: torch.optim.Optimizer, rng: np.random.Generator,
) -> float:  # fmt: skip
    """Take all training events once; return the mean loss."""
    n = len(training)
    order, total = rng.permutation(n), 0.0
    network.train()
    for start in range(0, n, settings.batch):
        chosen = order[start : start + settings.batch]
        examples = [training[event] for event in chosen]
        found = loss(network(batch([example.graphs for example in examples])), examples)
        squared_norm = sum((values**2).sum() for values in network.parameters())
        optimizer.zero_grad()
        (found + settings.decay * squared_norm).backward()
        optimizer.step()
        total += found.item() * len(chosen)
    return total / n


def _scores(network: SocialGNN, held_out: Sequence[Example]) -> dict[str, float]:
    network.eval()
    with torch.no_grad():
        said = network(batch([example.graphs for example in held_out]))
        found = {"validation": loss(said, held_out).item()}
    relations, goals = _truth(held_out)
    found["relation"] = (said.relation.argmax(dim=-1) == relations).double().mean().item()
    if said.goals is not None:
        found["goals"] = (said.goals.argmax(dim=-1) == goals).double().mean().item()
    return found


def loss(said: Outputs, examples: Sequence[Example]) -> Any:
    """Return L_relation + L_goal, the latter the sum of the two agents' (paper, appendix)."""
    relations, goals = _truth(examples)
    found = functional.cross_entropy(said.relation, relations, torch.tensor(NEUTRAL_TWICE))
    if said.goals is not None:
        for agent in range(goals.shape[1]):
            found = found + functional.cross_entropy(said.goals[:, agent], goals[:, agent])
    return found


def _truth(examples: Sequence[Example]) -> tuple[Any, Any]:
    """Return (event,) relations and (event, agent) goals."""
    relations = torch.tensor([example.relation for example in examples])
    return relations, torch.tensor([example.goals for example in examples])
