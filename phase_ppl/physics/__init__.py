"""The dynamics: a pymunk world, the reference, and a compiled model of it for imagination."""
