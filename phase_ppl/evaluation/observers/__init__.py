"""Observers fitted to people: evidence from models, answers from studies, and what follows."""
