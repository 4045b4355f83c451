"""Machine code for ``sums.py``, of vectors and without a look at each index; imported by ``built_in.py``."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array

from .sums import ROWS_AT_ONCE, advance_model, weighted

_LANES = 4
_VECTOR = ir.VectorType(ir.DoubleType(), _LANES)


type_callable(advance_model)(lambda _: lambda a, b, u, x, scratch, n: signature(types.none, a, b, u, x, scratch, n))
type_callable(weighted)(lambda _: lambda total, weights, x, n: signature(types.float64, total, weights, x, n))


@lower_builtin(advance_model, types.Array, types.Array, types.Float, types.Array, types.Array, types.Integer)
def _advance_model(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Sums of `ROWS_AT_ONCE` rows stay in registers while the columns pass."""
    u, count = args[2], args[5]
    a_columns, b, x, scratch = (make_array(sig.args[k])(context, builder, args[k]).data for k in (0, 1, 3, 4))
    column = ir.Constant(ir.IntType(64), sig.args[0].shape[1])

    def splat(number: Any) -> Any:
        one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
        return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), zeros)

    def places(array: Any, first: Any) -> list[Any]:
        firsts = (builder.add(first, ir.Constant(first.type, k)) for k in range(0, ROWS_AT_ONCE, _LANES))
        return [builder.bitcast(builder.gep(array, [each]), _VECTOR.as_pointer()) for each in firsts]

    sums = [cgutils.alloca_once(builder, _VECTOR) for _ in range(0, ROWS_AT_ONCE, _LANES)]
    rows_at_once = ir.Constant(count.type, ROWS_AT_ONCE)
    with cgutils.for_range_slice(builder, ir.Constant(count.type, 0), count, rows_at_once, inc=True) as (first, _):
        for total, place in zip(sums, places(b, first), strict=True):
            builder.store(builder.fmul(builder.load(place, align=8), splat(u)), total)
        with cgutils.for_range(builder, count) as loop:
            factor = splat(builder.load(builder.gep(x, [loop.index])))
            column_places = places(a_columns, builder.add(first, builder.mul(loop.index, column)))
            for total, place in zip(sums, column_places, strict=True):
                term = builder.fmul(builder.load(place, align=8), factor)
                builder.store(builder.fadd(builder.load(total), term), total)
        for total, place in zip(sums, places(scratch, first), strict=True):
            builder.store(builder.load(total), place, align=8)
    with cgutils.for_range_slice(builder, ir.Constant(count.type, 0), count, rows_at_once, inc=True) as (first, _):
        for taken, place in zip(places(scratch, first), places(x, first), strict=True):
            builder.store(builder.load(taken, align=8), place, align=8)
    return context.get_dummy_value()


@lower_builtin(weighted, types.Float, types.Array, types.Array, types.Integer)
def _weighted(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Four terms a turn, then those that are left."""
    count = args[3]
    weights, x = (make_array(sig.args[k])(context, builder, args[k]).data for k in (1, 2))
    total = cgutils.alloca_once_value(builder, args[0])

    def add_terms(first: Any, terms: int) -> None:
        for k in range(terms):
            place = builder.add(first, ir.Constant(first.type, k))
            weight, value = (builder.load(builder.gep(array, [place])) for array in (weights, x))
            builder.store(builder.fadd(builder.load(total), builder.fmul(weight, value)), total)

    whole = builder.and_(count, ir.Constant(count.type, -_LANES))
    steps = [ir.Constant(count.type, step) for step in (0, 1, _LANES)]
    with cgutils.for_range_slice(builder, steps[0], whole, steps[2], inc=True) as (first, _):
        add_terms(first, _LANES)
    with cgutils.for_range_slice(builder, whole, count, steps[1], inc=True) as (first, _):
        add_terms(first, 1)
    return builder.load(total)
