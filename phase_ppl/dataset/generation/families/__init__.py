"""The eight families of PHASE, a file each."""
