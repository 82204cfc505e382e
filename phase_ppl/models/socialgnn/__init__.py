"""SocialGNN, the paper's graph neural network (Appendix "SocialGNN"); it needs PyTorch.

Every frame of an event is a graph; edges are updated from the nodes that they join, nodes from the
edges that arrive, and an LSTM runs over the frames. From its last state linear heads answer.

``original``: nodes are the four entities, edges join those that touch, and the places of landmarks
and walls are context of every edge. One head: the relation.

``extended``, the paper's: landmarks are nodes too, joined with the entities near them; two more
heads, one per agent, with a softmax each, say which of the 36 effective goals it has.

It is trained on events that this package generates (``phase-ppl train``), never on the authors'
recordings, on which it is tested.

The paper gives neither sizes nor thresholds nor the optimiser; those here are this package's, as
are the colours of nodes as features. torch_geometric is left out on purpose: the edges of all
frames of a batch are one list, so that a message is a gather and a sum over it, two lines of
PyTorch, for which it would bring a dozen packages that fetch files from the web.
"""
