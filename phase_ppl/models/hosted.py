"""Compiled programs that are left at each simulation, so that what XLA makes of them can be kept.

All this is for speed: but for the time it takes, ``Hosted(function)`` is ``jax.jit(function)``.

A program that calls the simulator from within cannot be kept on disk: what it calls has an address
that is another in every process. Here it is traced as a whole and cut at the simulations that it
asks for. The pieces are compiled without them, and kept; the simulations are run in between.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import pickle
import time
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import jax
import jaxlib
import llvmlite.binding as llvm
import numpy as np
from jax.experimental import serialize_executable
from jax.extend import core

from phase_ppl.models.bridge import answered, asked_for
from phase_ppl.models.density import compiled_quickly, is_stepped, on_cpu, tracing
from phase_ppl.physics.jit import cache_folder
from phase_ppl.world.errors import OutputError
from phase_ppl.world.files import write_bytes
from phase_ppl.world.identity import code_changed_since, versions

SUFFIX: Final = ".xla"
_IMPORTED: Final = time.time()
MOST: Final = 400  # files; beyond that the one goes that was not used for longest
_LEVEL: Final = 3  # of compression: as good as any for machine code, and fast
_DIGEST: Final = hashlib.sha256().digest_size


def folder() -> Path | None:
    """Return where programs are kept; None: nowhere, or where JAX is told to keep them itself."""
    config: Any = jax.config
    return None if config.jax_compilation_cache_dir else cache_folder()


def outline_name(identity: str) -> str | None:
    """Return what identifies the making of a program: what is said of it, and all code.

    None where code was changed since it was imported: what runs is not what the files say.
    """
    if code_changed_since(_IMPORTED):
        return None
    return _hash(identity, json.dumps([versions(), jax.config.values], default=str, sort_keys=True))


def _hash(*parts: str) -> str:
    return hashlib.sha256("\0".join((*parts, *_target())).encode()).hexdigest()[:40]


@functools.cache
def _target() -> tuple[str, ...]:
    compiler = (jax.__version__, jaxlib.__version__, os.environ.get("XLA_FLAGS", ""))
    return (*compiler, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())


def read_code(name: str, n_inputs: int, n_outputs: int) -> Callable[..., Any] | None:
    """Return a compiled program from the disk, of flat arguments and results; None: not there."""
    given = jax.tree.structure(((0,) * n_inputs, {}))
    results = jax.tree.structure([0] * n_outputs)
    devices = jax.local_devices(backend="cpu")[:1]
    load = serialize_executable.deserialize_and_load
    return read(name, lambda code: load(code, given, results, "cpu", execution_devices=devices))


def read(name: str, understood: Callable[[bytes], Any] = pickle.loads) -> Any:
    """Return what is kept under a name; None: not there, or damaged, which is said."""
    if (place := folder()) is None:
        return None
    path = place / f"{name}{SUFFIX}"
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
            raise ValueError("its checksum is another")
        with contextlib.suppress(OSError):
            os.utime(path)
        return understood(zlib.decompress(content[_DIGEST:]))
    except OSError:
        return None
    except Exception as error:  # whatever a damaged file makes the reader stumble over
        warnings.warn(f"compiled anew, as {path} is damaged: {error!r}", RuntimeWarning, 2)
        return None


def write(name: str, content: bytes) -> None:
    """Keep something on the disk, and no more than :data:`MOST` files in all."""
    if (place := folder()) is None:
        return
    packed = zlib.compress(content, _LEVEL)
    # what cannot be written is compiled again by the next process
    with contextlib.suppress(OutputError, OSError):
        place.mkdir(parents=True, exist_ok=True)
        path = place / f"{name}{SUFFIX}"
        write_bytes(path, (SUFFIX,), hashlib.sha256(packed).digest() + packed)
        kept = sorted(place.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime)
        for old in kept[:-MOST]:
            old.unlink(missing_ok=True)


_CALLS: Final = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitives that call a function, new and old -> the parameter that has it."""


_Given: TypeAlias = tuple[int | None, Any]  # number of a value; or None, and the value itself

_Request: TypeAlias = tuple[int, tuple[_Given, ...], dict[str, Any]]
"""Number of the errors of a simulation, what it is asked for with, and the parameters of that."""


@dataclasses.dataclass(frozen=True)
class _Piece:
    """What a program computes up to a simulation, or to its end."""

    code: str  # name under which it is kept
    inputs: tuple[int, ...]  # numbers of values
    outputs: tuple[int, ...]
    request: _Request | None  # for the simulation that comes after; None: the end


