"""Compilation of kernels, with an on-disk cache that notices changes in any kernel file.

numba keeps compiled functions on disk and recompiles one when the file that holds it changes.
But a kernel also contains, inlined, the kernels it calls and the constants it uses from other
files; a change there would go unnoticed. Here a cached function is fresh only as long as no
file that kernels draw on has changed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import pickle
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import llvmlite.binding as llvm
import numba
from numba.core import types
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_machinery import PassManager
from numba.core.registry import CPUDispatcher

from phase_ppl.world.identity import source_stamp

_DIGEST: Final = hashlib.sha256().digest_size

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE: Final = Path(__file__).resolve().parent.parent
_FOLDERS: Final = ("world", "physics", "agents")
"""Folders of the package that hold kernels or constants used in kernels."""


@functools.cache
def package_stamp() -> str:
    """Return the hash of all files on which compiled kernels depend."""
    return source_stamp(file for name in _FOLDERS for file in (_PACKAGE / name).glob("*.py"))


def cache_folder() -> Path | None:
    """Return where compiled code is kept, by numba's rules; None: in no place that is writable.

    Beside this file, or in the folder that the environment variable NUMBA_CACHE_DIR names, or in
    the user's folder of caches.
    """
    try:
        return Path(FunctionCache(cache_folder).cache_path)
    except RuntimeError:
        return None


class _CheckedFile(IndexDataCacheFile):
    """numba's files of one function, each with a checksum behind what numba reads of it."""

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_index(self) -> Any:
        try:
            found = super()._load_index()
        except (ImportError, AttributeError):  # what it was compiled for is no longer there
            return {}
        if found:
            self._check(self._index_path, len(pickle.dumps(self._version, -1)))
        return found

    def _load_data(self, name: str) -> Any:
        self._check(self._data_path(name), 0)
        return super()._load_data(name)

    def _check(self, path: str, start: int) -> None:
        content = Path(path).read_bytes()[start:]
        if hashlib.sha256(content[:-_DIGEST]).digest() != content[-_DIGEST:]:
            raise ValueError(f"the checksum of {path} is another")


@functools.cache
def _announce(line: str) -> None:
    """Say on stderr what takes time, once."""
    print(f"phase_ppl: {line}", file=sys.stderr, flush=True)


class _NoCache(NullCache):
    """Where nothing can be kept: every process compiles for itself."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return nothing, and say what can be done about that."""
        _announce(
            "compiling, which takes a while in every process, as no folder to keep it in can be "
            "written; name one in the environment variable NUMBA_CACHE_DIR"
        )


class KernelCache(FunctionCache):
    """numba's cache of one function, stale as soon as ``package_stamp`` changes."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=package_stamp(),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept of a signature; None, after a word, where it is not, or damaged."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception as error:  # whatever a damaged file makes the reader stumble over
            self._say("damaged", error)
            with contextlib.suppress(OSError):
                self.flush()
            return None
        if found is None:
            _announce(f"compiling, which takes a while once; kept in {cache_folder()}")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled; where that cannot be written, say so and do without."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            self._say("not written", error)

    def _say(self, what: str, error: Exception) -> None:
        path = f"{self._cache_path}/{self._impl.filename_base}.*"
        warnings.warn(f"compiled anew, as {path} is {what}: {error!r}", RuntimeWarning, 2)


class _Whole(JITCodeLibrary):
    """The code of a kernel that Python calls, with that of all kernels it calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout  # all is optimised together

    def _optimize_final_module(self) -> None:
        # numba has a round before this one, to find counts of references; here are none
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)


class _Part(_Whole):
    """The code of a kernel that kernels call: neither optimised nor made machine code by itself.

    numba does both for every function, with all that it calls, again at each level of a nest of
    calls; here it is done once, for the whole.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0  # as for a function that is not there

    @property
    def codegen(self) -> Any:
        return self  # what asks wants ``set_env`` only

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: no machine code is there to be told of its environment."""


class _Linked(_Whole):
    """The code of a kernel that kernels call by its name: machine code of its own, made once."""

    def _get_module_for_linking(self) -> Any:
        return llvm.parse_assembly("")


class _Flags(Flags):
    """Options that are compared in no time: numba does so for each function that it looks up."""

    def copy(self) -> _Flags:
        return self

    @functools.cached_property
    def _hash(self) -> int:
        return super().__hash__()

    def __eq__(self, other: object) -> bool:
        return self is other or super().__eq__(other)

    def __hash__(self) -> int:
        return self._hash


@functools.cache
def _shared(flags: Flags) -> _Flags:
    """Return the same options for all kernels that have the same."""
    found = _Flags()
    found._values.update(flags._values)
    return found


_UNNEEDED: Final = {
    "with_lifting", "inline_closure_likes", "dead_branch_prune", "Rewrite dynamic raises",
    "make_function_op_code_to_jit_function", "inline_inlinables", "find_literally",
    "literal_unroll", "LiteralPropagation", "inline_overloads", "nopython_rewrites",
    "nopython_supported_feature_validation", "annotate_types", "dump_parfor_diagnostics",
}  # fmt: skip
"""Passes of numba's over what no kernel has: closures, contexts, expressions of whole arrays."""


