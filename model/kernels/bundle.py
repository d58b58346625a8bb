"""The bundles of `layout` as numba sees them: three pointers, from which a field is looked up where it is used.

As a tuple of arrays a bundle would be some hundred arrays of seven numbers each, handed over at every call of a kernel:
compilation took minutes and every call counted references. Fields are read through the same spans that model.bin holds.
"""

from typing import Any, Generic, TypeVar

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

from tissue_contact.kernels.layout import Model, Scratch, State, blocks, pack, spans

Fields = TypeVar("Fields", Model, State, Scratch)


class Bundle(Generic[Fields]):
    """The handle of a packed bundle that kernels take from Python. It keeps its arrays alive.

    ``fields`` is the `Model`, `State` or `Scratch` whose fields are views of the blocks ``index`` and ``real``.
    """

    def __init__(self, fields: Fields) -> None:
        self.fields, self.index, self.real = pack(fields)
        self.spans = spans(fields)
        self.index_address, self.real_address = self.index.ctypes.data, self.real.ctypes.data
        self.spans_address = self.spans.ctypes.data


class BundleType(types.Type):
    """Type of a bundle within kernels: ``kind`` is `Model`, `State` or `Scratch`, ``real`` what a `Real` holds."""

    def __init__(self, kind: type, real: types.Type = types.float64) -> None:
        self.kind, self.real = kind, real
        self.pointers = (("index", types.uint32), ("real", real), ("spans", types.uint64))
        super().__init__(name=f"Bundle({kind.__name__}, {real})")


@typeof_impl.register(Bundle)
def _typeof(bundle: Bundle, context: Any) -> BundleType:
    return BundleType(type(bundle.fields))


@register_model(BundleType)
class _BundleModel(models.StructModel):
    def __init__(self, manager: Any, kind: BundleType) -> None:
        super().__init__(manager, kind, [(name, types.CPointer(item)) for name, item in kind.pointers])


@infer_getattr
class _BundleAttribute(AttributeTemplate):
    key = BundleType

    def generic_resolve(self, bundle: BundleType, name: str) -> types.Array | None:
        return _array(bundle, name) if name in bundle.kind._fields else None  # type: ignore[attr-defined]


def _array(bundle: BundleType, name: str) -> types.Array:
    item = types.uint32 if blocks(bundle.kind)[name] is np.uint32 else bundle.real
    return types.Array(item, 1, "C")


@lower_getattr_generic(BundleType)
def _field(context: Any, builder: Any, bundle: BundleType, value: Any, name: str) -> Any:
    """A field as an array that owns nothing: no reference to it is ever counted."""
    array = _array(bundle, name)
    own = cgutils.create_struct_proxy(bundle)(context, builder, value=value)
    at = 2 * bundle.kind._fields.index(name)  # type: ignore[attr-defined]

    def span(place: int) -> Any:
        loaded = builder.load(builder.gep(own.spans, [ir.Constant(ir.IntType(64), place)]))
        # Spans never change, whatever else is written: the look-up may leave the loops.
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    begin, end = span(at), span(at + 1)
    base = own.index if array.dtype == types.uint32 else own.real
    bytes_of_item = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(array.dtype)))
    made = context.make_array(array)(context, builder)
    context.populate_array(
        made,
        data=builder.gep(base, [begin]),
        shape=[builder.sub(end, begin)],
        strides=[bytes_of_item],
        itemsize=bytes_of_item,
        meminfo=None,
    )
    return made._getvalue()


@unbox(BundleType)
def _unbox(bundle: BundleType, handle: Any, c: Any) -> NativeValue:
    made = cgutils.create_struct_proxy(bundle)(c.context, c.builder)
    for name, item in bundle.pointers:
        address = c.pyapi.object_getattr_string(handle, f"{name}_address")
        pointer = c.context.get_value_type(types.CPointer(item))
        setattr(made, name, c.builder.bitcast(c.pyapi.long_as_voidptr(address), pointer))
        c.pyapi.decref(address)
    return NativeValue(made._getvalue(), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


def _joined(kind: type) -> Any:
    """Intrinsic that makes a bundle of raw pointers to its blocks and to its first span."""

    @intrinsic
    def join(typing: Any, index: Any, real: Any, first: Any) -> Any:
        bundle = BundleType(kind)

        def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            made = cgutils.create_struct_proxy(bundle)(context, builder)
            made.index, made.real, made.spans = arguments
            return made._getvalue()

        return bundle(*[types.CPointer(item) for _, item in bundle.pointers]), make

    return join


@intrinsic
def pointer_at(typing: Any, pointer: Any, place: Any) -> Any:
    """Pointer to the item of a uint64 array at a place."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [arguments[1]])

    return types.CPointer(types.uint64)(types.CPointer(types.uint64), types.intp), make


join_model, join_state, join_scratch = _joined(Model), _joined(State), _joined(Scratch)
