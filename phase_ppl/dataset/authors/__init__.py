"""The files of PHASE's authors: pickles that are read without being loaded, and written alike.

Made from descriptions of those files and of the published programs that wrote and read them. No
such file was at hand: nothing here was tried on an original.
"""
