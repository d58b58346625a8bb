"""Dual numbers: with them in the place of float64 the kernels give derivatives beside their values.

A dual is a value and its tangent, the derivative of the value along one direction of the parameters. Kernels name no
types, so numba makes a second version of them where state, scratch, parameters and outputs hold duals. Values come from
numba's own functions of float64 and every comparison looks at them alone: they are the same to the last bit, and the
derivative is that of the branch taken. Imported only where derivatives are asked for.
"""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.core.compiler import Flags
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.cpython.builtins import cast_int, max_vararg, min_vararg
from numba.extending import (
    box,
    intrinsic,
    lower_builtin,
    lower_cast,
    models,
    overload,
    register_model,
    typeof_impl,
)

from tissue_contact.kernels.bundle import Bundle, BundleType, Fields
from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.layout import blocks
from tissue_contact.kernels.step import initialize, step


class DualType(types.Type):
    """Type of a dual within kernels; a plain number becomes one, with tangent 0, wherever the two meet."""

    def __init__(self) -> None:
        super().__init__(name="Dual")

    def can_convert_from(self, typing: Any, other: types.Type) -> Conversion | None:
        return Conversion.safe if isinstance(other, types.Integer | types.Float) else None

    def unify(self, typing: Any, other: types.Type) -> types.Type | None:
        return self if isinstance(other, types.Integer | types.Float) else None


DUAL, FLOAT = DualType(), types.float64


@register_model(DualType)
class _DualModel(models.StructModel):
    def __init__(self, manager: Any, kind: DualType) -> None:
        super().__init__(manager, kind, [("value", FLOAT), ("tangent", FLOAT)])


def _made(context: Any, builder: Any, value: Any, tangent: Any) -> Any:
    made = cgutils.create_struct_proxy(DUAL)(context, builder)
    made.value, made.tangent = value, tangent
    return made._getvalue()


@lower_cast(types.Integer, DualType)
@lower_cast(types.Float, DualType)
def _constant(context: Any, builder: Any, given: types.Type, wanted: DualType, number: Any) -> Any:
    value = context.cast(builder, number, given, FLOAT)
    return _made(context, builder, value, context.get_constant(FLOAT, 0.0))


@lower_cast(DualType, types.Integer)
def _whole(context: Any, builder: Any, given: DualType, wanted: types.Type, number: Any) -> Any:
    return context.cast(builder, builder.extract_value(number, 0), FLOAT, wanted)


@box(DualType)
def _box(kind: DualType, number: Any, c: Any) -> Any:
    """A dual comes out of a kernel as the tuple of its value and its tangent."""
    parts = [c.pyapi.float_from_double(c.builder.extract_value(number, k)) for k in range(2)]
    made = c.pyapi.tuple_pack(parts)
    for part in parts:
        c.pyapi.decref(part)
    return made


# For each function the derivatives by its arguments, from its result and them. A root has slope 0 at 0: lengths are
# roots of squares, and where one is 0 there is no direction to prefer. Where two are equal the first is the maximum.
SLOPES: dict[Callable[..., Any], tuple[Callable[..., float], ...]] = {
    operator.add: (lambda r, a, b: 1.0, lambda r, a, b: 1.0),
    operator.sub: (lambda r, a, b: 1.0, lambda r, a, b: -1.0),
    operator.mul: (lambda r, a, b: b, lambda r, a, b: a),
    operator.truediv: (lambda r, a, b: 1.0 / b, lambda r, a, b: -r * (1.0 / b)),
    operator.pow: (lambda r, a, b: b * r / a if a != 0.0 else 0.0, lambda r, a, b: r * math.log(a) if a > 0.0 else 0.0),
    operator.neg: (lambda r, a: -1.0,),
    abs: (lambda r, a: -1.0 if a < 0.0 else 1.0,),
    math.sqrt: (lambda r, a: 0.5 / r if r != 0.0 else 0.0,),
    math.sin: (lambda r, a: math.cos(a),),
    math.cos: (lambda r, a: -math.sin(a),),
    math.atan2: (lambda r, a, b: b / (a * a + b * b), lambda r, a, b: -a / (a * a + b * b)),
    np.fmax: (lambda r, a, b: 1.0 if a >= b else 0.0, lambda r, a, b: 0.0 if a >= b else 1.0),
}
SLOPES |= {
    operator.iadd: SLOPES[operator.add],
    operator.isub: SLOPES[operator.sub],
    operator.imul: SLOPES[operator.mul],
    operator.itruediv: SLOPES[operator.truediv],
    np.sqrt: SLOPES[math.sqrt],
}
# Functions of the values alone.
OF_VALUES = {
    **dict.fromkeys(
        (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne), types.boolean(FLOAT, FLOAT)
    ),
    math.isfinite: types.boolean(FLOAT),
    math.ceil: types.int64(FLOAT),
}


