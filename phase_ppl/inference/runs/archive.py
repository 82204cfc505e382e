"""The container of a checkpoint: a JSON document and named arrays, and nothing that can run.

A zip file of stored members: ``run.json``, and an .npy file per array, which NumPy opens as it
opens an .npz. Each member has a checksum.
"""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.files import existing_file, write_bytes

SUFFIXES: Final = (".ckpt",)

Arrays = dict[str, NDArray[Any]]

_DOCUMENT: Final = "run.json"
_ARRAY: Final = ".npy"
_LIST: Final = "arrays"
_KINDS: Final = "biuf"
_VERSION: Final = (1, 0)


def write_archive(
    path: str | os.PathLike[str], document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write a document and arrays of numbers to ``path``, whole or not at all.

    Raises:
        OutputError: the file cannot be written there, or its name does not end in .ckpt.
    """
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_STORED) as archive:
        # the list tells a file that lost some of them without a trace
        archive.writestr(_DOCUMENT, json.dumps({**document, _LIST: list(arrays)}))
        for name, values in arrays.items():
            with archive.open(name + _ARRAY, "w", force_zip64=True) as member:
                np.lib.format.write_array(
                    member, np.asarray(values, order="C"), _VERSION, allow_pickle=False
                )
    write_bytes(path, SUFFIXES, memory.getvalue())


def read_archive(path: str | os.PathLike[str]) -> tuple[dict[str, Any], Arrays]:
    """Return the document and the arrays that :func:`write_archive` wrote.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
    """
    source = existing_file(path)
    try:
        with zipfile.ZipFile(source) as archive:
            members = {info.filename: _member(archive, info) for info in archive.infolist()}
        document = json.loads(members.pop(_DOCUMENT))
        if not isinstance(document, dict):
            raise ValueError(f"{_DOCUMENT} is no object")
        arrays = {name.removesuffix(_ARRAY): _array(data) for name, data in members.items()}
        if document.pop(_LIST) != list(arrays):
            raise ValueError("it has not the arrays that were written")
    except Exception as error:  # whatever a damaged file makes the readers stumble over
        raise damaged(source, error) from None
    return document, arrays


def damaged(path: str | os.PathLike[str], error: Exception) -> InvalidEventError:
    """Return the error for a file that cannot be a checkpoint, or not a whole one."""
    reason = " ".join(str(error).split())[:200]
    if isinstance(error, KeyError):
        reason = f"it lacks {reason}"
    return InvalidEventError(
        f"{path} is no checkpoint, or a damaged one: {reason or type(error).__name__}"
    )


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    # compressed ones could be far larger than the file
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise ValueError(f"{info.filename!r} is compressed")
    return archive.read(info)


def _array(data: bytes) -> NDArray[Any]:
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != _VERSION:
        raise ValueError("an array has another version")
    shape, by_column, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.kind not in _KINDS or by_column:
        raise ValueError(f"an array of {dtype}, expected numbers, row by row")
    content = data[file.tell() :]
    if len(content) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"an array is {len(content)} bytes long, which does not fit {shape}")
    return np.frombuffer(content, dtype).reshape(shape) if content else np.empty(shape, dtype)
