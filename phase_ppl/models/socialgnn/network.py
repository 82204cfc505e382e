"""The network itself. Importing this module needs PyTorch (:mod:`phase_ppl.models.neural`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from phase_ppl.models.neural import threads
from phase_ppl.models.socialgnn.graphs import (
    PROXIMITY,
    Batch,
    Graphs,
    Variant,
    batch,
    edge_slots,
    frame_graphs,
    n_nodes,
)
from phase_ppl.models.socialgnn.store import HEADS, Arrays, Trained, shapes
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


class Outputs(NamedTuple):
    """What the heads say, before any softmax."""

    relation: Any  # (event, relation)
    goals: Any  # (event, agent, goal); None in the original variant


class SocialGNN(nn.Module):
    """A network of any variant, with that dropout of the LSTM's inputs and of its last state."""

    def __init__(self, variant: Variant, dropout: float = 0.0) -> None:
        super().__init__()
        made = shapes(variant)
        self.nodes = n_nodes(variant)
        self.register_buffer("slots", torch.from_numpy(edge_slots(variant)), persistent=False)
        self.edge = _linear(made["edge.weight"])
        self.node = _linear(made["node.weight"]) if "node.weight" in made else None
        units, wide = made["lstm.weight_ih_l0"]
        self.lstm = nn.LSTM(wide, units // 4, batch_first=True)
        self.heads = nn.ModuleDict(
            {name: nn.Linear(units // 4, n) for name, n in HEADS[variant].items()}
        )
        self.dropout = nn.Dropout(dropout)

    def forward(self, given: Batch) -> Outputs:
        """Return what the heads say of the events of a batch."""
        frames = self.dropout(self._frames(given))
        lengths = torch.from_numpy(given.lengths)
        padded = nn.utils.rnn.pad_sequence(frames.split(given.lengths.tolist()), batch_first=True)
        states, _ = self.lstm(padded)
        last = self.dropout(states[torch.arange(len(lengths)), lengths - 1])
        said = {name: head(last) for name, head in self.heads.items()}
        goals = [said[name] for name in said if name != "relation"]
        return Outputs(said["relation"], torch.stack(goals, dim=1) if goals else None)

    def _frames(self, given: Batch) -> Any:
        """Return (frame, number) what the LSTM reads of every frame."""
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


def _linear(shape: tuple[int, ...]) -> nn.Linear:
    return nn.Linear(shape[1], shape[0])


# --- what trained networks say of an event. Importing this module needs PyTorch -------------------


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
        with threads(self._threads), torch.no_grad():
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
