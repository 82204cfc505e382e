"""HDF5 files, the form of NetCDF 4: written in memory, and read only if they are plain.

HDF5 can do more than hold arrays. A file can point to other files, or be so sparse or compressed
that little becomes very much. Files are checked for that before their arrays are read. The library
ends the process if a disk is full, so that it never writes to one itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np

from phase_ppl.data.documents import MAX_BYTES, reading_bytes, too_large
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown

if TYPE_CHECKING:
    import h5py
    import xarray as xr

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
"""The first bytes of every HDF5 file, and so of every NetCDF 4 file."""

_BYTES_PER_CHARACTER: Final = 4
_ENTRIES_OF_ATTRIBUTE: Final = 32
_ROOT: Final = "/"
_SEAL: Final = "sha256"
_FILL: Final = "_FillValue"
_NUMBERS: Final = "biuf"
_ATTRIBUTES: Final = (str, int, float, np.generic, np.ndarray, list, tuple)

_CONTROL: Final = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f]|(?P<escaped>\\u00(?:[01][0-9a-f]|7f|[89][0-9a-f]))", re.I
)
"""Characters that control a terminal, plain and as JSON spells them."""

Groups = dict[str, "xr.Dataset"]  # path of a group, "/" for the root -> its content


# --- writing ---------------------------------------------------------------------------------


def netcdf_bytes(
    groups: Mapping[str, xr.Dataset], how: Mapping[str, Any], *, sealed: bool = False
) -> bytes:
    """Return groups, path ("/" the root) -> content, as the content of a NetCDF 4 file.

    ``how`` is the encoding of numeric arrays, in xarray's terms; empty arrays get no filters or
    checksums. If ``sealed``, the root gets a checksum of everything, which :func:`read_netcdf`
    compares.

    Raises:
        InvalidSettingError: an attribute, such as a user's own, is of a kind that NetCDF does not
            have.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    for path, dataset in groups.items():
        _check_attributes(f"group {path!r}", dataset.attrs)
        for name, variable in dataset.variables.items():
            _check_attributes(f"{str(name)!r} in group {path!r}", variable.attrs)
    if sealed:
        groups = {**groups, _ROOT: groups[_ROOT].assign_attrs({_SEAL: _checksum(groups)})}
    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        for path, dataset in groups.items():
            store = H5NetCDFStore(file, group=None if path == _ROOT else path, mode="a")
            encoding = {
                str(name): {
                    option: value
                    for option, value in how.items()
                    if option == _FILL or (variable.ndim and variable.size)
                }
                for name, variable in dataset.variables.items()
                if variable.dtype.kind in _NUMBERS
            }
            dataset.dump_to_store(store, encoding=encoding)
    return memory.getvalue()


def _check_attributes(where: str, attrs: Mapping[Any, Any]) -> None:
    for name, value in attrs.items():
        kind = np.asarray(value).dtype.kind if isinstance(value, _ATTRIBUTES) else "O"
        if not isinstance(name, str) or kind not in "iufU":
            raise InvalidSettingError(
                f"attribute {name!r} of {where} is {shown(value)}: NetCDF has texts, numbers and "
                "lists of either; delete it, or write it as a text, such as json.dumps gives"
            )


def with_event_id(content: bytes, event_id: str) -> bytes:
    """Return the content of a posterior's file with the id of its event."""
    groups = read_netcdf(io.BytesIO(content))
    groups[_ROOT].attrs["event_id"] = event_id
    return netcdf_bytes(groups, {"fletcher32": True}, sealed=True)


def _checksum(groups: Mapping[str, xr.Dataset]) -> str:
    """Return a hash of all groups; it is the same before and after they were in a file."""
    digest = hashlib.sha256()

    def add(*said: object) -> None:
        digest.update(repr(said).encode(errors="surrogatepass"))

    for path, dataset in sorted(groups.items()):
        for name, value in sorted(dataset.attrs.items()):
            if name != _SEAL:
                add(path, str(name), np.asarray(value).tolist())
        for key, variable in sorted(dataset.variables.items(), key=lambda item: str(item[0])):
            values = variable.values
            add(path, str(key), variable.dims, values.shape, sorted(variable.attrs))
            if values.dtype.kind in _NUMBERS:
                digest.update(values.dtype.str.encode() + np.ascontiguousarray(values).tobytes())
            else:
                add(np.asarray(values, object).tolist())
    return digest.hexdigest()


# --- reading ---------------------------------------------------------------------------------


UNLOCKED: Final = {"locking": False}
"""How HDF5 files are opened: without locks, which not every drive has. None are needed, since a
file appears complete and never changes."""


def opened(source: str | os.PathLike[str] | BinaryIO) -> h5py.File:
    """Open an HDF5 file for reading."""
    import h5py

    return h5py.File(source, "r", **UNLOCKED)


def content_of(source: str | os.PathLike[str] | BinaryIO) -> Groups:
    """Return the groups of a NetCDF 4 file, in memory."""
    import h5py
    import xarray as xr

    # times stay plain numbers: xarray must not make "seconds" a time type
    how: dict[str, Any] = {"decode_times": False, "driver_kwds": UNLOCKED}
    with opened(source) as file:
        inner = [f"/{name}" for name, one in file.items() if isinstance(one, h5py.Group)]
    found: Groups = {}
    for path in (_ROOT, *inner):
        with xr.open_dataset(source, engine="h5netcdf", group=path, **how) as dataset:
            found[path] = dataset.load().drop_encoding()
    return found


