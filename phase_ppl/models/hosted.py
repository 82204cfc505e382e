"""Compiled programs that are left at each simulation, so that what XLA makes of them can be kept.

A program that calls the simulator from within cannot be kept on disk: what it calls has an address
that is another in every process. Here it is traced as a whole and cut at the simulations that it
asks for. The pieces are compiled without them, and kept; the simulations are run in between.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import jax
from jax.extend import core

from phase_ppl.models.bridge import answered, request_p
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.kept import compiled_or_kept

_CALLS: Final = ("jit", "pjit")
"""Names of the primitive that calls a function compiled on its own, new and old."""


class Hosted:
    """A function like ``jax.jit(function)``, left at each simulation.

    Where it asks for simulations in a loop or on a condition, it is compiled as a whole and calls
    the simulator from within.

    Args:
        function: of trees of arrays.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._made: dict[Any, Callable[..., Any]] = {}

    def shapes(self, *args: Any) -> Any:
        """Return shapes and types of what a call returns."""
        return jax.eval_shape(self._function, *args)

    def __call__(self, *args: Any) -> Any:
        leaves, treedef = jax.tree.flatten(args)
        kind = treedef, tuple(map(jax.typeof, leaves))
        if kind not in self._made:
            self._made[kind] = self._make(args)
        return self._made[kind](*args)

    def _make(self, args: tuple[Any, ...]) -> Callable[..., Any]:
        traced, shapes = jax.make_jaxpr(self._function, return_shape=True)(*args)
        program = _written_out(traced)
        if program is None:
            return compiled_quickly(self._function)
        pieces = list(_pieces(program.jaxpr))
        constants = dict(zip(program.jaxpr.constvars, program.consts, strict=True))
        treedef = jax.tree.structure(shapes)

        def run(*args: Any) -> Any:
            given = zip(program.jaxpr.invars, jax.tree.leaves(args), strict=True)
            values = constants | dict(given)
            for piece in pieces:
                piece.run(values)
            return jax.tree.unflatten(treedef, _values(program.jaxpr.outvars, values))

        return run


@dataclasses.dataclass(frozen=True)
class _Piece:
    """What a program computes up to a simulation, or to its end.

    Attributes:
        inputs, outputs: variables.
        compiled: the values of the one -> those of the other.
        request: the simulation that comes after; None: the end.
    """

    inputs: Sequence[core.Var]
    outputs: Sequence[core.Var]
    compiled: Callable[..., Sequence[Any]]
    request: core.JaxprEqn | None

    def run(self, values: dict[core.Var, Any]) -> None:
        """Compute the outputs and what the simulation gives, into the values."""
        found = self.compiled(*_values(self.inputs, values))
        values.update(zip(self.outputs, found, strict=True))
        if self.request is not None:
            errors = answered(*_values(self.request.invars, values), **self.request.params)
            values[self.request.outvars[0]] = errors


def _values(atoms: Iterable[Any], values: Mapping[core.Var, Any]) -> list[Any]:
    return [a.val if isinstance(a, core.Literal) else values[a] for a in atoms]


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
            if equation.primitive is request_p or not _requests(equation):
                equations.append(equation.replace(invars=given))
                continue
            if equation.primitive.name not in _CALLS:
                return False
            inner = equation.params["jaxpr"]
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
    if equation.primitive is request_p:
        return True
    kinds = core.Jaxpr | core.ClosedJaxpr
    held = jax.tree.leaves(
        list(equation.params.values()), is_leaf=lambda part: isinstance(part, kinds)
    )
    jaxprs = [getattr(part, "jaxpr", part) for part in held if isinstance(part, kinds)]
    return any(_requests(inner) for jaxpr in jaxprs for inner in jaxpr.eqns)


def _pieces(program: core.Jaxpr) -> Iterator[_Piece]:
    """Yield the pieces, compiled; what nobody needs is left out."""
    needed = _variables(program.outvars)
    cut: list[tuple[list[core.JaxprEqn], set[core.Var], core.JaxprEqn | None]] = [
        ([], needed, None)
    ]
    for equation in reversed(program.eqns):
        if needed.isdisjoint(equation.outvars):
            continue
        needed = (needed - set(equation.outvars)) | _variables(equation.invars)
        if equation.primitive is request_p:
            cut.append(([], needed, equation))
        else:
            cut[-1][0].append(equation)
    for equations, wanted, request in reversed(cut):
        made = {variable for equation in equations for variable in equation.outvars}
        taken = [v for e in equations[::-1] for v in e.invars if not isinstance(v, core.Literal)]
        inputs = [variable for variable in dict.fromkeys(taken) if variable not in made]
        outputs = [v for e in equations[::-1] for v in e.outvars if v in wanted]
        part = program.replace(constvars=[], invars=inputs, outvars=outputs, eqns=equations[::-1])
        piece = core.jaxpr_as_fun(core.ClosedJaxpr(part, []))
        lowered = compiled_quickly(piece).lower(*map(_blank, inputs))
        yield _Piece(inputs, outputs, compiled_or_kept(lowered), request)


def _variables(atoms: Iterable[Any]) -> set[core.Var]:
    return {atom for atom in atoms if not isinstance(atom, core.Literal)}


def _blank(variable: core.Var) -> jax.ShapeDtypeStruct:
    kind = variable.aval
    weak = getattr(kind, "weak_type", False)
    return jax.ShapeDtypeStruct(kind.shape, kind.dtype, weak_type=weak)
