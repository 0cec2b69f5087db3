"""Types of a kernel's arguments as plain data, to be kept in a file and compiled from without any call.

A scalar or ``none`` is its name; an array ``["array", dtype, dimensions, layout, writable]``; tuples
``["tuple", ...]``; named tuples ``["named", "module:class", ...]``; a kernel ``["kernel", "module:name"]``.
"""

from importlib import import_module
from typing import Any

from numba import types as _types

from ground.jit import Kernel

types: Any = _types  # numba has no types that mypy could read
SCALARS = (types.Number, types.Boolean)
Plain = str | list[Any]


def plain(kind: Any) -> Plain:  # noqa: ANN401
    """Return a type as plain data; TypeError for one that no kernel of ours is called with."""
    if isinstance(kind, types.Array) and isinstance(kind.dtype, SCALARS):
        return ["array", str(kind.dtype), kind.ndim, kind.layout, kind.mutable]
    if isinstance(kind, types.BaseNamedTuple):
        made_by = kind.instance_class
        return ["named", f"{made_by.__module__}:{made_by.__qualname__}", *map(plain, kind.types)]
    if isinstance(kind, types.BaseTuple):
        return ["tuple", *map(plain, kind.types)]
    if isinstance(kind, types.Dispatcher):
        function = kind.dispatcher.py_func
        return ["kernel", f"{function.__module__}:{function.__qualname__}"]
    if isinstance(kind, (*SCALARS, types.NoneType)):
        return str(kind)
    raise TypeError(f"{kind} is no argument of a kernel")


def to_type(form: Plain) -> Any:  # noqa: ANN401
    """Return the type that plain data stands for."""
    if isinstance(form, str):
        return getattr(types, form)
    what, *parts = form
    if what == "array":
        dtype, dimensions, layout, writable = parts
        return types.Array(to_type(dtype), dimensions, layout, readonly=not writable)
    if what == "named":
        made_by, *of = parts
        kinds, first = [to_type(each) for each in of], look_up(made_by)
        alike = len(set(kinds)) == 1
        return types.NamedUniTuple(kinds[0], len(kinds), first) if alike else types.NamedTuple(kinds, first)
    if what == "tuple":
        return types.Tuple([to_type(each) for each in parts])
    return types.Dispatcher(look_up(parts[0]).dispatcher)


def look_up(place: str) -> Any:  # noqa: ANN401 - a kernel or a class
    """Return what ``module:name`` names."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def entry(place: str) -> Kernel:
    """Return the kernel that ``module:name`` names."""
    found = look_up(place)
    assert isinstance(found, Kernel), place
    return found
