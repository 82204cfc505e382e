"""The files of PHASE's authors: pickles, read without running their code, and written alike."""
