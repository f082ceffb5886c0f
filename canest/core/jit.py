"""Optional compilation: the same scalar Python source, run by CPython or compiled by numba.

numba costs 0.2 to 0.45 s to import, so it is imported only when a caller finds that it pays
(`enable`), and everything runs interpreted when it is missing or has nowhere to keep what it compiles.
Kernels are written so that both give the same bits: plain float64 arithmetic, no fastmath, no numpy
reductions.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import re
import sys
from collections.abc import Callable, Mapping
from types import FunctionType, ModuleType
from typing import Any, Generic, TypeVar

R = TypeVar("R")

_enabled = False
#: how numba compiles; inlined, a call costs nothing
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "forceinline": True}
#: what numba made of kernels in this process
_dispatchers: list[Any] = []
#: who is told once that numba begins to compile
_listeners: list[Callable[[], None]] = []


def available() -> bool:
    """Return True when numba is installed (without importing it)."""
    return importlib.util.find_spec("numba") is not None


def enable(on: bool = True) -> bool:
    """Switch compilation on (or off) for every kernel called from now on; return what is in force."""
    global _enabled  # noqa: PLW0603 - one process-wide switch, set once by the command that starts
    _enabled = on and available() and _keeps()
    return _enabled


def _keeps() -> bool:
    """Return whether compiled code can be kept: else each process would compile for a minute."""
    import numba

    try:
        numba.njit(cache=True)(_nothing)
    except RuntimeError:  # neither the package's folder nor the user's can be written
        return False
    return True


def _nothing() -> None:
    pass


def before_compiling(tell: Callable[[], None]) -> None:
    """Have ``tell`` called once, when numba must compile a kernel: about a minute for all of them."""
    _listeners[:] = [tell]


def enabled() -> bool:
    """Return True when kernels run compiled."""
    return _enabled


def kept_files() -> list[str]:
    """Return the files in which numba keeps an index of each kernel that was compiled or loaded here."""
    return [dispatcher._cache._cache_file._index_path for dispatcher in _dispatchers]


def _layouts(annotations: Mapping[str, Any], scope: Mapping[str, Any]) -> set[str]:
    """Return the fields of the named tuples in annotations, and of those within them."""
    names = set(re.findall(r"\w+", " ".join(map(str, annotations.values()))))
    kinds = (scope.get(name) for name in names)
    return {text for kind in kinds if hasattr(kind, "_fields") for text in _layout(kind)}


@functools.cache
def _layout(kind: Any) -> set[str]:
    within = _layouts(kind.__annotations__, vars(sys.modules[kind.__module__]))
    return {f"{kind.__qualname__}={kind._fields!r}", *within}


class Kernel(Generic[R]):
    """A scalar kernel: call it, and it runs compiled when compilation is enabled, else as it stands.

    Callers ask `jit.enabled()` to choose the containers: numpy arrays for a compiled call, lists
    (three times faster to index from CPython) for an interpreted one.
    """

    def __init__(self, function: Callable[..., R], interpreted: Callable[..., R] | None = None) -> None:
        self._source: Any = function
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self._beside = self._interpreted = interpreted
        self._compiled: Callable[..., R] | None = None

    def forget(self) -> None:
        """Bind and compile anew at the next call, since what the kernel reads of its module has changed."""
        self._interpreted, self._compiled = self._beside, None

    @property
    def interpreted(self) -> Callable[..., R]:
        """The function as it stands; kernels that it calls are called straight."""
        if self._interpreted is None:
            scope, called = self._source.__globals__, self._called("interpreted")
            self._interpreted = self._copy({**scope, **called} if called else scope)
        return self._interpreted

    @property
    def compiled(self) -> Callable[..., R]:
        """The compiled function; compiles (or loads from numba's cache) at its first call."""
        if self._compiled is None:
            import numba

            function = self._copy(dict(self._source.__globals__))
            # numba's cache looks at one file's age and at the name: a kernel that another file's change
            # has changed must not be taken from it
            function.__qualname__ = (
                f"{self.__name__}_{hashlib.sha1(self.content().encode()).hexdigest()[:12]}"
            )
            self._compiled = numba.njit(cache=True, **_OPTIONS)(function)
            _once_for_all_literals(self._compiled)
            _keep_if_it_can_be(self._compiled)
            _before_compiling(self._compiled, lambda: function.__globals__.update(self._called("compiled")))
            _dispatchers.append(self._compiled)
        return self._compiled

    def content(self) -> str:
        """Return all that the compiled code depends on: its own, constants, and the kernels that it calls."""
        code, scope = self._source.__code__, self._source.__globals__
        parts = [repr(_OPTIONS), code.co_code.hex(), repr(code.co_consts), repr(code.co_names)]
        parts += sorted(_layouts(self._source.__annotations__, scope))  # fields are compiled to their places
        for name in code.co_names:
            value = scope.get(name)
            if isinstance(value, Kernel):
                parts.append(value.content())
            elif hasattr(value, "_fields"):  # a named tuple: what a compiled constructor depends on
                parts.append(f"{name}={value._fields!r}")
            elif isinstance(value, ModuleType):  # what a kernel takes from it is compiled in as it is now
                taken = ((other, getattr(value, other, None)) for other in code.co_names)
                parts += [f"{name}.{other}={x!r}" for other, x in taken if isinstance(x, (int, float, tuple))]
            elif not callable(value):
                parts.append(f"{name}={value!r}")
        return "\n".join(parts)

    def _called(self, form: str) -> dict[str, Callable[..., Any]]:
        """Return the ``form`` of every kernel that the function calls, by the name it has there."""
        scope = self._source.__globals__
        found = ((name, scope.get(name)) for name in self._source.__code__.co_names)
        return {name: getattr(value, form) for name, value in found if isinstance(value, Kernel)}

    def _copy(self, scope: dict[str, Any]) -> FunctionType:
        """Return the function with other globals."""
        function = FunctionType(self._source.__code__, scope, self.__name__)
        function.__module__ = self._source.__module__
        return function

    def __call__(self, *args: Any) -> R:
        """Run the kernel, compiled when `enabled`."""
        return self.compiled(*args) if _enabled else self.interpreted(*args)


class _Borrowed(Kernel[Any]):
    """What `borrowed` is: nothing interpreted, and compiled an intrinsic of numba's."""

    def __init__(self) -> None:
        super().__init__(_same, _same)

    @property
    def compiled(self) -> Callable[..., Any]:
        """The intrinsic."""
        if self._compiled is None:
            self._compiled = _without_counters()
        return self._compiled

    def content(self) -> str:
        """Return its version: to be raised when `_without_counters` changes."""
        return "borrowed 1"


def _same(arrays: Any) -> Any:
    """Return what it was given."""
    return arrays


def _without_counters() -> Any:
    """Return an intrinsic that returns arrays, alone or in tuples, without the counters of their owners."""
    from numba.core import errors, types
    from numba.extending import intrinsic

    def uncounted(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.BaseTuple):
            parts: Any = enumerate(kind.types)  # type: ignore[attr-defined]
            built = [uncounted(context, builder, t, builder.extract_value(value, i)) for i, t in parts]
            return context.make_tuple(builder, kind, built)
        if isinstance(kind, types.Number):
            return value
        if not isinstance(kind, types.Array):
            raise errors.TypingError(f"{kind} can't be borrowed: only arrays and numbers can")
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo, array.parent = array.meminfo.type(None), array.parent.type(None)
        return array._getvalue()

    @intrinsic
    def borrow(typing_context: Any, arrays: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return uncounted(context, builder, arrays, arguments[0])

        return arrays(arrays), generate

    return borrow


#: arrays as a compiled kernel may use them until it returns, since its caller keeps them: numba counts the
#: users of every other array wherever it is handed on, atomically
borrowed = _Borrowed()


def _once_for_all_literals(dispatcher: Any) -> None:
    """Keep numba from compiling a kernel anew for every constant that other kernels call it with.

    A filter's update, called with the indices of six measurements, would be six functions: half of the
    time of a first compilation, for code that runs no faster.
    """
    from numba.core import types

    unliteral: Any = types.unliteral
    choose = dispatcher.get_call_template

    def choose_by_type(args: Any, kws: Any) -> Any:
        return choose([unliteral(a) for a in args], {k: unliteral(v) for k, v in kws.items()})

    dispatcher.get_call_template = choose_by_type


def _keep_if_it_can_be(dispatcher: Any) -> None:
    """Let a full disk cost the next process its time, not this one its result."""
    cache = dispatcher._cache
    save = cache.save_overload

    def save_or_not(signature: Any, compiled: Any) -> None:
        with contextlib.suppress(OSError):
            save(signature, compiled)

    cache.save_overload = save_or_not


def _before_compiling(dispatcher: Any, bind: Callable[[], None]) -> None:
    """Call ``bind`` when a kernel is not in numba's cache, that is, before the kernels it calls are needed.

    What is loaded from the cache holds the code of all that it calls: dispatchers for these, some 60 in a
    replay, would cost 10 ms.
    """
    cache = dispatcher._cache
    load = cache.load_overload

    def load_or_bind(signature: Any, context: Any) -> Any:
        loaded = load(signature, context)
        if loaded is None:
            while _listeners:
                _listeners.pop()()
            bind()
        return loaded

    cache.load_overload = load_or_bind


def kernel(function: Callable[..., R]) -> Kernel[R]:
    """Mark a scalar function as a kernel (decorator)."""
    return Kernel(function)


def kernel_beside(interpreted: Callable[..., R]) -> Callable[[Callable[..., R]], Kernel[R]]:
    """Mark a scalar function as a kernel whose interpreted form is another function, of numpy operations.

    For loops over arrays, which CPython runs a hundred times slower than numpy does. Both forms do the same
    operations on the same numbers in the same order, so they give the same bits: elementwise products and
    sums, and no numpy reduction, whose order is its own.
    """

    def mark(function: Callable[..., R]) -> Kernel[R]:
        return Kernel(function, interpreted)

    return mark
