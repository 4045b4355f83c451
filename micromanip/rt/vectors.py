"""Vectorised LLVM code for ``sums.py`` without checks of the indices; imported by ``built_in.py``."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array

from .sums import LANES, ROWS_AT_ONCE, advance_model, correct, weighted

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_NONE = ir.Constant(_VECTOR, ir.Undefined)
_NUMBER = ir.IntType(64)


type_callable(advance_model)(lambda _: lambda a, b, u, x, scratch, n: signature(types.none, a, b, u, x, scratch, n))
type_callable(weighted)(lambda _: lambda weights, x, n: signature(types.float64, weights, x, n))
type_callable(correct)(lambda _: lambda e, gain, by, f, x, n: signature(types.none, e, gain, by, f, x, n))


def _data(context: Any, builder: Any, sig: Any, args: Any, *which: int) -> Any:
    return (make_array(sig.args[k])(context, builder, args[k]).data for k in which)


def _splat(builder: Any, number: Any) -> Any:
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(builder.insert_element(_NONE, number, ir.IntType(32)(0)), _NONE, zeros)


def _load(builder: Any, array: Any, first: Any) -> Any:
    return builder.load(builder.bitcast(builder.gep(array, [first]), _VECTOR.as_pointer()), align=8)


def _store(builder: Any, taken: Any, array: Any, first: Any) -> None:
    builder.store(taken, builder.bitcast(builder.gep(array, [first]), _VECTOR.as_pointer()), align=8)


@lower_builtin(advance_model, types.Array, types.Array, types.Float, types.Array, types.Array, types.Integer)
def _advance_model(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Sums of `ROWS_AT_ONCE` rows stay in registers while the columns pass; the rows beyond them come first."""
    u, count = args[2], args[5]
    blocks, b, x, scratch = _data(context, builder, sig, args, 0, 1, 3, 4)
    places = range(0, ROWS_AT_ONCE, LANES)
    sums = [cgutils.alloca_once(builder, _VECTOR) for _ in places]
    block_size = sig.args[0].shape[1] * ROWS_AT_ONCE

    def advance(block: int, target: Any) -> None:
        first = block * ROWS_AT_ONCE
        for total, place in zip(sums, places, strict=True):
            builder.store(builder.fmul(_load(builder, b, _NUMBER(first + place)), _splat(builder, u)), total)
        with cgutils.for_range(builder, count) as loop:
            factor = _splat(builder, builder.load(builder.gep(x, [loop.index])))
            column = builder.add(_NUMBER(block * block_size), builder.mul(loop.index, _NUMBER(ROWS_AT_ONCE)))
            for total, place in zip(sums, places, strict=True):
                term = builder.fmul(_load(builder, blocks, builder.add(column, _NUMBER(place))), factor)
                builder.store(builder.fadd(builder.load(total), term), total)
        for total, place in zip(sums, places, strict=True):
            _store(builder, builder.load(total), target, _NUMBER(first + place))

    for block in range(1, sig.args[0].shape[0]):
        with builder.if_then(builder.icmp_signed(">", count, _NUMBER(block * ROWS_AT_ONCE)), likely=False):
            advance(block, scratch)
    advance(0, x)
    with builder.if_then(builder.icmp_signed(">", count, _NUMBER(ROWS_AT_ONCE)), likely=False):
        for place in range(ROWS_AT_ONCE, sig.args[0].shape[1], LANES):
            _store(builder, _load(builder, scratch, _NUMBER(place)), x, _NUMBER(place))
    return context.get_dummy_value()


@lower_builtin(weighted, types.Array, types.Array, types.Integer)
def _weighted(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    weights, x = _data(context, builder, sig, args, 0, 1)
    sums = cgutils.alloca_once_value(builder, ir.Constant(_VECTOR, [0.0] * LANES))
    whole = builder.and_(args[2], _NUMBER(-LANES))
    with cgutils.for_range_slice(builder, _NUMBER(0), whole, _NUMBER(LANES), inc=True) as (first, _):
        term = builder.fmul(_load(builder, weights, first), _load(builder, x, first))
        builder.store(builder.fadd(builder.load(sums), term), sums)
    lane = [builder.extract_element(builder.load(sums), ir.IntType(32)(k)) for k in range(LANES)]
    total = cgutils.alloca_once_value(
        builder, builder.fadd(builder.fadd(lane[0], lane[2]), builder.fadd(lane[1], lane[3]))
    )
    with cgutils.for_range_slice(builder, whole, args[2], _NUMBER(1), inc=True) as (place, _):
        weight, value = (builder.load(builder.gep(array, [place])) for array in (weights, x))
        builder.store(builder.fadd(builder.load(total), builder.fmul(weight, value)), total)
    return builder.load(total)


@lower_builtin(correct, types.Array, types.Array, types.Float, types.Array, types.Array, types.Integer)
def _correct(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    expected, gain, filtered, x = _data(context, builder, sig, args, 0, 1, 3, 4)
    factor = _splat(builder, args[2])
    with cgutils.for_range_slice(builder, _NUMBER(0), args[5], _NUMBER(LANES), inc=True) as (first, _):
        term = builder.fmul(_load(builder, gain, first), factor)
        corrected = builder.fadd(_load(builder, expected, first), term)
        _store(builder, corrected, filtered, first)
        _store(builder, corrected, x, first)
    return context.get_dummy_value()
