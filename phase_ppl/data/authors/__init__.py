"""The files of PHASE's authors: pickles that are read without being loaded, and written alike."""
