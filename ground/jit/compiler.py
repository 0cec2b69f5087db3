"""Registration of kernels with numba; imported when the first one is called.

Numba meets our `Kernel` objects as globals of the functions that it compiles, and takes each for what it is made
of it here.
"""

import ground.jit.without_coverage  # noqa: F401 - before all else that imports numba

# isort: split
import gc
import inspect
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numba.extending
from llvmlite.binding import parse_bitcode
from numba.core import caching, event, types
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime import rtsys  # type: ignore[attr-defined]
from numba.extending import overload, typeof_impl

import ground.jit.compile_news as compile_news
import ground.jit.shipped as shipped
from ground.jit import Kernel, overloads
from ground.jit.compile_news import CompileCount
from ground.jit.kernel_cache import cache_folder, digest_of
from ground.jit.signatures import plain

use_shipped = True  # False: compile for this very processor what the wheel has for its kind (`rtpiv setup warm`)


class _ByContent:
    """Says where numba keeps a function: in the folder that names all its code is made of, and by nothing else.

    Numba's own locators add a digest of the folder that the source lies in, so that each clone, environment and
    container would compile the same text again.
    """

    def __init__(self, line: int, folder: Path) -> None:
        self._line, self._folder = line, folder

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return what changes with the code: the folder's own name."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Return what tells two functions of one name in one file apart."""
        return str(self._line)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_ByContent | None":
        """Return the place of a function; None where nothing can be kept."""
        folder = cache_folder(Path(file))
        return None if folder is None else cls(function.__code__.co_firstlineno, folder)


class _KeptCode(JITCodeLibrary):
    """Machine code from the cache, and beside it, as large, what LLVM compiles its callers from.

    Numba reads both, and lists all names in the latter.  Here it is read when a caller is compiled: most commands
    compile nothing.
    """

    _code = _for_callers = b""

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> "_KeptCode":  # noqa: ANN401 - numba has no types
        name, _, (code, for_callers) = state
        kept = cls(codegen, name)
        kept._code, kept._for_callers = code, for_callers
        kept.enable_object_caching()  # type: ignore[no-untyped-call]
        kept._set_compiled_object(code)  # type: ignore[no-untyped-call]
        kept._finalize_final_module()  # type: ignore[no-untyped-call]
        return kept

    def _get_module_for_linking(self) -> Any:  # noqa: ANN401
        if self._shared_module is None:
            self._shared_module = parse_bitcode(self._for_callers)
            self._codegen._engine._load_defined_symbols(self._shared_module)  # type: ignore[no-untyped-call]
        return super()._get_module_for_linking()  # type: ignore[no-untyped-call]

    def get_pointer_to_function(self, name: str) -> int:
        """Return where a function begins, 0 for one that is not here: LLVM would end the process."""
        if b"\0%s\0" % name.encode() in self._code:  # as it stands in the table of names
            self._codegen._engine._defined_symbols.add(name)
        else:
            self._get_module_for_linking()
        return int(super().get_pointer_to_function(name))  # type: ignore[no-untyped-call]


class _KeptByContent(caching.CompileResultCacheImpl):
    _locator_classes = [_ByContent]  # noqa: RUF012 - numba's own name for it

    def rebuild(self, target_context: Any, payload: Any) -> Any:  # noqa: ANN401
        """Make a kept function ready to be called; the caller holds numba's lock of its compiler."""
        codegen = target_context.codegen()
        usual, codegen._library_class = codegen._library_class, _KeptCode
        try:
            return super().rebuild(target_context, payload)  # type: ignore[no-untyped-call]
        finally:
            codegen._library_class = usual


