"""Settings of training, and files of trained networks: plain arrays in half precision, no code.

A file such as ``original.npz`` is named by its variant. It holds one or more *members*: networks of
that variant trained from different seeds. Their arrays are called ``MEMBER/NAME``, with MEMBER
0, 1, ... ``report.json`` in it records the training; older files have it beside them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import os
import textwrap
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.models.socialgnn.graphs import (
    N_FEATURES,
    VARIANTS,
    Variant,
    edge_slots,
    n_context,
)
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    number_or_nan,
    shown,
    whole_number,
)
from phase_ppl.world.files import atomic_output
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATIONS

EDGE, STATE = 64, 16
"""Units of an edge and of the LSTM's state, those of the authors."""

HEADS: Final[Mapping[str, Mapping[str, int]]] = {
    "extended": {"relation": len(RELATIONS), "goal_red": N_GOALS, "goal_green": N_GOALS},
    "original": {"relation": len(RELATIONS)},
}
"""Variant -> head -> its answers."""


def shapes(variant: Variant) -> dict[str, tuple[int, ...]]:
    """Return the arrays of a trained network, as PyTorch calls them, with their shapes."""
    layers = {"edge": (EDGE, 2 * N_FEATURES + n_context(variant))}
    wide = (int(edge_slots(variant).max()) + 1) * EDGE
    layers |= {f"heads.{name}": (n, STATE) for name, n in HEADS[variant].items()}
    found: dict[str, tuple[int, ...]] = {}
    for name, shape in layers.items():
        found |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
    return found | {
        "lstm.weight_ih_l0": (4 * STATE, wide),
        "lstm.weight_hh_l0": (4 * STATE, STATE),
        "lstm.bias_ih_l0": (4 * STATE,),
        "lstm.bias_hh_l0": (4 * STATE,),
    }


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """How one network is trained; by default as SocialGNN's authors did.

    Raises:
        InvalidSettingError, UnknownNameError: a value that is not allowed.
    """

    variant: Variant = "extended"  # or "original", which has the relation only
    epochs: int = 100  # passes over the training events
    batch: int = 20  # events per step
    learning_rate: float = 1e-3  # of Adam
    # weight of the squared norm of all weights in the loss; the authors' lambda is of half the norm
    decay: float = 0.05 / 2
    threads: int = 1  # of PyTorch; the result depends on it

    def __post_init__(self) -> None:
        check_name("variant", self.variant, VARIANTS)
        for name in ("epochs", "batch", "threads"):
            whole_number(name, getattr(self, name))
        for name, low in (("learning_rate", 1e-7), ("decay", 0.0)):
            value = getattr(self, name)
            if not low <= number_or_nan(value) <= 1:
                raise InvalidSettingError(
                    f"{name}={shown(value)}, expected a number from {low:g} to 1"
                )


def needs_torch() -> Any:
    """Return PyTorch, which is an extra."""
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        needed = "training needs PyTorch: pip install 'phase_ppl[neural]'"
        raise InvalidSettingError(needed) from error


@contextlib.contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Context in which PyTorch uses ``number`` threads; results depend on the number."""
    torch = needs_torch()
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


# --- files ----------------------------------------------------------------------------------------

Arrays = Mapping[str, NDArray[np.float16]]

_WEIGHTS: Final = resources.files("phase_ppl.models.socialgnn") / "weights"
REPORT: Final = "report.json"
_LARGEST: Final = 64 * 2**20  # bytes that weights unpack to; the package's are under one megabyte


class Trained(NamedTuple):
    """Trained networks of one variant: their arrays by name, per member."""

    variant: Variant
    members: tuple[Arrays, ...]

    def digest(self) -> str:
        """Return a hash of the variant and of all numbers."""
        found = hashlib.sha256(self.variant.encode())
        for member in self.members:
            for name in sorted(member):
                found.update(np.ascontiguousarray(member[name]).tobytes())
        return found.hexdigest()[:16]


def halved(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.float16]]:
    """Return arrays in half precision, in which they are stored and used.

    Raises:
        InvalidSettingError: a number is not finite, or too large.
    """
    with np.errstate(over="ignore"):
        found = {name: array.astype(np.float16) for name, array in arrays.items()}
    for name, array in found.items():
        if not np.isfinite(array).all():
            raise InvalidSettingError(f"{name} holds something else than finite numbers")
    return found


def save(members: Sequence[Arrays], file: str | Path, report: bytes = b"") -> None:
    """Write members to an npz file, with the JSON of a report where there is one."""
    arrays = {f"{n}/{name}": array for n, one in enumerate(members) for name, array in one.items()}
    with atomic_output(file, (".npz",)) as part:
        np.savez_compressed(part, allow_pickle=False, **arrays)
        if report:
            with zipfile.ZipFile(part, "a", zipfile.ZIP_DEFLATED) as packed:
                packed.writestr(REPORT, report)


def load(path: str | os.PathLike[str]) -> Trained:
    """Return the networks of an npz file, or of the folder that training wrote.

    Raises:
        InvalidSettingError: there is no such file, or it holds no weights of a SocialGNN.
    """
    if not isinstance(path, str | os.PathLike):
        raise InvalidSettingError(f"weights={shown(path)}, expected the name of a file or folder")
    source = Path(path)
    if source.is_dir():
        known = [source / f"{variant}.npz" for variant in VARIANTS]
        there = [file for file in known if file.is_file()]
        if len(there) != 1:
            names = ", ".join(file.name for file in there or known)
            why = f"holds several, {names}: name one" if there else f"holds none of {names}"
            raise InvalidSettingError(f"{source} {why}")
        source = there[0]
    try:
        with zipfile.ZipFile(source) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > _LARGEST:
                raise ValueError(f"it unpacks to more than {_LARGEST} bytes")
        with open(source, "rb") as file, np.load(file, allow_pickle=False) as kept:
            return _checked({name: kept[name] for name in kept.files if name != REPORT})
    except Exception as error:  # NumPy raises a dozen kinds of errors for bad files
        reason = str(getattr(error, "strerror", None) or error)
        words = textwrap.shorten(reason, 200, placeholder="...")  # NumPy shows what it cannot read
        raise InvalidSettingError(f"{source} holds no weights of a SocialGNN: {words}") from None


def shipped(variant: str) -> Trained:
    """Return the package's own networks; UnknownNameError: there is no such variant."""
    check_name("variant", variant, VARIANTS)
    with resources.as_file(_WEIGHTS / f"{variant}.npz") as file:
        return load(file)


def _checked(arrays: Mapping[str, NDArray[Any]]) -> Trained:
    layers = {key.partition("/")[2] for key in arrays}
    variant: Variant = "extended" if "heads.goal_red.weight" in layers else "original"
    numbers = {key.partition("/")[0] for key in arrays}
    if numbers != set(map(str, range(max(1, len(numbers))))):
        raise ValueError(
            f"expected members 0, 1, ..., found {', '.join(sorted(numbers)) or 'none'}"
        )
    wanted = {f"{n}/{name}": s for n in sorted(numbers) for name, s in shapes(variant).items()}
    for key in sorted(arrays.keys() | wanted.keys()):
        found = arrays[key].shape if key in arrays else None
        if found != wanted.get(key):
            raise ValueError(f"{key} has shape {found}, expected {wanted.get(key)}")
        if arrays[key].dtype != np.float16 or not np.isfinite(arrays[key]).all():
            raise ValueError(f"{key} holds something else than finite numbers in half precision")
    return Trained(
        variant,
        tuple({name: arrays[f"{n}/{name}"] for name in layers} for n in range(len(numbers))),
    )
