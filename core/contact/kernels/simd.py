"""Sixteen pixels at once: vector values for numba kernels.

LLVM does not vectorise the inner loops of the pipeline by itself, because they gather and select. A kernel therefore
works on vectors of `LANES` elements explicitly; LLVM splits them into the registers of the processor (one of AVX-512,
two of AVX2, four of SSE or NEON). Every operation is the IEEE operation of its element type, and nothing is contracted
or reordered (except in `multiply_add`), so a kernel gives the same bits on every machine.

All functions are for use inside ``@kernel`` functions only. Arrays must be one-dimensional and contiguous.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic as _numba_intrinsic
from numba.extending import models, overload, register_model
from numba.np.arrayobj import populate_array

#: Elements of a vector.
LANES: Final = 16

_WORD, _WIDE = ir.IntType(32), ir.IntType(64)
_tuple_of: Any = types.UniTuple
_declared: Any = cgutils.get_or_insert_function
_fill_in: Any = populate_array


class Vector(types.Type):
    """The type of a vector of `LANES` elements."""

    def __init__(self, name: str, element: ir.Type, scalar: types.Type) -> None:
        super().__init__(name=f"tactune.{name}x{LANES}")
        self.element, self.scalar = element, scalar

    @property
    def llvm(self) -> ir.VectorType:
        return ir.VectorType(self.element, LANES)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, vector.llvm)  # type: ignore[no-untyped-call]


FLOATS = Vector("float32", ir.FloatType(), types.float32)
DOUBLES = Vector("float64", ir.DoubleType(), types.float64)
INTS = Vector("int32", _WORD, types.int32)
FLAGS = Vector("bool", ir.IntType(1), types.boolean)
#: Unsigned, for raw counts; arithmetic wraps around.
COUNTS = Vector("uint16", ir.IntType(16), types.uint16)

#: The vector type that elements of an array are loaded as.
_VECTOR_OF = {types.float32: FLOATS, types.float64: DOUBLES, types.int32: INTS, types.uint16: INTS}


def _array_operation(typed: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function for kernels of one that returns the LLVM value.

    That one takes numba's context, the builder, the signature, and the arguments' values. ``typed`` returns the
    signature of types for the arguments' types; None if there is no such operation.
    """

    def decorate(emit: Callable[..., Any]) -> Any:
        def function(typing: Any, *arguments: Any) -> Any:
            signature = typed(*arguments)
            return signature and (signature, lambda context, builder, sig, values: emit(context, builder, sig, *values))

        named = inspect.Parameter("typing", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        parameters = [named, *inspect.signature(typed).parameters.values()]  # numba counts the arguments by them
        function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        function.__doc__ = emit.__doc__
        return _numba_intrinsic(function)

    return decorate


def _operation(doc: str, typed: Callable[..., Any], emit: Callable[..., Any]) -> Any:
    """Return a function for kernels; ``emit`` returns its LLVM value from the builder and the arguments' values."""

    def function(context: Any, builder: Any, signature: Any, *values: Any) -> Any:
        return emit(builder, *values)

    function.__doc__ = doc
    return _array_operation(typed)(function)


def _constant(vector: Vector, values: Any) -> ir.Constant:
    return ir.Constant(vector.llvm, list(values))


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, llvm: ir.Type) -> Any:
    """Return a pointer to the element ``index`` of an array, cast to a pointer to ``llvm``."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), llvm.as_pointer())


def _same_in_all(builder: Any, llvm: ir.VectorType, scalar: Any) -> Any:
    nothing = ir.Constant(llvm, ir.Undefined)
    one = builder.insert_element(nothing, scalar, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(one, nothing, _constant(INTS, [0] * LANES))


# Loading and storing


def _load(context: Any, builder: Any, signature: Any, array: Any, index: Any) -> Any:
    array_type, vector = signature.args[0], signature.return_type
    stored = ir.VectorType(context.get_data_type(array_type.dtype), LANES)
    value = builder.load(_pointer(context, builder, array_type, array, index, stored))
    value.align = array_type.dtype.bitwidth // 8
    return value if stored == vector.llvm else builder.zext(value, vector.llvm)


#: Elements ``index`` to ``index + LANES - 1``; uint16 widens to int32, and without widening.
load = _array_operation(lambda array, index: _VECTOR_OF[array.dtype](array, types.intp))(_load)
load_counts = _array_operation(lambda array, index: COUNTS(array, types.intp))(_load)


def _store(context: Any, builder: Any, signature: Any, array: Any, index: Any, *values: Any) -> Any:
    array_type, value = signature.args[0], values[0]
    stored = ir.VectorType(context.get_data_type(array_type.dtype), value.type.count)
    if stored != value.type:
        value = builder.trunc(value, stored)
    instruction = builder.store(value, _pointer(context, builder, array_type, array, index, stored))
    instruction.align = array_type.dtype.bitwidth // 8
    return context.get_dummy_value()


#: Writes a vector to elements ``index`` onwards; int32 narrows to the array's integer type.
store = _array_operation(lambda array, index, value: types.void(array, types.intp, value))(_store)


@_array_operation(lambda points, index, x, y, z: types.void(points, types.intp, FLOATS, FLOATS, FLOATS))
def store_points(context: Any, builder: Any, signature: Any, points: Any, index: Any, x: Any, y: Any, z: Any) -> Any:
    """Write `LANES` points to a flat float32 array of coordinates x, y, z, x, ... from element ``index`` on."""

    def shuffled(a: Any, b: Any, order: list[int]) -> Any:
        return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_WORD, len(order)), order))

    both = shuffled(x, y, list(range(2 * LANES)))
    depths = shuffled(z, z, list(range(2 * LANES)))
    mixed = shuffled(both, depths, [LANES * (i % 3) + i // 3 for i in range(3 * LANES)])
    return _store(context, builder, signature, points, index, mixed)


@_array_operation(lambda numbers, index, first: types.void(numbers, types.intp, types.int64))
def store_numbers(context: Any, builder: Any, signature: Any, numbers: Any, index: Any, first: Any) -> Any:
    """Write ``first``, ``first + 1``, ... to `LANES` elements of an int64 array from ``index`` on."""
    wide = ir.VectorType(_WIDE, LANES)
    values = builder.add(_same_in_all(builder, wide, first), ir.Constant(wide, list(range(LANES))))
    return _store(context, builder, signature, numbers, index, values)


@_array_operation(lambda array, indices: _VECTOR_OF[array.dtype](array, INTS))
def gather(context: Any, builder: Any, signature: Any, array: Any, indices: Any) -> Any:
    """Return ``array[indices]``, int32 indices; every lane must be a valid index."""
    array_type, vector = signature.args[0], signature.return_type
    data = context.make_array(array_type)(context, builder, array).data
    stored = ir.VectorType(context.get_data_type(array_type.dtype), LANES)
    value = ir.Constant(stored, ir.Undefined)
    for lane in range(LANES):
        number = ir.Constant(_WORD, lane)
        index = builder.zext(builder.extract_element(indices, number), _WIDE)
        value = builder.insert_element(value, builder.load(builder.gep(data, [index])), number)
    return value if stored == vector.llvm else builder.zext(value, vector.llvm)


@_array_operation(lambda image, pixels: _tuple_of(INTS, 3)(image, INTS))
def gather_colors(context: Any, builder: Any, signature: Any, image: Any, pixels: Any) -> Any:
    """Return red, green and blue (int32) of pixels of a flat uint8 image with at least four bytes."""
    data = context.make_array(signature.args[0])(context, builder, image).data
    words, first = ir.Constant(INTS.llvm, ir.Undefined), _constant(INTS, [0] * LANES)
    is_first = builder.icmp_signed("==", pixels, first)
    # One load of four bytes per pixel, from the byte before it: the load of the last pixel stays inside the image.
    place = builder.sub(builder.mul(pixels, _constant(INTS, [3] * LANES)), _constant(INTS, [1] * LANES))
    place = builder.select(is_first, first, place)
    for lane in range(LANES):
        number = ir.Constant(_WORD, lane)
        index = builder.zext(builder.extract_element(place, number), _WIDE)
        loaded = builder.load(builder.bitcast(builder.gep(data, [index]), _WORD.as_pointer()))
        loaded.align = 1
        words = builder.insert_element(words, loaded, number)
    words = builder.select(is_first, words, builder.lshr(words, _constant(INTS, [8] * LANES)))
    byte = _constant(INTS, [255] * LANES)
    channels = [builder.and_(builder.lshr(words, _constant(INTS, [shift] * LANES)), byte) for shift in (0, 8, 16)]
    return context.make_tuple(builder, signature.return_type, channels)


@_array_operation(lambda image, pixel: _tuple_of(INTS, 3)(image, types.intp))
def load_colors(context: Any, builder: Any, signature: Any, image: Any, pixel: Any) -> Any:
    """Return red, green and blue (int32) of pixels ``pixel`` to ``pixel + LANES - 1`` of a flat uint8 image."""
    index = builder.mul(pixel, ir.Constant(_WIDE, 3))
    all_channels = ir.VectorType(ir.IntType(8), 3 * LANES)
    loaded = builder.load(_pointer(context, builder, signature.args[0], image, index, all_channels))
    loaded.align = 1
    nothing, channels = ir.Constant(all_channels, ir.Undefined), []
    for channel in range(3):
        order = _constant(INTS, [3 * lane + channel for lane in range(LANES)])
        channels.append(builder.zext(builder.shuffle_vector(loaded, nothing, order), INTS.llvm))
    return context.make_tuple(builder, signature.return_type, channels)


def _scratch_of(scalar: Any, count: int) -> Any:
    array_type = types.Array(scalar, 1, "C")

    def emit(context: Any, builder: Any, signature: Any) -> Any:
        element = context.get_data_type(scalar)
        with builder.goto_entry_block():  # numba's own alloca_once writes zeros, which costs LLVM half a minute
            memory = builder.alloca(ir.ArrayType(element, count))
        memory.align = 64
        size = context.get_constant(types.intp, scalar.bitwidth // 8)
        array = context.make_array(array_type)(context, builder)
        data = builder.bitcast(memory, element.as_pointer())
        _fill_in(array, data, [context.get_constant(types.intp, count)], [size], size, None)
        return array._getvalue()

    return _array_operation(lambda: array_type())(emit)  # noqa: PLW0108  # numba types the call of a function


#: Each returns a function for kernels that allocates ``count`` uninitialised elements on the stack.
float_scratch, double_scratch, int_scratch = (
    partial(_scratch_of, scalar) for scalar in (types.float32, types.float64, types.int32)
)


# Arithmetic


def _splat(vector: Vector) -> Any:
    doc = f"Return a {vector.name} vector with the same value in all lanes."
    return _operation(doc, lambda value: vector(vector.scalar), lambda b, value: _same_in_all(b, vector.llvm, value))


floats, doubles, ints, counts = (_splat(vector) for vector in (FLOATS, DOUBLES, INTS, COUNTS))
lane_numbers = _operation(
    "Return 0 to LANES - 1 as int32.",
    lambda: INTS(),  # noqa: PLW0108  # its signature has no argument
    lambda builder: _constant(INTS, range(LANES)),
)


def _define(symbol: Any, vectors: tuple[Vector, ...], result: Any, emit: Callable[..., Any]) -> None:
    """Define a Python operator for pairs of vectors of these types."""
    apply = _operation(symbol.__name__, lambda a, b: (result or a)(a, a), emit)

    @overload(symbol, strict=False)
    def implementation(a: Any, b: Any) -> Any:
        if a == b and a in vectors:
            return lambda a, b: apply(a, b)  # noqa: PLW0108  # numba's overload needs a Python function
        return None


def _either(of_floats: str, of_ints: str) -> Callable[..., Any]:
    """Return what emits one instruction for floats and another one for integers."""
    return lambda b, x, y: getattr(b, of_ints if isinstance(x.type.element, ir.IntType) else of_floats)(x, y)


_define(operator.add, (FLOATS, DOUBLES, INTS, COUNTS), None, _either("fadd", "add"))
_define(operator.sub, (FLOATS, DOUBLES, INTS, COUNTS), None, _either("fsub", "sub"))
_define(operator.mul, (FLOATS, DOUBLES, INTS), None, _either("fmul", "mul"))
_define(operator.truediv, (FLOATS, DOUBLES), None, lambda b, x, y: b.fdiv(x, y))
_define(operator.and_, (FLAGS,), None, lambda b, x, y: b.and_(x, y))
_define(operator.or_, (FLAGS,), None, lambda b, x, y: b.or_(x, y))
_define(operator.xor, (FLAGS,), None, lambda b, x, y: b.xor(x, y))


def _comparison(sign: str) -> Callable[..., Any]:
    def emit(builder: Any, x: Any, y: Any) -> Any:
        if isinstance(x.type.element, ir.IntType):
            return builder.icmp_signed(sign, x, y)
        return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, x, y)

    return emit


for _symbol, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"),
    (operator.ge, ">="), (operator.eq, "=="), (operator.ne, "!="),
):  # fmt: skip
    _define(_symbol, (FLOATS, DOUBLES, INTS), FLAGS, _comparison(_sign))

_not = _operation("Return the opposite flags.", lambda a: FLAGS(FLAGS), lambda b, a: b.not_(a))


@overload(operator.invert, strict=False)
def _invert(a: Any) -> Any:
    return (lambda a: _not(a)) if a is FLAGS else None  # noqa: PLW0108  # numba's overload needs a Python function


where = _operation(
    "Return ``a`` in the lanes that are flagged and ``b`` in the others.",
    lambda flags, a, b: a(FLAGS, a, a),
    lambda builder, flags, a, b: builder.select(flags, a, b),
)


def lesser(a: Any, b: Any) -> Any:
    """Return the smaller of each pair."""


def greater(a: Any, b: Any) -> Any:
    """Return the larger of each pair."""


@overload(lesser, strict=False)
def _lesser(a: Any, b: Any) -> Any:
    return lambda a, b: where(a < b, a, b)


@overload(greater, strict=False)
def _greater(a: Any, b: Any) -> Any:
    return lambda a, b: where(a > b, a, b)


def _conversion(doc: str, source: Vector, target: Vector, instruction: str) -> Any:
    return _operation(doc, lambda a: target(source), lambda b, a: getattr(b, instruction)(a, target.llvm))


to_floats = _conversion("Convert int32 to float32.", INTS, FLOATS, "sitofp")
to_doubles = _conversion("Widen float32 to float64.", FLOATS, DOUBLES, "fpext")
to_ints = _conversion("Convert float32 to int32, towards zero; the values must fit.", FLOATS, INTS, "fptosi")
as_ints = _conversion("Return -1 in the flagged lanes and 0 in the others.", FLAGS, INTS, "sext")


def _called(doc: str, name: str, typed: Callable[..., Any], result: Callable[..., Any] = lambda llvm: llvm) -> Any:
    """Return a function that calls an LLVM intrinsic of vectors of one type."""

    def emit(builder: Any, *values: Any) -> Any:
        llvm = values[0].type
        of = ir.FunctionType(result(llvm), [value.type for value in values])
        full_name = f"{name}.v{LANES}{llvm.element.intrinsic_name}"
        return builder.call(_declared(builder.module, of, full_name), values)

    return _operation(doc, typed, emit)


sqrt = _called("Square root, correctly rounded.", "llvm.sqrt", lambda a: a(a))
floor = _called("The largest whole number not above.", "llvm.floor", lambda a: a(a))
absolute = _called("Absolute value.", "llvm.fabs", lambda a: a(a))
lesser_counts = _called("Return the smaller of each pair of counts.", "llvm.umin", lambda a, b: COUNTS(COUNTS, COUNTS))
greater_counts = _called("Return the larger of each pair of counts.", "llvm.umax", lambda a, b: COUNTS(COUNTS, COUNTS))
least_count = _called(
    "Return the smallest count of all lanes.", "llvm.vector.reduce.umin", lambda a: types.uint16(COUNTS),
    lambda llvm: llvm.element,
)  # fmt: skip
largest_count = _called(
    "Return the largest count of all lanes.", "llvm.vector.reduce.umax", lambda a: types.uint16(COUNTS),
    lambda llvm: llvm.element,
)  # fmt: skip

multiply_add = _operation(
    "Return ``a * b + c``, fused if the processor can do that: the last bit may differ between processors.",
    lambda a, b, c: a(a, a, a),
    lambda builder, a, b, c: builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",)),
)
shift_right = _operation(
    "Return int32 lanes shifted right arithmetically, all by the same number of bits.",
    lambda a, distance: INTS(INTS, types.int64),
    lambda builder, a, distance: builder.ashr(a, _same_in_all(builder, INTS.llvm, builder.trunc(distance, _WORD))),
)
bits = _operation(
    "Return the flags as an integer, lane 0 in the lowest bit.",
    lambda flags: types.int64(FLAGS),
    lambda builder, flags: builder.zext(builder.bitcast(flags, ir.IntType(LANES)), _WIDE),
)
flags = _operation(
    "Return the lowest `LANES` bits of an integer as flags; the inverse of `bits`.",
    lambda number: FLAGS(types.int64),
    lambda builder, number: builder.bitcast(builder.trunc(number, ir.IntType(LANES)), FLAGS.llvm),
)
count_trailing_zeros = _operation(
    "Return the number of the lowest bit set in an int64 that is not 0.",
    lambda number: types.int64(types.int64),
    lambda builder, number: builder.cttz(number, ir.Constant(ir.IntType(1), 1)),
)
count_ones = _operation(
    "Return the number of bits of an int64 that are set.",
    lambda number: types.int64(types.int64),
    lambda builder, number: builder.ctpop(number),
)


def _total(builder: Any, a: Any) -> Any:
    values = [builder.extract_element(a, ir.Constant(_WORD, lane)) for lane in range(LANES)]
    add = builder.add if isinstance(a.type.element, ir.IntType) else builder.fadd
    while len(values) > 1:
        half = len(values) // 2
        values = [add(values[i], values[i + half]) for i in range(half)]
    return values[0]


total = _operation("Return the sum of all lanes, added pairwise in a fixed order.", lambda a: a.scalar(a), _total)