class _KernelCache(caching.FunctionCache):
    """Numba's cache of a function, found by content, quick to read, and silent where the disk is full.

    What this computer has not compiled is taken from the wheel (`ground.jit.shipped`), if that has it.
    """

    _impl_class = _KeptByContent

    def load_overload(self, signature: object, target_context: object) -> object:
        """Load machine code without first preparing for compiling, which takes longer than all the loading.

        Before it looks into its cache, numba imports what it knows of NumPy, SciPy's linear algebra included.
        Of that machine code needs the runtime alone, which counts references; whatever compiles asks for the rest.

        Whatever is wrong with a kept file (cut short, written over, of a module that is no more) costs the time to
        compile, which then replaces it: reading it may raise anything that unpickling can.
        """
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(signature, target_context)  # type: ignore[no-untyped-call]
        except Exception:
            found = None
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
        return self._from_wheel(signature, target_context) if found is None else found

    def _from_wheel(self, signature: object, target_context: Any) -> object:  # noqa: ANN401
        """Machine code for processors of this one's kind, as if it had been compiled here."""
        folder = shipped.wheel_folder(numba.__version__, shipped.FOLDER)
        if not use_shipped or folder is None:
            return None
        digest = digest_of(Path(inspect.getfile(self._py_func)).resolve())
        kept = caching.IndexDataCacheFile(  # type: ignore[no-untyped-call]
            str(folder / digest), self._impl.filename_base, digest
        )
        _, (system, *_), code = self._index_key(signature, target_context.codegen())  # type: ignore[no-untyped-call]
        try:
            data = kept.load((signature, (system, folder.name, ""), code))  # type: ignore[no-untyped-call]
            return None if data is None else self._impl.rebuild(target_context, data)
        except Exception:  # as above: whatever is wrong with it costs the time to compile
            return None

    def save_overload(self, signature: object, data: object) -> None:
        """Keep machine code; a disk that is full costs the next process its time, not this one its results."""
        with suppress(OSError):
            super().save_overload(signature, data)  # type: ignore[no-untyped-call]


def register_with_numba(function: Callable[..., Any], options: dict[str, Any]) -> Any:  # noqa: ANN401
    """Return numba's object for a function; what is in its folder of the cache is found when it is called."""
    while overloads:
        replaced, writer, how = overloads.pop(0)
        overload(replaced, **how)(writer)
    # C calls no kernel, and its wrapper was a twentieth of all compiling
    compiled = numba.njit(**options | {"cache": False, "no_cfunc_wrapper": True})(function)
    if options.get("cache") and cache_folder(Path(inspect.getfile(function))) is not None:
        compiled._cache = _KernelCache(function)  # type: ignore[no-untyped-call]
    _type_integers_once(compiled)
    return compiled


def _type_integers_once(compiled: Any) -> None:  # noqa: ANN401
    """Let a kernel that is called with an integer written in the code be compiled for int64, as for any other.

    Numba has a type for each such number, and compiles ``next_body(..., 0)`` for it alone; that of a variable that
    starts at 0 and is counted up is int64 as soon as the loop is read, and all callees are compiled twice.
    True and False keep their types: a kernel leaves out what its caller has switched off (`glass_span`).
    """
    template = compiled.get_call_template

    def type_call(args: Sequence[types.Type], named: dict[str, types.Type]) -> object:
        return template([*map(_int64, args)], {name: _int64(kind) for name, kind in named.items()})

    compiled.get_call_template = type_call


def _int64(kind: types.Type) -> types.Type:
    """Return the type of the integer where that is one written in the code, else the type itself."""
    return kind.literal_type if isinstance(kind, types.IntegerLiteral) else kind


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel: Kernel, context: object) -> types.Type:
    return types.Dispatcher(kernel.dispatcher)


class _Compiling(event.Listener):
    """Hears of functions that no cache holds, and counts them; a kernel is compiled with its callees in one go.

    Python's collector rests meanwhile: the compiler makes millions of small objects that stay until it ends, and
    looking through them again and again took a sixth of its time.  What it leaves is collected after each kernel.
    """

    def __init__(self) -> None:
        self._count = CompileCount()
        self._depth = 0
        self._collects = False

    def on_start(self, event: Any) -> None:  # noqa: ANN401
        """One is about to be compiled."""
        if self._depth == 0 and compile_news.make_helper is not None:
            with suppress(TypeError):  # called with something that no list of kernels has
                compile_news.missing(_place(event), [plain(each) for each in event.data["args"]])
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        self._count.start()

    def on_end(self, event: Any) -> None:  # noqa: ANN401
        """One is compiled."""
        self._depth -= 1
        if self._depth == 0:
            if self._collects:
                gc.enable()
            compile_news.report_compiled(_place(event))
        self._count.finish()


def _place(event: Any) -> str:  # noqa: ANN401
    function = event.data["dispatcher"].py_func
    return f"{function.__module__}:{function.__qualname__}"


event.register("numba:compile", _Compiling())  # type: ignore[no-untyped-call]