class _WholeCompiler(Compiler):
    library: type[JITCodeLibrary] = _Whole

    def define_pipelines(self) -> list[Any]:
        (whole,) = super().define_pipelines()
        needed = PassManager(whole.pipeline_name)
        needed.passes = [one for one in whole.passes if one[0].name() not in _UNNEEDED]
        needed.finalize()
        return [needed]

    def __init__(
        self, typing: Any, target: Any, library: Any, args: Any, returns: Any, flags: Any, own: Any
    ) -> None:
        super().__init__(typing, target, library, args, returns, _shared(flags), own)
        self.state.library = self.library(self.state.targetctx.codegen(), self.library.__name__)
        self.state.library.enable_object_caching()


class _PartCompiler(_WholeCompiler):
    library = _Part


class _LinkedCompiler(_WholeCompiler):
    library = _Linked

    def _compile_bytecode(self) -> Any:
        # its name must be the same in every process, and of another kernel another
        self.state.func_id.unique_id = package_stamp()[:16]
        return super()._compile_bytecode()


def _plain(kind: Any) -> Any:
    """Return the type of a number, also of one that is written in the call.

    That makes no kernel of its own: it is known all the same once the one is within the other.
    """
    literal = isinstance(kind, types.IntegerLiteral | types.BooleanLiteral)
    return types.unliteral(kind) if literal else kind


class Kernel(CPUDispatcher):
    """A compiled function: a whole where Python calls it, a part of those kernels that do."""

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: dict[str, Any] | None = None,
        targetoptions: dict[str, Any] | None = None,
    ) -> None:
        options = dict(targetoptions or {})
        super().__init__(py_func, locals, options, _WholeCompiler)
        options = options | {"no_cpython_wrapper": True}
        self._part = CPUDispatcher(py_func, locals, options, _PartCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Tell a kernel that calls this one what it is."""
        return self._part.get_call_template(list(map(_plain, args)), kws)

    def get_overload(self, sig: Any) -> Any:
        """Give a kernel that calls this one its code."""
        return self._part.get_overload(sig)


class LinkedKernel(CPUDispatcher):
    """A compiled function that is not made part of the kernels that call it."""

    _all: Final[dict[str, LinkedKernel]] = {}

    def __init__(self, py_func: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(py_func, None, targetoptions, _LinkedCompiler)
        self._name = f"{py_func.__module__}.{py_func.__qualname__}"
        self._all[self._name] = self

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Tell a kernel that calls this one what it is, and what it needs from the disk."""
        plain = tuple(map(_plain, args))
        found = super().get_call_template(plain, kws)
        compiled: Any = self.overloads[plain]
        compiled.library._reload_init.add(_Load(self._name, plain))
        return found


@dataclasses.dataclass(frozen=True)
class _Load:
    """What must be done before a kernel from the disk can call a linked one."""

    name: str
    args: tuple[Any, ...]

    def __call__(self) -> None:
        LinkedKernel._all[self.name].compile(self.args)


KNOWN_NUMBA: Final = (0, 63) <= numba.version_info.short < (0, 69)
"""Whether this numba is one in whose inner parts all this reaches; others compile by their own
rules, which takes several times as long and gives the same results."""


def _compiled(function: Function, kind: Any = Kernel, **options: Any) -> Function:
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options}
    compiled: Any = (
        kind(function, targetoptions={"nopython": True, "boundscheck": None, **options})
        if KNOWN_NUMBA and not getattr(numba.config, "DISABLE_JIT", False)
        else numba.njit(**options)(function)
    )
    try:
        compiled._cache = KernelCache(function)
    except RuntimeError:  # there is no place that can be written
        compiled._cache = _NoCache()
    return cast(Function, compiled)


def bare_kernel(function: Function) -> Function:
    """Compile ``function`` on its first call: no Python objects, GIL or reference counts, cached.

    Floating point is strict (no fastmath), so results are the same bits in every process;
    division by zero gives inf or nan as in NumPy.

    numba counts references whenever an array is taken out of a tuple or sliced, one atomic
    operation each time; in short functions on tuples of arrays that costs ten times more than
    the arithmetic. Such a function cannot allocate, which rules out slice-to-slice copies too
    (``a[i] = b[j]`` on rows needs a loop), and must not return an array.
    """
    return _compiled(function, _nrt=False)


def inlined_kernel(function: Function) -> Function:
    """As ``bare_kernel``, compiled into its callers: handing over a large tuple takes time too."""
    return _compiled(function, _nrt=False, forceinline=True)


def linked_kernel(function: Function) -> Function:
    """As ``bare_kernel``, compiled once for all of its callers: what is long, and does much."""
    return _compiled(function, LinkedKernel, _nrt=False)
