"""Compilation of kernels, with an on-disk cache that notices changes in any kernel file.

numba keeps compiled functions on disk and recompiles one when the file that holds it changes.
But a kernel also contains, inlined, the kernels it calls and the constants it uses from other
files; numba does not notice changes there. Here a cached function is stale as soon as any file
that kernels draw on has changed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import gc
import hashlib
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
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
from numba.core.typing import Context

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
    """Return the folder of compiled code, by numba's rules; None: no place is writable.

    It is beside this file, or the folder in the environment variable NUMBA_CACHE_DIR, or in the
    user's cache folder.
    """
    try:
        return Path(FunctionCache(cache_folder).cache_path)
    except RuntimeError:
        return None


class _CheckedFile(IndexDataCacheFile):
    """numba's files of one function, each with a checksum at its end."""

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_index(self) -> Any:
        try:
            found = super()._load_index()
        except (ImportError, AttributeError):  # the code refers to something that no longer exists
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
            raise ValueError(f"the checksum of {path} is wrong")


@functools.cache
def _announce(line: str) -> None:
    """Say on stderr what takes time; each line once."""
    print(f"phase_ppl: {line}", file=sys.stderr, flush=True)


class _NoCache(NullCache):
    """No cache, as no folder is writable: every process compiles for itself."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return None, and say how to get a cache."""
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
        """Return the cached code of a signature; None if there is none, or it is damaged."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception as error:  # a damaged file can make the reader fail in any way
            self._say("damaged", error)
            with contextlib.suppress(OSError):
                self.flush()
            return None
        if found is None:
            _announce(f"compiling, which takes a while once; kept in {cache_folder()}")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Cache compiled code; if the folder is not writable, say so and go on without."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            self._say("not written", error)

    def _say(self, what: str, error: Exception) -> None:
        path = f"{self._cache_path}/{self._impl.filename_base}.*"
        warnings.warn(f"compiled anew, as {path} is {what}: {error!r}", RuntimeWarning, 2)


class _Whole(JITCodeLibrary):
    """The code of a kernel that Python calls, together with all kernels that it calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout  # everything is optimised together

    def _optimize_final_module(self) -> None:
        # numba's earlier round prunes counts of references; kernels have none
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)


class _Part(_Whole):
    """The code of a kernel that other kernels call: not optimised or made machine code by itself.

    numba does both for every function with all its callees, again at each level of a nest of
    calls. Here it is done once, for the whole.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0  # as for a missing function

    @property
    def codegen(self) -> Any:
        return self  # the caller needs ``set_env`` only

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: there is no machine code that needs its environment."""


class _Linked(_Whole):
    """The code of a kernel that others call by name: machine code of its own, made once."""

    def _get_module_for_linking(self) -> Any:
        return llvm.parse_assembly("")


class _Flags(Flags):
    """Options that compare fast; numba compares them for each function that it looks up."""

    def copy(self) -> _Flags:
        return self

    def __eq__(self, other: object) -> bool:
        return self is other if isinstance(other, _Flags) else super().__eq__(other)

    __hash__ = object.__hash__


@functools.cache
def _shared(flags: Flags) -> _Flags:
    """Return one shared object for all kernels with equal options."""
    found = _Flags()
    found._values.update(flags._values)
    return found


class _Typing(Context):
    """numba's types of calls, remembered: it looks each call up anew, at least twice a kernel."""

    def __init__(self, whole: Context) -> None:
        self.__dict__ = whole.__dict__
        self._known: dict[Any, Any] = {}

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call; None: there is none."""
        if not isinstance(func, types.Function):
            return super().resolve_function_type(func, args, kws)
        key = func, args, tuple(dict(kws).items())
        if key not in self._known:
            if (found := super().resolve_function_type(func, args, kws)) is None:
                return None
            self._known[key] = found
        return self._known[key]


_remembering: Final = functools.cache(_Typing)


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Do not look for garbage: compilers make many objects, and need nearly all until they end."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


_UNNEEDED: Final = {
    "with_lifting", "inline_closure_likes", "dead_branch_prune", "Rewrite dynamic raises",
    "make_function_op_code_to_jit_function", "inline_inlinables", "find_literally",
    "literal_unroll", "LiteralPropagation", "inline_overloads", "nopython_rewrites",
    "nopython_supported_feature_validation", "annotate_types", "dump_parfor_diagnostics",
}  # fmt: skip
"""numba's passes for features that no kernel has: closures, contexts, whole-array expressions."""


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
        typing = _remembering(typing)
        super().__init__(typing, target, library, args, returns, _shared(flags), own)
        self.state.library = self.library(self.state.targetctx.codegen(), self.library.__name__)
        self.state.library.enable_object_caching()

    def _compile_bytecode(self) -> Any:
        with uncollected():
            return super()._compile_bytecode()


