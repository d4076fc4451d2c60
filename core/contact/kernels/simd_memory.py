"""Memory for `simd`: room on the stack, and loads and stores of vectors that do not lie in a row."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.np.arrayobj import populate_array

from .simd import FLOATS, INTS, LANES, VECTOR_OF, constant, intrinsic, pointer

_on_stack: Any = cgutils.alloca_once
_fill_in: Any = populate_array
_TRIPLE: Any = types.UniTuple


def _make_scratch(scalar: Any, count: int) -> Any:
    def scratch(typing: Any) -> Any:
        array_type = types.Array(scalar, 1, "C")

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            element = context.get_data_type(scalar)
            memory = _on_stack(builder, ir.ArrayType(element, count))
            memory.align = 64
            size = context.get_constant(types.intp, scalar.bitwidth // 8)
            length = context.get_constant(types.intp, count)
            array = context.make_array(array_type)(context, builder)
            data = builder.bitcast(memory, element.as_pointer())
            _fill_in(array, data, [length], [size], size, None)
            return array._getvalue()

        return array_type(), emit

    scratch.__doc__ = f"Return an array of {count} {scalar} on the stack, the same at each call in one kernel's run."
    return intrinsic(scratch)


def float_scratch(count: int) -> Any:
    """Return a function for kernels that gives room for so many float32; it holds anything at first."""
    return _make_scratch(types.float32, count)


def double_scratch(count: int) -> Any:
    """Return a function for kernels that gives room for so many float64; it holds anything at first."""
    return _make_scratch(types.float64, count)


def int_scratch(count: int) -> Any:
    """Return a function for kernels that gives room for so many int32; it holds anything at first."""
    return _make_scratch(types.int32, count)


@intrinsic
def gather(typing: Any, array: Any, indices: Any) -> Any:
    """Return ``array[indices]``, int32 indices; every lane must be a valid index."""
    vector = VECTOR_OF[array.dtype]

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(array)(context, builder, arguments[0]).data
        stored = ir.VectorType(context.get_data_type(array.dtype), LANES)
        value = ir.Constant(stored, ir.Undefined)
        for lane in range(LANES):
            number = ir.Constant(ir.IntType(32), lane)
            index = builder.zext(builder.extract_element(arguments[1], number), ir.IntType(64))
            value = builder.insert_element(value, builder.load(builder.gep(data, [index])), number)
        return value if stored == vector.llvm else builder.zext(value, vector.llvm)

    return vector(array, INTS), emit


def _channel(builder: Any, words: Any, number: int) -> Any:
    shifted = builder.lshr(words, constant(INTS, [8 * number] * LANES))
    return builder.and_(shifted, constant(INTS, [255] * LANES))


@intrinsic
def gather_colors(typing: Any, image: Any, pixels: Any) -> Any:
    """Return red, green and blue (int32) of some pixels of a flat uint8 image of at least four bytes."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(image)(context, builder, arguments[0]).data
        word, wide = ir.IntType(32), ir.IntType(64)
        words = ir.Constant(INTS.llvm, ir.Undefined)
        first = constant(INTS, [0] * LANES)
        is_first = builder.icmp_signed("==", arguments[1], first)
        # One load a pixel, from the byte before it, so that the last pixel's does not reach beyond the image.
        place = builder.sub(builder.mul(arguments[1], constant(INTS, [3] * LANES)), constant(INTS, [1] * LANES))
        place = builder.select(is_first, first, place)
        for lane in range(LANES):
            number = ir.Constant(word, lane)
            index = builder.zext(builder.extract_element(place, number), wide)
            loaded = builder.load(builder.bitcast(builder.gep(data, [index]), word.as_pointer()))
            loaded.align = 1
            words = builder.insert_element(words, loaded, number)
        words = builder.select(is_first, words, builder.lshr(words, constant(INTS, [8] * LANES)))
        return context.make_tuple(builder, signature.return_type, [_channel(builder, words, i) for i in range(3)])

    return _TRIPLE(INTS, 3)(image, INTS), emit


@intrinsic
def load_colors(typing: Any, image: Any, pixel: Any) -> Any:
    """Return red, green and blue (int32) of pixels ``pixel`` to ``pixel + LANES - 1`` of a flat uint8 image."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte = ir.IntType(8)
        index = builder.mul(arguments[1], ir.Constant(ir.IntType(64), 3))
        all_channels = ir.VectorType(byte, 3 * LANES)
        loaded = builder.load(pointer(context, builder, image, arguments[0], index, all_channels))
        loaded.align = 1
        channels = []
        for channel in range(3):
            order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [3 * lane + channel for lane in range(LANES)])
            picked = builder.shuffle_vector(loaded, ir.Constant(all_channels, ir.Undefined), order)
            channels.append(builder.zext(picked, INTS.llvm))
        return context.make_tuple(builder, signature.return_type, channels)

    return _TRIPLE(INTS, 3)(image, types.intp), emit


@intrinsic
def store_points(typing: Any, points: Any, index: Any, x: Any, y: Any, z: Any) -> Any:
    """Write `LANES` points to a flat float32 array of coordinates x, y, z, x, ... from element ``index`` on."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index, *planes = arguments

        def shuffled(a: Any, b: Any, order: list[int]) -> Any:
            numbers = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
            return builder.shuffle_vector(a, b, numbers)

        both = shuffled(planes[0], planes[1], list(range(2 * LANES)))
        depths = shuffled(planes[2], planes[2], list(range(2 * LANES)))
        mixed = shuffled(both, depths, [LANES * (i % 3) + i // 3 for i in range(3 * LANES)])
        stored = ir.VectorType(ir.FloatType(), 3 * LANES)
        instruction = builder.store(mixed, pointer(context, builder, points, array, index, stored))
        instruction.align = 4
        return context.get_dummy_value()

    return types.void(points, types.intp, FLOATS, FLOATS, FLOATS), emit


@intrinsic
def store_numbers(typing: Any, numbers: Any, index: Any, first: Any) -> Any:
    """Write ``first``, ``first + 1``, ... to `LANES` elements of an int64 array from ``index`` on."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index, first = arguments
        wide = ir.VectorType(ir.IntType(64), LANES)
        one = builder.insert_element(ir.Constant(wide, ir.Undefined), first, ir.Constant(ir.IntType(32), 0))
        order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        same = builder.shuffle_vector(one, ir.Constant(wide, ir.Undefined), order)
        values = builder.add(same, ir.Constant(wide, list(range(LANES))))
        instruction = builder.store(values, pointer(context, builder, numbers, array, index, wide))
        instruction.align = 8
        return context.get_dummy_value()

    return types.void(numbers, types.intp, types.int64), emit
