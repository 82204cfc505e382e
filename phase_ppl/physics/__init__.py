"""The dynamics: a reference implementation on pymunk, and a compiled model for imagination."""