@dataclasses.dataclass(frozen=True)
class _Outline:
    """How pieces of compiled code make a program; plain data."""

    inputs: tuple[int, ...]  # numbers of the leaves of the arguments
    constants: dict[int, Any]  # number -> value
    pieces: tuple[_Piece, ...]  # in order
    outputs: tuple[_Given, ...]  # leaves of the result
    blank: Any  # a result with other leaves


class Hosted:
    """A function like ``jax.jit(function)`` on the processor, left at each simulation.

    Where it asks for simulations in a loop or on a condition, it is compiled as a whole and calls
    the simulator from within. Its ``identity`` tells it from any other function of this package's
    code, so that it need not even be traced where it has been before; None: nothing can.
    """

    def __init__(self, function: Callable[..., Any], identity: str | None = None) -> None:
        self._function, self._identity = function, identity
        self._made: dict[Any, Callable[..., Any]] = {}

    @tracing()
    def shapes(self, *args: Any) -> Any:
        """Return shapes and types of what a call returns."""
        return jax.eval_shape(self._function, *args)

    def __call__(self, *args: Any) -> Any:
        leaves, treedef = jax.tree.flatten(args)
        kind = treedef, tuple(map(jax.typeof, leaves))
        with on_cpu():
            if is_stepped():
                return self._function(*args)
            if kind not in self._made:
                self._made[kind] = self._remembered(kind) or self._make(args, kind)
            return self._made[kind](*args)

    def _name(self, kind: Any) -> str | None:
        """Return what identifies the program in all processes; None: nothing does."""
        return None if self._identity is None else outline_name(f"{self._identity} {kind}")

    def _remembered(self, kind: Any) -> Callable[..., Any] | None:
        """Return what an earlier process has made, if it is still there."""
        if (name := self._name(kind)) is None or (outline := read(name)) is None:
            return None
        shapes = [(one.code, len(one.inputs), len(one.outputs)) for one in outline.pieces]
        codes: list[Any] = [read_code(*shape) for shape in shapes]
        return None if None in codes else functools.partial(_run, outline, codes)

    @tracing()
    def _make(self, args: tuple[Any, ...], kind: Any) -> Callable[..., Any]:
        traced, shapes = jax.make_jaxpr(self._function, return_shape=True)(*args)
        program = _written_out(traced)
        if program is None:
            return compiled_quickly(tracing()(self._function))
        numbers: dict[core.Var, int] = {}

        def numbered(variables: Iterable[core.Var]) -> tuple[int, ...]:
            return tuple(numbers.setdefault(variable, len(numbers)) for variable in variables)

        def one(atom: Any) -> _Given:
            if isinstance(atom, core.Literal):
                return None, _plain(atom.val, atom)
            return numbered([atom])[0], None

        pieces, codes = [], []
        for inputs, outputs, lowered, request in _pieces(program.jaxpr):
            after: _Request | None = None
            if request is not None:
                (errors,) = numbered(request.outvars)
                after = errors, tuple(map(one, request.invars)), asked_for(request) or {}
            code = _hash(lowered.as_text())  # what it computes, and for what machine
            pieces.append(_Piece(code, numbered(inputs), numbered(outputs), after))
            if (compiled := read_code(code, len(inputs), len(outputs))) is None:
                compiled = lowered.compile()
                with contextlib.suppress(NotImplementedError, ValueError):  # not to be serialised
                    write(code, serialize_executable.serialize(compiled)[0])
            codes.append(compiled)
        variables = program.jaxpr.constvars
        constants = map(_plain, program.consts, variables)
        outline = _Outline(
            numbered(program.jaxpr.invars),
            dict(zip(numbered(variables), constants, strict=True)),
            tuple(pieces),
            tuple(map(one, program.jaxpr.outvars)),
            jax.tree.map(lambda _: 0, shapes),
        )
        if (name := self._name(kind)) is not None:
            with contextlib.suppress(TypeError, AttributeError, pickle.PicklingError):
                write(name, pickle.dumps(outline))
        return functools.partial(_run, outline, codes)


def _plain(value: Any, atom: Any) -> Any:
    """Return a constant as an array of NumPy, but for keys."""
    kind = atom.aval.dtype
    is_key = jax.dtypes.issubdtype(kind, jax.dtypes.prng_key)
    return value if is_key else np.asarray(value, kind)