def read_netcdf(path: str | os.PathLike[str] | BinaryIO) -> Groups:
    """Return the groups of a NetCDF 4 file, in memory, if it is safe to read.

    Characters of attributes that control a terminal are replaced.
    """
    with reading():
        _check_plain(path)
        found = content_of(path)
    seal = found[_ROOT].attrs.get(_SEAL)
    if seal is not None and seal != _checksum(found):
        raise InvalidEventError(
            f"its content is not what {_SEAL} says: damaged, or edited; an edited file is read "
            f"without the attribute {_SEAL}"
        )
    found[_ROOT].attrs.pop(_SEAL, None)
    for dataset in found.values():
        dataset.attrs = {name: _plain(value) for name, value in dataset.attrs.items()}
    return found


@contextlib.contextmanager
def reading() -> Iterator[None]:
    """Turn any error that a damaged file causes in the reader into one line."""
    try:
        yield
    except InvalidEventError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())
        raise InvalidEventError(f"cannot be read as NetCDF: {reason}") from error


def _check_plain(source: str | os.PathLike[str] | BinaryIO) -> None:
    """Raise InvalidEventError unless a file is HDF5 with nothing but groups of bounded arrays.

    A large one is read if it takes at most twice as much memory as on the disk.
    """
    if isinstance(source, str | os.PathLike):
        with reading_bytes("a file"), open(source, "rb") as begun:
            if begun.read(len(SIGNATURE)) != SIGNATURE:
                raise InvalidEventError("is no NetCDF 4 file: it does not begin like one")
        n_bytes = Path(source).stat().st_size
    else:
        n_bytes = source.seek(0, os.SEEK_END)
    left: float = max(MAX_BYTES, 2 * n_bytes)
    with opened(source) as file:
        for size in _sizes(file, n_bytes):
            left -= size
            if left < 0:
                raise too_large(MAX_BYTES)


def _sizes(group: Any, n_bytes: int, inner: bool = True) -> Iterator[float]:
    """Yield the memory of each part of a group in a file of ``n_bytes`` bytes.

    ``inner``: it may hold further groups. InvalidEventError: it is not plain.
    """
    import h5py

    yield from _sizes_of_attributes(group, n_bytes)
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise InvalidEventError(f"holds a link, {name!r}, expected arrays only")
        member = group[name]
        if inner and isinstance(member, h5py.Group):
            yield from _sizes(member, n_bytes, False)
        elif isinstance(member, h5py.Dataset):
            yield from _sizes_of_attributes(member, n_bytes)
            yield from _sizes_of_array(member, name, n_bytes)
        else:
            raise InvalidEventError(f"holds a group, {name!r}, expected arrays only")


def _sizes_of_attributes(thing: Any, n_bytes: int) -> Iterator[float]:
    for name in thing.attrs:
        attribute = thing.attrs.get_id(name)
        size = np.prod(attribute.shape or (), dtype=float)
        # all texts may be the same one, which the file has once
        if attribute.dtype.kind == "O" and size > _ENTRIES_OF_ATTRIBUTE:
            raise InvalidEventError(f"attribute {name!r} has {size:g} entries")
        yield min(size * attribute.dtype.itemsize, n_bytes)


def _sizes_of_array(array: Any, name: str, n_bytes: int) -> Iterator[float]:
    import h5py

    text = h5py.check_string_dtype(array.dtype)
    for is_so, what in (
        (array.is_virtual or array.external, "lies in another file"),
        (
            text is None and array.dtype.kind not in _NUMBERS + "S",
            "holds neither numbers nor texts",
        ),
        (array.shape is None, "is without a shape"),
    ):
        if is_so:
            raise InvalidEventError(f"array {name!r} {what}")
    if text is None or text.length is not None:
        # a compressed array is read a chunk at a time, which may be larger than the array
        chunk = np.prod(array.chunks or (0,), dtype=float) * array.dtype.itemsize
        yield max(array.nbytes, chunk)
        return
    # texts of any length become an array that is as wide as the longest
    yield array.size * _BYTES_PER_CHARACTER
    if array.size > n_bytes:
        raise InvalidEventError(f"array {name!r} has more entries than the file has bytes")
    longest, at_once = 1, max(1, MAX_BYTES // n_bytes)  # few enough to fit even if all are huge
    for row in np.ndindex(array.shape[:-1]):
        for start in range(0, array.shape[-1] if array.ndim else 1, at_once):
            place = (*row, slice(start, start + at_once)) if array.ndim else ()
            found = max(longest, *map(len, np.ravel(array[place]).tolist()))
            yield array.size * _BYTES_PER_CHARACTER * (found - longest)
            longest = found


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return _CONTROL.sub(lambda found: "\\ufffd" if found["escaped"] else "\ufffd", value)
    return value.item() if hasattr(value, "item") and np.ndim(value) == 0 else value