def _teach(function: Callable[..., Any], of_values: Any, slopes: tuple[Callable[..., float], ...]) -> None:
    """Teach numba a function of one or two arguments, at least one of them a dual.

    ``of_values`` is the signature of the same function of float64; the result is a dual if there are ``slopes``.
    """
    result = DUAL if slopes else of_values.return_type

    @infer_global(function)
    class Typed(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(result, *map(types.unliteral, args)) if DUAL in args else None

    def make(context: Any, builder: Any, sig: Any, numbers: Any) -> Any:
        values = [
            builder.extract_value(number, 0) if kind == DUAL else context.cast(builder, number, kind, FLOAT)
            for kind, number in zip(sig.args, numbers, strict=True)
        ]
        value = context.get_function(function, of_values)(builder, values)
        if not slopes:
            return value
        parts, known = [], [value, *values]
        of_known, flags = FLOAT(*[FLOAT] * len(known)), Flags()
        flags.error_model = "numpy"  # as the kernels, which it does not inherit
        for kind, number, slope in zip(sig.args, numbers, slopes, strict=True):
            if kind == DUAL:
                compiled = context.compile_subroutine(builder, slope, of_known, flags=flags)
                by = context.call_internal(builder, compiled.fndesc, of_known, known)
                parts.append(builder.fmul(by, builder.extract_value(number, 1)))
        return _made(context, builder, value, parts[0] if len(parts) == 1 else builder.fadd(*parts))

    one, two = [(DualType,)], [(DualType, DualType), (DualType, types.Any), (types.Any, DualType)]
    for kinds in one if len(of_values.args) == 1 else two:
        lower_builtin(function, *kinds)(make)


for _function, _slopes in SLOPES.items():
    _teach(_function, FLOAT(*[FLOAT] * len(_slopes)), _slopes)
for _function, _signature in OF_VALUES.items():
    _teach(_function, _signature, ())


@overload(max)
def _max(*numbers):
    return (lambda *numbers: max_vararg(numbers)) if DUAL in numbers else None


@overload(min)
def _min(*numbers):
    return (lambda *numbers: min_vararg(numbers)) if DUAL in numbers else None


@overload(int)
def _int(number):
    return (lambda number: cast_int(number)) if number == DUAL else None


class DualBundle(Bundle[Fields]):
    """A bundle whose block ``real``, shape [items, 2], holds values and tangents; ``fields`` shows the values."""

    def __init__(self, fields: Fields) -> None:
        super().__init__(fields)
        self.real = np.stack([self.real, np.zeros(self.real.size)], axis=1)
        self.real_address = self.real.ctypes.data
        spans = zip(blocks(type(fields)).items(), self.spans.reshape(-1, 2).tolist(), strict=True)
        self.fields = self.fields._replace(
            **{name: self.real[begin:end, 0] for (name, kind), (begin, end) in spans if kind is np.float64}
        )


@typeof_impl.register(DualBundle)
def _typeof(bundle: DualBundle, context: Any) -> BundleType:
    return BundleType(type(bundle.fields), DUAL)


@intrinsic
def duals(typing: Any, numbers: types.Array) -> Any:
    """View of values and tangents, float64 of shape [n, 2], as an array of n duals."""
    array = types.Array(DUAL, 1, "C")

    def make(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        given = context.make_array(numbers)(context, builder, value=arguments[0])
        made = context.make_array(array)(context, builder)
        bytes_of_item = context.get_constant(types.intp, 16)
        context.populate_array(
            made,
            data=builder.bitcast(given.data, made.data.type),
            shape=[builder.extract_value(given.shape, 0)],
            strides=[bytes_of_item],
            itemsize=bytes_of_item,
            meminfo=None,
        )
        return made._getvalue()

    return array(numbers), make


@kernel
def dual_initialize(model, parameters, state, inputs, outputs, scratch):
    """`step.initialize` with the parameters and the outputs of shape [n, 2]: values and tangents."""
    return initialize(model, duals(parameters), state, inputs, duals(outputs), scratch)


@kernel
def dual_step(model, parameters, state, inputs, h, outputs, scratch):
    """`step.step` with the parameters and the outputs of shape [n, 2]: values and tangents."""
    return step(model, duals(parameters), state, inputs, h, duals(outputs), scratch)
