"""Whether an HDF5 file is plain enough to be read as events.

HDF5 can do more than hold arrays: point to other files, be sparse or compressed so that little
becomes very much. A file that somebody else made is checked for that before its arrays are read.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.documents import MAX_BYTES
from phase_ppl.world.errors import InvalidEventError

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
"""How every HDF5 file, and thereby every NetCDF 4 file, begins."""

_POSTERIOR: Final = "phase-ppl-posterior-"
"""How the attribute ``schema`` of a posterior's file begins."""

_BYTES_PER_CHARACTER: Final = 4


def is_hdf5(path: str | os.PathLike[str]) -> bool:
    """Whether ``path`` is a file that begins like HDF5.

    Raises:
        InvalidEventError: it is a file that cannot be read.
    """
    if not Path(path).is_file():  # a pipe could not be read a second time
        return False
    try:
        with open(path, "rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError as error:
        raise InvalidEventError(f"cannot be read: {error.strerror or error}") from None


def check_hdf5(path: str | os.PathLike[str]) -> None:
    """Raise InvalidEventError unless ``path`` is HDF5 with nothing but arrays of bounded size."""
    import h5py

    if not is_hdf5(path):
        raise InvalidEventError("is no NetCDF 4 file: it does not begin like one")
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise _too_large()
        with h5py.File(path, "r") as file:
            schema = file.attrs.get("schema")
            if isinstance(schema, str) and schema.startswith(_POSTERIOR):
                raise InvalidEventError(
                    "is a posterior, not an event; phase_ppl.Posterior.load reads it"
                )
            size = 0
            for name in file:
                size += _size(file, name, MAX_BYTES - size)
    except InvalidEventError:
        raise
    except Exception as error:  # whatever a damaged file makes the reader stumble over
        reason = " ".join(str(error).split())
        raise InvalidEventError(f"cannot be read as NetCDF: {reason}") from error


def _size(file: Any, name: str, limit: int) -> int:
    """Return how many bytes the array ``name`` takes in memory.

    Raises:
        InvalidEventError: more than ``limit``, or not an array of numbers or texts in this file.
    """
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise InvalidEventError(f"holds a link, {name!r}, expected arrays only")
    array = file[name]
    if not isinstance(array, h5py.Dataset):
        raise InvalidEventError(f"holds a group, {name!r}, expected arrays only")
    if array.is_virtual or array.external:
        raise InvalidEventError(f"array {name!r} lies in another file")
    text = h5py.check_string_dtype(array.dtype)
    if text is None and array.dtype.kind not in "biufS":
        raise InvalidEventError(f"array {name!r} holds neither numbers nor texts")
    if array.shape is None:
        raise InvalidEventError(f"array {name!r} is without a shape")
    if text is None or text.length is not None:
        if array.nbytes > limit:
            raise _too_large()
        return int(array.nbytes)
    # texts of any length become an array that is as wide as the longest
    width = _BYTES_PER_CHARACTER
    if array.size * width > limit:
        raise _too_large()
    for place in np.ndindex(array.shape):
        width = max(width, _BYTES_PER_CHARACTER * len(array[place]))
        if array.size * width > limit:
            raise _too_large()
    return int(array.size * width)


def _too_large() -> InvalidEventError:
    return InvalidEventError(f"is larger than the {MAX_BYTES // 2**20} MB that are read")
