"""Named tuples of arrays that kernels pass by address.

numba takes a tuple apart at each call: every array becomes seven or more arguments. A world's
parameters and work space become some two hundred, which takes time to compile and to run. A record
stays where the Python caller has put it, and kernels read its fields there.
"""

from __future__ import annotations

import functools
import hashlib
from typing import Any, TypeVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel.models import PrimitiveModel
from numba.core.datamodel.registry import register_default
from numba.core.imputils import lower_getattr_generic
from numba.core.pythonapi import NativeValue, unbox
from numba.core.typing.typeof import typeof_impl

from phase_ppl.physics.jit import KNOWN_NUMBA

Class = TypeVar("Class", bound=type[tuple[Any, ...]])

_ADDRESS = ir.IntType(8).as_pointer()
_INDEX = ir.IntType(64)


class Record(types.NamedTuple):
    """The type of a record, by the types of its fields."""

    def __init__(self, fields: tuple[Any, ...], cls: Any) -> None:
        super().__init__(fields, cls)
        # this name is part of the names of all functions that take one
        digest = hashlib.sha256(self.name.encode()).hexdigest()[:12]
        self.name = f"{cls.__name__}_{digest}"

    @property
    def key(self) -> Any:
        """The key that distinguishes it from other types."""
        return self.name

    @property
    def mangling_args(self) -> tuple[str, tuple[()]]:
        """Its part in the names of functions that take one."""
        return self.name, ()

    @functools.cached_property
    def as_tuple(self) -> types.NamedTuple:
        """The same type as an ordinary named tuple of numba's."""
        return types.NamedTuple(self.types, self.instance_class)


def record(cls: Class) -> Class:
    """Make kernels pass the instances of a named tuple by address."""
    if not KNOWN_NUMBA:
        return cls

    @typeof_impl.register(cls)
    def _type_of(value: Any, context: Any) -> Record:
        return Record(tuple(typeof_impl(field, context) for field in value), cls)

    return cls


@register_default(Record)
class _RecordModel(PrimitiveModel):
    def __init__(self, models: Any, kind: Record) -> None:
        super().__init__(models, kind, _ADDRESS)


@unbox(Record)
def _taken(kind: Record, value: Any, c: Any) -> Any:
    fields = c.unbox(kind.as_tuple, value)
    place = cgutils.alloca_once_value(c.builder, fields.value)
    address = c.builder.bitcast(place, _ADDRESS)
    return NativeValue(address, is_error=fields.is_error, cleanup=fields.cleanup)


@lower_getattr_generic(Record)
def _field(context: Any, builder: Any, kind: Record, address: Any, name: str) -> Any:
    """Read a field; an array part by part, which tells LLVM more about it."""
    index = kind.fields.index(name)
    whole = context.get_value_type(kind.as_tuple)
    constant = builder.module.add_metadata([])

    def read(place: Any) -> Any:
        kind = place.type.pointee
        if isinstance(kind, ir.IntType | ir.DoubleType | ir.PointerType):
            value = builder.load(place)
            value.set_metadata("invariant.load", constant)  # nothing writes into a record
            return value
        found = ir.Constant(kind, ir.Undefined)
        for part in range(len(kind)):
            inner = builder.gep(place, [_INDEX(0), ir.IntType(32)(part)], inbounds=True)
            found = builder.insert_value(found, read(inner), part)
        return found

    place = builder.bitcast(address, whole.as_pointer())
    return read(builder.gep(place, [_INDEX(0), ir.IntType(32)(index)], inbounds=True))
