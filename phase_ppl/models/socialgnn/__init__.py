"""SocialGNN, the paper's graph neural network (Appendix "SocialGNN"); it needs PyTorch.

Every frame of an event is a graph, an LSTM runs over the frames, and from its last state linear
heads answer. There are three variants:

``original``: the SocialGNN_E of Malik and Isik (2023). Nodes are the four entities, edges join
those that touch (:data:`~phase_ppl.models.socialgnn.graphs.CONTACT_FACTOR`) with no wall between;
the ends of the walls and the landmarks are context of every edge. One linear layer makes each edge
from its two nodes and the context; the LSTM reads the edges of the twelve ordered pairs side by
side, zeros where two do not touch. One head: the relation. Sizes and training are the authors'.

``extended``, the paper's: landmarks are nodes too, joined with the entities near them (44 pairs);
two more heads, one per agent, with a softmax each, say which of the 36 effective goals it has.

``message_passing``, this package's own: edges are summed into nodes, which the LSTM reads; ReLUs,
dropout, a node that is told which one it is, as colours tell people, and an ensemble of five that
see an event in each epoch in another of the 20 looks that mean the same (reflections of the arena,
and the agents' or the items' colours exchanged).

They are trained on events that this package generates (``phase-ppl train``), never on the authors'
recordings, on which they are tested. What the paper does not say, how near is near a landmark, is
this package's. So are two decisions: with landmarks as nodes the walls remain context, and L_goal
is the sum of the two agents' cross-entropies. torch_geometric is not used: the edges of all frames
of a batch are one list, so that passing messages is a gather and a sum over it.
"""
