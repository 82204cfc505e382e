"""Predicate inverse planning: goals and relation from symbols alone, without physics.

Source: paper, Appendix "Predicate Inverse Planning". The parts, in the order of the argument:
``symbols``, from tracks to a symbolic trajectory; ``planning``, what is left to do for a goal;
``forward``, the probability of a symbolic trajectory given a goal; ``posterior``, its inversion.
"""
