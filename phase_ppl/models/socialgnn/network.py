"""The network itself. Importing this module needs PyTorch (:mod:`phase_ppl.models.neural`)."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import nn

from phase_ppl.models.socialgnn.graphs import (
    FEATURES,
    PROXIMITY,
    Batch,
    Variant,
    n_context,
    n_nodes,
)
from phase_ppl.models.socialgnn.sizes import EDGE, HEADS, NODE, STATE


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