def _run(outline: _Outline, codes: Sequence[Callable[..., Any]], *args: Any) -> Any:
    values = outline.constants | dict(zip(outline.inputs, jax.tree.leaves(args), strict=True))

    def known(given: Iterable[_Given]) -> list[Any]:
        return [value if number is None else values[number] for number, value in given]

    for piece, code in zip(outline.pieces, codes, strict=True):
        found = code(*(values[number] for number in piece.inputs))
        values.update(zip(piece.outputs, found, strict=True))
        if piece.request is not None:
            number, asked, params = piece.request
            values[number] = jax.device_put(answered(*known(asked), **params))
    return jax.tree.unflatten(jax.tree.structure(outline.blank), known(outline.outputs))


def _written_out(traced: core.ClosedJaxpr) -> core.ClosedJaxpr | None:
    """Return the program with those calls written out that ask for simulations.

    None where it asks for them in another way than one after the other.
    """
    known: dict[core.Var, Any] = {}  # of what a call takes and returns: what it is outside
    equations: list[core.JaxprEqn] = []
    constants = dict(zip(traced.jaxpr.constvars, traced.consts, strict=True))
    seen: set[int] = set()

    def outside(atoms: Iterable[Any]) -> list[Any]:
        return [a if isinstance(a, core.Literal) else known.get(a, a) for a in atoms]

    def write(jaxpr: core.Jaxpr) -> bool:
        if id(jaxpr) in seen:  # called twice: its variables would be taken for each other
            return False
        seen.add(id(jaxpr))
        for equation in jaxpr.eqns:
            given = outside(equation.invars)
            if asked_for(equation) or not _requests(equation):
                equations.append(equation.replace(invars=given))
                continue
            if equation.primitive.name not in _CALLS:
                return False
            inner = equation.params[_CALLS[equation.primitive.name]]
            constants.update(zip(inner.jaxpr.constvars, inner.consts, strict=True))
            known.update(zip(inner.jaxpr.invars, given, strict=True))
            if not write(inner.jaxpr):
                return False
            known.update(zip(equation.outvars, outside(inner.jaxpr.outvars), strict=True))
        return True

    if not write(traced.jaxpr):
        return None
    jaxpr = traced.jaxpr.replace(
        eqns=equations, outvars=outside(traced.jaxpr.outvars), constvars=list(constants)
    )
    return core.ClosedJaxpr(jaxpr, list(constants.values()))


def _requests(equation: core.JaxprEqn) -> bool:
    """Return whether an equation, or any within it, asks for a simulation."""
    if asked_for(equation):
        return True
    kinds = core.Jaxpr | core.ClosedJaxpr
    params = list(equation.params.values())
    held = jax.tree.leaves(params, is_leaf=lambda part: isinstance(part, kinds))
    jaxprs = (getattr(part, "jaxpr", part) for part in held if isinstance(part, kinds))
    return any(_requests(inner) for jaxpr in jaxprs for inner in jaxpr.eqns)


def _pieces(
    program: core.Jaxpr,
) -> Iterator[tuple[list[core.Var], list[core.Var], jax.stages.Lowered, core.JaxprEqn | None]]:
    """Yield the pieces: inputs, outputs, what computes them, and the request that comes after.

    What nobody needs is left out.
    """
    needed = _variables(program.outvars)
    cut: list[tuple[list[core.JaxprEqn], set[core.Var], core.JaxprEqn | None]] = [
        ([], needed, None)
    ]
    for equation in reversed(program.eqns):
        if needed.isdisjoint(equation.outvars):
            continue
        needed = (needed - set(equation.outvars)) | _variables(equation.invars)
        if asked_for(equation):
            cut.append(([], needed, equation))
        else:
            cut[-1][0].append(equation)
    for equations, wanted, request in reversed(cut):
        made = {variable for equation in equations for variable in equation.outvars}
        taken = [v for e in equations[::-1] for v in e.invars if not isinstance(v, core.Literal)]
        inputs = [variable for variable in dict.fromkeys(taken) if variable not in made]
        outputs = [v for e in equations[::-1] for v in e.outvars if v in wanted]
        part = program.replace(constvars=[], invars=inputs, outvars=outputs, eqns=equations[::-1])
        quick: Any = compiled_quickly(core.jaxpr_as_fun(core.ClosedJaxpr(part, [])))
        yield inputs, outputs, quick.lower(*map(_blank, inputs)), request


def _variables(atoms: Iterable[Any]) -> set[core.Var]:
    return {atom for atom in atoms if not isinstance(atom, core.Literal)}


def _blank(variable: core.Var) -> jax.ShapeDtypeStruct:
    kind: Any = variable.aval
    weak = getattr(kind, "weak_type", False)
    return jax.ShapeDtypeStruct(kind.shape, kind.dtype, weak_type=weak)