class _PartCompiler(_WholeCompiler):
    library = _Part


class _LinkedCompiler(_WholeCompiler):
    library = _Linked

    def _compile_bytecode(self) -> Any:
        # the name must be the same in every process, and differ between kernels
        self.state.func_id.unique_id = package_stamp()[:16]
        return super()._compile_bytecode()


def _plain(kind: Any) -> Any:
    """Return the plain type of a number, also if the call has a literal.

    A literal makes no kernel of its own: after inlining, its value is known all the same.
    """
    literal = isinstance(kind, types.IntegerLiteral | types.BooleanLiteral)
    return types.unliteral(kind) if literal else kind


class Kernel(CPUDispatcher):
    """A compiled function: a whole if Python calls it, a part of the kernels that call it."""

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
        """Return the signature of this kernel for a kernel that calls it."""
        return self._part.get_call_template(list(map(_plain, args)), kws)

    def get_overload(self, sig: Any) -> Any:
        """Return the code of this kernel for a kernel that calls it."""
        return self._part.get_overload(sig)


class LinkedKernel(CPUDispatcher):
    """A compiled function that is linked to its callers, not inlined into them."""

    _all: Final[dict[str, LinkedKernel]] = {}

    def __init__(self, py_func: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(py_func, None, targetoptions, _LinkedCompiler)
        self._name = f"{py_func.__module__}.{py_func.__qualname__}"
        self._all[self._name] = self

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the signature for a kernel that calls this one; note what to load from disk."""
        plain = tuple(map(_plain, args))
        found = super().get_call_template(plain, kws)
        compiled: Any = self.overloads[plain]
        compiled.library._reload_init.add(_Load(self._name, plain))
        return found


@dataclasses.dataclass(frozen=True)
class _Load:
    """The work needed before a kernel from the disk can call a linked one."""

    name: str
    args: tuple[Any, ...]

    def __call__(self) -> None:
        LinkedKernel._all[self.name].compile(self.args)


KNOWN_NUMBA: Final = (0, 63) <= numba.version_info.short < (0, 69)
"""Whether this version of numba supports all this. Other versions compile by their own rules: that
takes several times as long and gives the same results."""


def _compiled(function: Function, kind: Any = Kernel, **options: Any) -> Function:
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options}
    compiled: Any = (
        kind(function, targetoptions={"nopython": True, "boundscheck": None, **options})
        if KNOWN_NUMBA and not getattr(numba.config, "DISABLE_JIT", False)
        else numba.njit(**options)(function)
    )
    try:
        compiled._cache = KernelCache(function)
    except RuntimeError:  # no place is writable
        compiled._cache = _NoCache()
    return cast(Function, compiled)


def bare_kernel(function: Function) -> Function:
    """Compile ``function`` on its first call: no Python objects, GIL or reference counts, cached.

    Floating point is strict (no fastmath), so results are the same bits in every process;
    division by zero gives inf or nan as in NumPy.

    numba counts references whenever an array is taken out of a tuple or sliced, one atomic
    operation each time. In short functions on tuples of arrays, that costs ten times more than
    the arithmetic. A function without counts cannot allocate, which rules out slice-to-slice copies
    too (``a[i] = b[j]`` on rows needs a loop), and must not return an array.
    """
    return _compiled(function, _nrt=False, forceinline=False)


def inlined_kernel(function: Function) -> Function:
    """As ``bare_kernel``, compiled into its callers, since passing a large tuple takes time too."""
    return _compiled(function, _nrt=False, forceinline=True)


def linked_kernel(function: Function) -> Function:
    """As ``bare_kernel``, compiled once for all of its callers: for long functions."""
    return _compiled(function, LinkedKernel, _nrt=False)
