"""SocialGNN, the paper's graph neural network (Appendix "SocialGNN"); it needs PyTorch.

Every frame of an event is a graph; edges are updated from the nodes that they join, nodes from the
edges that arrive, and an LSTM runs over the frames. From its last state linear heads answer.

``original``: nodes are the four entities, edges join those that touch, and the places of landmarks
and walls are context of every edge. One head: the relation.

``extended``, the paper's: landmarks are nodes too, joined with the entities near them; two more
heads, one per agent, with a softmax each, say which of the 36 effective goals it has.

It is trained on events that this package generates (``phase-ppl train``), never on the authors'
recordings, on which it is tested. In each epoch an event is seen in another of the 20 looks that
mean the same: reflections of the arena, and the agents' or the items' colours exchanged.

The paper gives neither sizes nor thresholds nor the optimiser; those here are this package's. So
are three decisions: a node is told which one it is, as colours tell people; the extended variant
keeps the walls as context of its edges, as they are no nodes; and L_goal is the sum of the two
agents' cross-entropies. torch_geometric is not used: the edges of all frames of a batch are one
list, so that passing messages is a gather and a sum over it, two lines of PyTorch, for which it
would bring a dozen packages, most of them to fetch files from the web.
"""
