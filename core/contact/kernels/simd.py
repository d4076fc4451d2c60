"""Sixteen pixels at once: vector values for numba kernels.

LLVM does not vectorise the inner loops of the pipeline by itself, because they gather and select. A kernel therefore
works on vectors of `LANES` elements explicitly; LLVM splits them into the registers of the processor (one of AVX-512,
two of AVX2, four of SSE or NEON). Every operation is the IEEE operation of its element type, and nothing is contracted
or reordered (except in `multiply_add`), so a kernel gives the same bits on every machine.

All functions are for use inside ``@kernel`` functions only. Arrays must be one-dimensional and contiguous.
"""

from __future__ import annotations

import operator
from typing import Any, Final

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic as _numba_intrinsic
from numba.extending import models, overload, register_model
from numba.np.arrayobj import populate_array

#: numba annotates an intrinsic by what it emits, not by what a kernel calls.
intrinsic: Any = _numba_intrinsic

#: Elements of a vector.
LANES: Final = 16


class Vector(types.Type):
    """The type of a vector of `LANES` elements."""

    def __init__(self, name: str, element: ir.Type, scalar: types.Type) -> None:
        super().__init__(name=f"tactune.{name}x{LANES}")
        self.element = element
        self.scalar = scalar

    @property
    def llvm(self) -> ir.VectorType:
        """The LLVM type."""
        return ir.VectorType(self.element, LANES)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, vector.llvm)  # type: ignore[no-untyped-call]


FLOATS = Vector("float32", ir.FloatType(), types.float32)
DOUBLES = Vector("float64", ir.DoubleType(), types.float64)
INTS = Vector("int32", ir.IntType(32), types.int32)
FLAGS = Vector("bool", ir.IntType(1), types.boolean)
#: Unsigned, for raw counts; arithmetic wraps around.
COUNTS = Vector("uint16", ir.IntType(16), types.uint16)

#: Returns a function of the module; declares it if needed.
declare: Any = cgutils.get_or_insert_function

#: The vector type that elements of an array are loaded as.
VECTOR_OF = {
    types.float32: FLOATS,
    types.float64: DOUBLES,
    types.int32: INTS,
    types.uint16: INTS,
}


def constant(vector: Vector, values: Any) -> ir.Constant:
    """Return an LLVM constant vector with these values."""
    return ir.Constant(vector.llvm, list(values))


def pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, llvm: ir.Type) -> Any:
    """Return a pointer to the element ``index`` of an array, cast to a pointer to ``llvm``."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), llvm.as_pointer())


def _bytes_of(array_type: Any) -> int:
    return int(array_type.dtype.bitwidth // 8)


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """Return elements ``index`` to ``index + LANES - 1``; uint16 widens to int32."""
    vector = VECTOR_OF[array.dtype]

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        stored = ir.VectorType(context.get_data_type(array.dtype), LANES)
        value = builder.load(pointer(context, builder, array, arguments[0], arguments[1], stored))
        value.align = _bytes_of(array)
        return value if stored == vector.llvm else builder.zext(value, vector.llvm)

    return vector(array, types.intp), emit


@intrinsic
def load_counts(typing: Any, array: Any, index: Any) -> Any:
    """Return elements ``index`` to ``index + LANES - 1`` of a uint16 array without widening."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = builder.load(pointer(context, builder, array, arguments[0], arguments[1], COUNTS.llvm))
        value.align = _bytes_of(array)
        return value

    return COUNTS(array, types.intp), emit


@intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write a vector to elements ``index`` onwards; int32 narrows to the array's integer type."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, index, vector = arguments
        stored = ir.VectorType(context.get_data_type(array.dtype), LANES)
        if stored != value.llvm:
            vector = builder.trunc(vector, stored)
        instruction = builder.store(vector, pointer(context, builder, array, place, index, stored))
        instruction.align = _bytes_of(array)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), emit


