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
    FEATURES,
    PROXIMITY,
    Batch,
    Graphs,
    Variant,
    batch,
    frame_graphs,
    n_context,
    n_nodes,
)
from phase_ppl.models.socialgnn.store import EDGE, HEADS, NODE, STATE, Arrays, Trained
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


class Outputs(NamedTuple):
    """What the heads say, before any softmax.

    Attributes:
        relation: (event, relation).
        goals: (event, agent, goal); None in the original variant.
    """

    relation: Any
    goals: Any


class SocialGNN(nn.Module):
    """The network.

    Args:
        variant: "extended" or "original".
        dropout: share of the LSTM's inputs and of its last state that is left out in training.
    """

    def __init__(self, variant: Variant, dropout: float = 0.0) -> None:
        super().__init__()
        self.nodes = n_nodes(variant)
        n_features = len(FEATURES) + self.nodes
        # sender, receiver, the way from one to the other, its length, the kind of edge, context
        self.edge = nn.Linear(2 * n_features + 4 + n_context(variant), EDGE)
        self.node = nn.Linear(n_features + EDGE, NODE)
        self.lstm = nn.LSTM(self.nodes * NODE, STATE, batch_first=True)
        self.heads = nn.ModuleDict(
            {name: nn.Linear(STATE, n) for name, n in HEADS[variant].items()}
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
        """Return (frame, node * NODE) the updated nodes of every frame."""
        seen = torch.from_numpy(given.nodes)
        which = torch.eye(self.nodes).expand(len(seen), -1, -1)
        nodes = torch.cat([seen, which], dim=-1).flatten(0, 1)
        frame, sender, receiver, kind = torch.from_numpy(given.edges).T
        sender, receiver = frame * self.nodes + sender, frame * self.nodes + receiver
        way = nodes[receiver, :2] - nodes[sender, :2]
        context = torch.from_numpy(given.context)[torch.from_numpy(given.event)[frame]]
        near = (kind == PROXIMITY).to(way.dtype)[:, None]
        parts = [nodes[sender], nodes[receiver], way, way.norm(dim=1, keepdim=True), near, context]
        edges = self.edge(torch.cat(parts, dim=1)).relu()
        arrived = nodes.new_zeros(len(nodes), EDGE).index_add(0, receiver, edges)
        return self.node(torch.cat([nodes, arrived], dim=1)).relu().view(len(seen), -1)


# --- what trained networks say of an event. Importing this module needs PyTorch -------------------


class Ensemble:
    """Trained networks that answer together: the mean of their probabilities.

    Args:
        trained: the networks.
        n_threads: of PyTorch.
    """

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
