"""`ground.jit.unowned` as numba compiles it."""

from collections.abc import Callable
from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic, overload
from numba.np.arrayobj import make_array

from ground.jit import unowned


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def _without_owner(typing_context: object, array: types.Type) -> tuple[Any, Callable[..., Any]]:
    """Copy an array's structure and leave out who owns the memory."""

    def build(context: object, builder: object, signature: Any, arguments: Any) -> object:  # noqa: ANN401
        copy = make_array(signature.return_type)(context, builder, value=arguments[0])  # type: ignore[no-untyped-call]
        copy.meminfo = cgutils.get_null_value(copy.meminfo.type)  # type: ignore[no-untyped-call]
        copy.parent = cgutils.get_null_value(copy.parent.type)  # type: ignore[no-untyped-call]
        return copy._getvalue()

    return array(array), build


@overload(unowned)
def _unowned(array: types.Type) -> Callable[[types.Type], object] | None:
    def compiled(array: types.Type) -> object:
        return _without_owner(array)  # type: ignore[call-arg]

    return compiled if isinstance(array, types.Array) else None
