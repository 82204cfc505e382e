"""SocialGNN, the paper's graph neural network (Appendix "SocialGNN"); it needs PyTorch.

Every frame of an event is a graph. An LSTM runs over the frames, and linear heads answer from its
last state. There are two variants:

``original``: the SocialGNN_E of Malik and Isik (2023). Nodes are the four entities. Edges join
entities that touch (:data:`~phase_ppl.models.socialgnn.graphs.CONTACT_FACTOR`) without a wall
between them. The ends of the walls and the landmarks are context of every edge. One linear layer
makes each edge from its two nodes and the context. The LSTM reads the edges of the twelve ordered
pairs side by side, with zeros for pairs that do not touch. One head: the relation. Sizes and
training are the authors'.

``extended``, the paper's: landmarks are nodes too, joined with the entities near them (44 pairs).
Two more heads, one per agent, have a softmax over the 36 effective goals.

Networks are trained on events that this package generates (``phase-ppl train``), and tested on the
authors' recordings, never trained on them. The paper does not say how near is near a landmark; this
package chose. It also made two decisions: with landmarks as nodes the walls remain context, and
L_goal is the sum of the two agents' cross-entropies. torch_geometric is not used: the edges of all
frames of a batch are one list.
"""