def _splatted(builder: Any, vector: Vector, scalar: Any) -> Any:
    one = builder.insert_element(ir.Constant(vector.llvm, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(
        one, ir.Constant(vector.llvm, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


def _make_splat(vector: Vector, doc: str) -> Any:
    def splat(typing: Any, value: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _splatted(builder, vector, arguments[0])

        return vector(vector.scalar), emit

    splat.__doc__ = doc
    return intrinsic(splat)


floats = _make_splat(FLOATS, "Return a float32 vector with the same value in all lanes.")
doubles = _make_splat(DOUBLES, "Return a float64 vector with the same value in all lanes.")
ints = _make_splat(INTS, "Return an int32 vector with the same value in all lanes.")
counts = _make_splat(COUNTS, "Return a uint16 vector with the same value in all lanes.")


@intrinsic
def lane_numbers(typing: Any) -> Any:
    """Return 0, 1, ..., LANES - 1 as int32."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return constant(INTS, range(LANES))

    return INTS(), emit


def _binary(name: str, vectors: dict[Vector, str]) -> Any:
    def function(typing: Any, a: Any, b: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, vectors[a])(*arguments)

        return (a(a, a), emit) if a in vectors else None

    function.__name__ = name
    return intrinsic(function)


def _define_operator(symbol: Any, vectors: dict[Vector, str]) -> None:
    apply = _binary(f"_{symbol.__name__}", vectors)

    @overload(symbol, strict=False)
    def implementation(a: Any, b: Any) -> Any:
        if isinstance(a, Vector) and a == b and a in vectors:
            return lambda a, b: apply(a, b)  # noqa: PLW0108  # numba's overload needs a Python function
        return None


_define_operator(operator.add, {FLOATS: "fadd", DOUBLES: "fadd", INTS: "add", COUNTS: "add"})
_define_operator(operator.sub, {FLOATS: "fsub", DOUBLES: "fsub", INTS: "sub", COUNTS: "sub"})
_define_operator(operator.mul, {FLOATS: "fmul", DOUBLES: "fmul", INTS: "mul"})
_define_operator(operator.truediv, {FLOATS: "fdiv", DOUBLES: "fdiv"})
_define_operator(operator.and_, {FLAGS: "and_"})
_define_operator(operator.or_, {FLAGS: "or_"})
_define_operator(operator.xor, {FLAGS: "xor"})


def _define_comparison(symbol: Any, sign: str) -> None:
    def function(typing: Any, a: Any, b: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            if a is INTS:
                return builder.icmp_signed(sign, *arguments)
            compare = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
            return compare(sign, *arguments)

        return FLAGS(a, a), emit

    function.__name__ = f"_{symbol.__name__}"
    compare = intrinsic(function)

    @overload(symbol, strict=False)
    def implementation(a: Any, b: Any) -> Any:
        if isinstance(a, Vector) and a == b:
            return lambda a, b: compare(a, b)  # noqa: PLW0108  # numba's overload needs a Python function
        return None


for _symbol, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"),
    (operator.ge, ">="), (operator.eq, "=="), (operator.ne, "!="),
):  # fmt: skip
    _define_comparison(_symbol, _sign)


@intrinsic
def _not(typing: Any, a: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.not_(arguments[0])

    return FLAGS(FLAGS), emit


@overload(operator.invert, strict=False)
def _invert(a: Any) -> Any:
    if a is FLAGS:
        return lambda a: _not(a)  # noqa: PLW0108  # numba's overload needs a Python function
    return None


@intrinsic
def where(typing: Any, flags: Any, a: Any, b: Any) -> Any:
    """Return ``a`` in the lanes that are flagged and ``b`` in the others."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return a(FLAGS, a, a), emit


def _conversion(source: Vector, target: Vector, instruction: str, doc: str) -> Any:
    def convert(typing: Any, a: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(arguments[0], target.llvm)

        return target(source), emit

    convert.__doc__ = doc
    return intrinsic(convert)


to_floats = _conversion(INTS, FLOATS, "sitofp", "Convert int32 to float32.")
to_doubles = _conversion(FLOATS, DOUBLES, "fpext", "Widen float32 to float64.")
#: The lanes must hold values that fit.
to_ints = _conversion(FLOATS, INTS, "fptosi", "Convert float32 to int32, towards zero.")
as_ints = _conversion(FLAGS, INTS, "sext", "Return -1 in the flagged lanes and 0 in the others.")


def _unary(llvm_name: str, doc: str) -> Any:
    def function(typing: Any, a: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            name = f"{llvm_name}.v{LANES}{a.element.intrinsic_name}"
            function = declare(builder.module, ir.FunctionType(a.llvm, [a.llvm]), name)
            return builder.call(function, arguments)

        return a(a), emit

    function.__doc__ = doc
    return intrinsic(function)


sqrt = _unary("llvm.sqrt", "Square root, correctly rounded.")
floor = _unary("llvm.floor", "The largest whole number not above.")
absolute = _unary("llvm.fabs", "Absolute value.")


@intrinsic
def multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return ``a * b + c``, fused if the processor can do that: the last bit may differ between processors."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        product = builder.fmul(arguments[0], arguments[1], flags=("contract",))
        return builder.fadd(product, arguments[2], flags=("contract",))

    return a(a, a, a), emit


@intrinsic
def shift_right(typing: Any, a: Any, distance: Any) -> Any:
    """Return int32 lanes shifted right arithmetically, all by the same number of bits."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        narrow = builder.trunc(arguments[1], INTS.element)
        return builder.ashr(arguments[0], _splatted(builder, INTS, narrow))

    return INTS(INTS, types.int64), emit


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


def _of_counts(llvm_name: str, arguments: int, result: Any, doc: str) -> Any:
    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        llvm = COUNTS.llvm if result is COUNTS else COUNTS.element
        of_type = ir.FunctionType(llvm, [COUNTS.llvm] * arguments)
        return builder.call(declare(builder.module, of_type, f"{llvm_name}.v{LANES}i16"), values)

    def one(typing: Any, a: Any) -> Any:
        return result(COUNTS), emit

    def two(typing: Any, a: Any, b: Any) -> Any:
        return result(COUNTS, COUNTS), emit

    function = one if arguments == 1 else two
    function.__doc__ = doc
    return intrinsic(function)


lesser_counts = _of_counts("llvm.umin", 2, COUNTS, "Return the smaller of each pair of counts.")
greater_counts = _of_counts("llvm.umax", 2, COUNTS, "Return the larger of each pair of counts.")
least_count = _of_counts("llvm.vector.reduce.umin", 1, types.uint16, "Return the smallest count of all lanes.")
largest_count = _of_counts("llvm.vector.reduce.umax", 1, types.uint16, "Return the largest count of all lanes.")


@intrinsic
def bits(typing: Any, flags: Any) -> Any:
    """Return the flags as an integer, lane 0 in the lowest bit."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.bitcast(arguments[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(FLAGS), emit


@intrinsic
def flags(typing: Any, number: Any) -> Any:
    """Return the lowest `LANES` bits of an integer as flags; the inverse of `bits`."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        narrow = builder.trunc(arguments[0], ir.IntType(LANES))
        return builder.bitcast(narrow, FLAGS.llvm)

    return FLAGS(types.int64), emit


@intrinsic
def count_trailing_zeros(typing: Any, number: Any) -> Any:
    """Return the number of the lowest bit set in an int64 that is not 0."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), emit


@intrinsic
def count_ones(typing: Any, number: Any) -> Any:
    """Return the number of bits of an int64 that are set."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.int64(types.int64), emit


@intrinsic
def total(typing: Any, a: Any) -> Any:
    """Return the sum of all lanes, added pairwise in a fixed order."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = [builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), lane)) for lane in range(LANES)]
        add = builder.add if a is INTS else builder.fadd
        while len(values) > 1:
            half = len(values) // 2
            values = [add(values[i], values[i + half]) for i in range(half)]
        return values[0]

    return a.scalar(a), emit


_fill_in: Any = populate_array
_TRIPLE: Any = types.UniTuple


def _make_scratch(scalar: Any, count: int) -> Any:
    def scratch(typing: Any) -> Any:
        array_type = types.Array(scalar, 1, "C")

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            element = context.get_data_type(scalar)
            with builder.goto_entry_block():  # numba's own alloca_once writes zeros, which costs LLVM half a minute
                memory = builder.alloca(ir.ArrayType(element, count))
            memory.align = 64
            size = context.get_constant(types.intp, scalar.bitwidth // 8)
            length = context.get_constant(types.intp, count)
            array = context.make_array(array_type)(context, builder)
            data = builder.bitcast(memory, element.as_pointer())
            _fill_in(array, data, [length], [size], size, None)
            return array._getvalue()

        return array_type(), emit

    scratch.__doc__ = f"Return a stack array of {count} {scalar}, the same array at each call in one kernel run."
    return intrinsic(scratch)


def float_scratch(count: int) -> Any:
    """Return a function for kernels that allocates ``count`` uninitialised float32 on the stack."""
    return _make_scratch(types.float32, count)


def double_scratch(count: int) -> Any:
    """Return a function for kernels that allocates ``count`` uninitialised float64 on the stack."""
    return _make_scratch(types.float64, count)


def int_scratch(count: int) -> Any:
    """Return a function for kernels that allocates ``count`` uninitialised int32 on the stack."""
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
    """Return red, green and blue (int32) of pixels of a flat uint8 image with at least four bytes."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(image)(context, builder, arguments[0]).data
        word, wide = ir.IntType(32), ir.IntType(64)
        words = ir.Constant(INTS.llvm, ir.Undefined)
        first = constant(INTS, [0] * LANES)
        is_first = builder.icmp_signed("==", arguments[1], first)
        # One load of four bytes per pixel, from the byte before it: the load of the last pixel stays inside the image.
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
