"""The default estimator's modules with some of their names given other values, for a while.

A compiled loop has the values compiled in, so its kernels are compiled anew for every patch, once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pkgutil import resolve_name
from typing import Any
from unittest import mock

from canest.core.jit import Kernel
from canest.estimators import default

PACKAGE = default.__name__
#: patch -> what its kernels have been bound to and compiled to
_BOUND: dict[tuple[tuple[str, Any], ...], dict[Kernel, dict[str, Any]]] = {}


@contextmanager
def patched(patch: Mapping[str, Any]) -> Iterator[None]:
    """Give names ("module.NAME") other values within. A name that a module imported is changed there only.

    A function in the place of a kernel becomes one. Errors: AttributeError for a name that there is not.
    """
    if not patch:
        yield
        return
    with ExitStack() as stack:
        for name, value in patch.items():
            is_kernel = isinstance(resolve_name(f"{PACKAGE}.{name}"), Kernel)
            stack.enter_context(mock.patch(f"{PACKAGE}.{name}", Kernel(value) if is_kernel else value))
        kernels = _kernels()
        bound = _BOUND.setdefault(tuple(patch.items()), {})
        before = {kernel: dict(vars(kernel)) for kernel in kernels}
        for kernel in kernels:
            if kernel in bound:
                vars(kernel).update(bound[kernel])
            else:
                kernel.forget()
        try:
            yield
        finally:
            for kernel in kernels:
                bound[kernel] = dict(vars(kernel))
                vars(kernel).update(before[kernel])


def _kernels() -> set[Kernel]:
    modules = (module for name, module in sys.modules.items() if name.startswith(f"{PACKAGE}."))
    return {found for module in modules for found in vars(module).values() if isinstance(found, Kernel)}
