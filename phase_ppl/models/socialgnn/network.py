"""The network and its training. Importing this module needs PyTorch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from phase_ppl.models.socialgnn.graphs import (
    AS_IT_IS,
    LOOKS,
    PROXIMITY,
    Batch,
    Example,
    Examples,
    Graphs,
    Variant,
    batch,
    edge_slots,
    frame_graphs,
    n_nodes,
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
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.scene import Scene


class Outputs(NamedTuple):
    """The heads' outputs before the softmax."""

    relation: Any  # (event, relation)
    goals: Any  # (event, agent, goal); None in the original variant


class SocialGNN(nn.Module):
    """A network of any variant, with dropout on the LSTM's inputs and on its last state."""

    def __init__(self, variant: Variant, dropout: float = 0.0) -> None:
        super().__init__()
        made = shapes(variant)
        self.nodes = n_nodes(variant)
        self.register_buffer("slots", torch.from_numpy(edge_slots(variant)), persistent=False)
        self.edge = nn.Linear(*made["edge.weight"][::-1])
        self.node = nn.Linear(*made["node.weight"][::-1]) if "node.weight" in made else None
        units, wide = made["lstm.weight_ih_l0"]
        self.lstm = nn.LSTM(wide, units // 4, batch_first=True)
        self.heads = nn.ModuleDict(
            {name: nn.Linear(units // 4, n) for name, n in HEADS[variant].items()}
        )
        self.dropout = nn.Dropout(dropout)

    def forward(self, given: Batch) -> Outputs:
        """Return the heads' outputs for the events of a batch."""
        frames = self.dropout(self._frames(given))
        lengths = torch.from_numpy(given.lengths)
        padded = nn.utils.rnn.pad_sequence(frames.split(given.lengths.tolist()), batch_first=True)
        states, _ = self.lstm(padded)
        last = self.dropout(states[torch.arange(len(lengths)), lengths - 1])
        said = {name: head(last) for name, head in self.heads.items()}
        goals = [said[name] for name in said if name != "relation"]
        return Outputs(said["relation"], torch.stack(goals, dim=1) if goals else None)

    def _frames(self, given: Batch) -> Any:
        """Return (frame, number) the LSTM's input of every frame."""
        nodes = torch.from_numpy(given.nodes)
        frame, sender, receiver, kind = torch.from_numpy(given.edges).T
        context = torch.from_numpy(given.context)[torch.from_numpy(given.event)[frame]]
        if self.node is None:
            parts = [nodes[frame, sender], nodes[frame, receiver], context]
            edges = self.edge(torch.cat(parts, dim=1))
            n = int(self.slots.max()) + 1
            place = frame * n + self.slots[sender, receiver]
            empty = edges.new_zeros(len(nodes) * n, edges.shape[1])
            return empty.index_copy(0, place, edges).view(len(nodes), -1)
        which = torch.eye(self.nodes).expand(len(nodes), -1, -1)
        flat = torch.cat([nodes, which], dim=-1).flatten(0, 1)
        sender, receiver = frame * self.nodes + sender, frame * self.nodes + receiver
        way = flat[receiver, :2] - flat[sender, :2]
        near = (kind == PROXIMITY).to(way.dtype)[:, None]
        parts = [flat[sender], flat[receiver], way, way.norm(dim=1, keepdim=True), near, context]
        edges = self.edge(torch.cat(parts, dim=1)).relu()
        arrived = flat.new_zeros(len(flat), edges.shape[1]).index_add(0, receiver, edges)
        return self.node(torch.cat([flat, arrived], dim=1)).relu().view(len(nodes), -1)


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

_SLOWER: Final = 0.5
_LONGEST_STEP: Final = 1.0
"""Norm to which gradients are cut: an LSTM over a hundred frames can make them jump."""

NEUTRAL_TWICE: Final = (1.0, 2.0, 1.0)  # weights of the relations in the authors' loss


class Fitted(NamedTuple):
    """A trained network."""

    arrays: dict[str, NDArray[np.float16]]  # by name, in half precision
    # per epoch "training" and "validation" loss without decay, and the share of the validation
    # events with the right answer: "relation", and "goals" where it names them
    curves: Curves
    best: int  # epoch, from 0, that the arrays are of


def fit(
    training: Examples,
    validation: Examples,
    settings: TrainingSettings,
    seed: int,
    after_epoch: Callable[[], object] = lambda: None,
) -> Fitted:
    """Return the network trained from a seed.

    The seed decides the first weights, the order and looks of events, and the dropout.
    ``after_epoch`` is called after each epoch.

    Raises:
        InvalidSettingError: the loss is no number any more.
    """
    with torch_threads(settings.threads), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        rng, network = np.random.default_rng(seed), SocialGNN(settings.variant, settings.dropout)
        optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        schedule = torch.optim.lr_scheduler.ReduceLROnPlateau(
            optimizer, factor=_SLOWER, patience=max(1, settings.patience // 3)
        )
        weights = torch.tensor(NEUTRAL_TWICE)
        if settings.balanced:
            weights = class_weights(training.relations)
        held_out = [validation(event) for event in range(len(validation))]
        curves: Curves = {name: [] for name in ("training", "validation", "relation", "goals")}
        best, kept = 0, network.state_dict()
        for epoch in range(settings.epochs):
            mean = _epoch(network, training, settings, optimizer, weights, rng)
            if not np.isfinite(mean):
                raise InvalidSettingError(
                    f"the loss is no number any more after {epoch + 1} epochs with "
                    f"learning_rate={settings.learning_rate:g}; try a smaller one"
                )
            for name, value in {"training": mean, **_scores(network, held_out, weights)}.items():
                curves[name].append(value)
            now = curves["validation"][-1]
            if settings.patience:
                schedule.step(now)
            if epoch == 0 or not settings.patience or now < curves["validation"][best]:
                best, kept = epoch, copy.deepcopy(network.state_dict())
            after_epoch()
            if settings.patience and epoch - best >= settings.patience:
                break
        arrays = halved({name: values.numpy() for name, values in kept.items()})
        return Fitted(arrays, {name: values for name, values in curves.items() if values}, best)


def _epoch(
    network: SocialGNN, training: Examples, settings: TrainingSettings,
    optimizer: torch.optim.Optimizer, weights: Any, rng: np.random.Generator,
) -> float:  # fmt: skip
    """Take all training events once; return the mean loss."""
    n = len(training)
    looks = rng.integers(len(LOOKS), size=n) if settings.looks else [AS_IT_IS] * n
    order, total = rng.permutation(n), 0.0
    network.train()
    for start in range(0, n, settings.batch):
        chosen = order[start : start + settings.batch]
        examples = [training(int(event), int(looks[event])) for event in chosen]
        found = loss(network(batch([example.graphs for example in examples])), examples, weights)
        squared_norm = sum((values**2).sum() for values in network.parameters())
        optimizer.zero_grad()
        (found + settings.decay * squared_norm).backward()
        if settings.patience:
            torch.nn.utils.clip_grad_norm_(network.parameters(), _LONGEST_STEP)
        optimizer.step()
        total += found.item() * len(chosen)
    return total / n


def _scores(network: SocialGNN, held_out: Sequence[Example], weights: Any) -> dict[str, float]:
    network.eval()
    with torch.no_grad():
        said = network(batch([example.graphs for example in held_out]))
        found = {"validation": loss(said, held_out, weights).item()}
    relations, goals = _truth(held_out)
    found["relation"] = (said.relation.argmax(dim=-1) == relations).double().mean().item()
    if said.goals is not None:
        found["goals"] = (said.goals.argmax(dim=-1) == goals).double().mean().item()
    return found


def class_weights(relations: Sequence[int]) -> Any:
    """Return (relation,) weights in inverse proportion to each relation's frequency.

    Their mean over events is 1; a relation that never occurs has weight 1.
    """
    counts = np.bincount(relations, minlength=len(RELATIONS))
    there = counts > 0
    weights = np.where(there, len(relations) / (there.sum() * np.maximum(counts, 1)), 1.0)
    return torch.from_numpy(weights.astype(np.float32))


def loss(said: Outputs, examples: Sequence[Example], weights: Any = None) -> Any:
    """Return L_relation + L_goal, the latter the sum of the two agents' (paper, appendix)."""
    relations, goals = _truth(examples)
    found = functional.cross_entropy(said.relation, relations, weights)
    if said.goals is not None:
        for agent in range(goals.shape[1]):
            found = found + functional.cross_entropy(said.goals[:, agent], goals[:, agent])
    return found


def _truth(examples: Sequence[Example]) -> tuple[Any, Any]:
    """Return (event,) relations and (event, agent) goals."""
    relations = torch.tensor([example.relation for example in examples])
    return relations, torch.tensor([example.goals for example in examples])
