"""Vector instructions: LLVM code in which every value is one number for each of some lanes."""

import functools
from typing import Any

import numpy as np
from llvmlite import ir

from .interface import Unsupported

LONGEST = 300_000  # instructions; longer code takes more time to compile than to run

FLOAT = {name: f"f{name}" for name in ("add", "sub", "mul", "div", "rem")} | {"add_any": "fadd"}
INTEGER = {"add": "add", "add_any": "add", "sub": "sub", "mul": "mul"}
COMPARE = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
BITWISE = {"and": "and_", "or": "or_", "xor": "xor", "not": "not_"}
TYPES = {"float64": ir.DoubleType(), "float32": ir.FloatType()}
TYPES |= {"int64": ir.IntType(64), "int32": ir.IntType(32), "bool": ir.IntType(1)}


class VectorBuilder:
    """A writer of the instructions of one function; values are vectors of `width` lanes."""

    def __init__(self, builder: ir.IRBuilder, width: int):
        self.builder, self.width, self.instructions = builder, width, 0

    def vector(self, dtype: Any) -> ir.VectorType:
        name = np.dtype(dtype).name
        if name not in TYPES:
            raise Unsupported(f"numbers of type {name}")
        return ir.VectorType(TYPES[name], self.width)

    def constant(self, number: Any, dtype: Any) -> ir.Constant:
        kind = self.vector(dtype)
        python = np.asarray(number, dtype).item()
        return ir.Constant(kind, [ir.Constant(kind.element, python)] * self.width)

    def _count(self, value: Any) -> Any:
        self.instructions += 1
        if self.instructions > LONGEST:
            raise Unsupported(f"more than {LONGEST} instructions")
        return value

    def function(self, name: str, *args: Any, flags: tuple[str, ...] = ()) -> Any:
        """Call an intrinsic of LLVM, lane by lane."""
        kind = args[0].type
        suffix = f"v{self.width}{'f64' if kind.element == ir.DoubleType() else 'f32'}"
        module = self.builder.module
        full = f"llvm.{name}.{suffix}"
        intrinsic = module.globals.get(full)
        if intrinsic is None:
            intrinsic = ir.Function(module, ir.FunctionType(kind, [kind] * len(args)), full)
        return self._count(self.builder.call(intrinsic, args, fastmath=flags))

    def arithmetic(self, name: str, a: Any, b: Any) -> Any:
        if is_float(a):
            return self._count(getattr(self.builder, FLOAT[name])(a, b, flags=("contract",)))
        if name not in INTEGER:
            raise Unsupported(f"{name} of integers")
        return self._count(getattr(self.builder, INTEGER[name])(a, b))

    def compare(self, name: str, a: Any, b: Any) -> Any:
        sign = COMPARE[name]
        if is_float(a):
            make = self.builder.fcmp_unordered if name == "ne" else self.builder.fcmp_ordered
        else:
            bits = a.type.element.width
            make = self.builder.icmp_unsigned if bits == 1 else self.builder.icmp_signed
        return self._count(make(sign, a, b))

    def negative(self, a: Any, dtype: Any) -> Any:
        if is_float(a):
            return self._count(self.builder.fneg(a))
        return self.arithmetic("sub", self.constant(0, dtype), a)

    def bitwise(self, name: str, *operands: Any) -> Any:
        return self._count(getattr(self.builder, BITWISE[name])(*operands))

    def select(self, flag: Any, yes: Any, no: Any) -> Any:
        return self._count(self.builder.select(flag, yes, no))

    def extreme(self, name: str, a: Any, b: Any) -> Any:
        """Return the larger or the smaller operand; NaN if one is NaN, as in JAX."""
        if is_float(a):  # the sign of a zero does not matter, and is expensive to get right
            return self.function("maximum" if name == "max" else "minimum", a, b, flags=("nsz",))
        return self.select(self.compare("gt" if name == "max" else "lt", a, b), a, b)

    def power(self, a: Any, exponent: int) -> Any:
        """Return a**exponent by squaring."""
        if exponent <= 0:
            one = ir.Constant(a.type, [ir.Constant(a.type.element, 1)] * self.width)
            return self.arithmetic("div", one, self.power(a, -exponent)) if exponent else one
        if exponent == 1:
            return a
        half = self.power(a, exponent // 2)
        square = self.arithmetic("mul", half, half)
        return self.arithmetic("mul", square, a) if exponent % 2 else square

    def convert(self, a: Any, old: Any, new: Any) -> Any:
        old, new = np.dtype(old), np.dtype(new)
        kind, b = self.vector(new), self.builder
        if old == new:
            return a
        if new.kind == "b":
            return self.compare("ne", a, self.constant(0, old))
        if old.kind == "b":
            return self._count(b.uitofp(a, kind) if new.kind == "f" else b.zext(a, kind))
        if old.kind == new.kind:
            wider = new.itemsize > old.itemsize
            names = {"f": ("fptrunc", "fpext"), "i": ("trunc", "sext")}[new.kind]
            return self._count(getattr(b, names[wider])(a, kind))
        return self._count(b.sitofp(a, kind) if new.kind == "f" else b.fptosi(a, kind))

    def logarithm(self, a: Any) -> Any:
        """Return the natural logarithm.

        In double precision the library function is called lane by lane, in single precision it is
        written out:

        a = 2ⁿ(1 + f), 1 + f between √½ and √2; ln(1 + f) = 2 artanh s, s = f/(2 + f).
        """
        if a.type.element != ir.FloatType():
            return self.function("log", a)
        make = self.arithmetic
        single = functools.partial(self.constant, dtype="float32")
        integer = functools.partial(self.constant, dtype="int32")

        def same_bits(value: Any, dtype: str) -> Any:
            return self._count(self.builder.bitcast(value, self.vector(dtype)))

        zero, one = single(0), single(1)
        low = self.compare("lt", a, single(2.0**-126))  # 0, or subnormal
        bits = same_bits(self.select(low, make("mul", a, single(2.0**23)), a), "int32")
        root = 0x3F3504F3  # √½
        above = make("sub", bits, integer(root))
        power = self._count(self.builder.ashr(above, integer(23)))
        power = make("sub", power, self.select(low, integer(23), integer(0)))
        rest = self.bitwise("and", above, integer(0x7FFFFF))
        rest = same_bits(make("add", rest, integer(root)), "float32")
        f = make("sub", rest, one)
        s = make("div", f, make("add", f, make("add", one, one)))
        square = make("mul", s, s)
        series = single(2 / 9)
        for term in (2 / 7, 2 / 5, 2 / 3, 2.0):
            series = make("add", make("mul", series, square), single(term))
        whole = make("mul", self.convert(power, "int32", "float32"), single(np.log(2)))
        result = make("add", whole, make("mul", s, series))
        result = self.select(self.compare("lt", a, single(np.inf)), result, a)
        result = self.select(self.compare("lt", a, zero), single(np.nan), result)
        return self.select(self.compare("eq", a, zero), single(-np.inf), result)

    def sign(self, a: Any, dtype: Any) -> Any:
        zero, one = self.constant(0, dtype), self.constant(1, dtype)
        below = self.select(self.compare("lt", a, zero), self.constant(-1, dtype), a)
        return self.select(self.compare("gt", a, zero), one, below)

    def absolute(self, a: Any, dtype: Any) -> Any:
        if is_float(a):
            return self.function("fabs", a)
        below = self.compare("lt", a, self.constant(0, dtype))
        return self.select(below, self.negative(a, dtype), a)


def is_float(a: Any) -> bool:
    return isinstance(a.type.element, ir.FloatType | ir.DoubleType)
