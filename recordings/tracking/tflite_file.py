"""A TensorFlow Lite file of BlazePose's kind, turned into arrays and a list of steps that `graph` runs.

The file (https://ai.google.dev/edge/litert, schema in its repository) is a FlatBuffer: tensors, of which some have
values, and operators in the order in which they run. Pictures are (N, H, W, C) there and kernels (out, h, w, in);
constants come out in that order of axes, kernels as torch has them, (out, in, h, w). Half precision becomes single,
and a tensor stored as sparse becomes a full one. The package `tflite` (extra `tracking`) knows the schema.
"""

from typing import Any

import numpy as np

from ..errors import InputError
from .graph import Step

KINDS = {0: np.float32, 1: np.float16, 2: np.int32, 3: np.uint8, 4: np.int64}
"""Of a tensor's numbers, by the schema's number of them."""
SAME = 0
"""The schema's number of the padding that keeps ⌈n/stride⌉ places."""


def read_tflite(content: bytes) -> tuple[dict[str, np.ndarray], list[Step], str, list[str]]:
    """Constants by name, steps in their order, names of the input and of the outputs.

    Raises InputError when the package `tflite` is missing, or for an operator that BlazePose has not.
    """
    tflite = import_tflite()
    model = tflite.Model.GetRootAsModel(content, 0)
    graph = model.Subgraphs(0)
    constants: dict[int, np.ndarray] = {}
    for number in range(graph.TensorsLength()):
        tensor = graph.Tensors(number)
        buffer = model.Buffers(tensor.Buffer())
        if buffer.DataLength():
            values = np.frombuffer(buffer.DataAsNumpy().tobytes(), KINDS[tensor.Type()])
            shape = tuple(tensor.ShapeAsNumpy()) if tensor.ShapeLength() else ()
            full = values.reshape(shape) if tensor.Sparsity() is None else _full(tensor.Sparsity(), shape, values)
            constants[number] = full.astype(np.float32) if full.dtype == np.float16 else full
    names = {value: name for name, value in vars(tflite.BuiltinOperator).items() if not name.startswith("_")}
    steps, kernels = [], {}
    for number in range(graph.OperatorsLength()):
        operator = graph.Operators(number)
        name = names[model.OperatorCodes(operator.OpcodeIndex()).BuiltinCode()]
        inputs, (output, *_) = operator.InputsAsNumpy().tolist(), operator.OutputsAsNumpy().tolist()
        if name in ("DEQUANTIZE", "DENSIFY"):  # of constants, which are single and full by now
            constants[output] = constants[inputs[0]]
            continue
        shape = graph.Tensors(output).ShapeAsNumpy().tolist()
        options = _options(tflite, name, operator.BuiltinOptions(), shape)
        if name == "CONV_2D":
            kernels[inputs[1]] = (0, 3, 1, 2)
        elif name == "DEPTHWISE_CONV_2D":
            kernels[inputs[1]] = (3, 0, 1, 2)
        elif name in ("PAD", "RESIZE_BILINEAR"):
            options["value"] = constants[inputs.pop()].tolist()
        steps.append(Step(name, [str(each) for each in inputs], str(output), options))
    for number, axes in kernels.items():
        constants[number] = np.ascontiguousarray(constants[number].transpose(axes))
    used = {name for step in steps for name in step.inputs}
    kept = {str(number): value for number, value in constants.items() if str(number) in used}
    return kept, steps, str(graph.InputsAsNumpy()[0]), [str(each) for each in graph.OutputsAsNumpy()]


def _options(tflite: Any, name: str, union: Any, shape: list[int]) -> dict[str, Any]:
    """What a step needs to know beside its inputs. Raises InputError for an unknown operator."""

    def table(kind: str) -> Any:
        found = getattr(tflite, kind)()
        found.Init(union.Bytes, union.Pos)
        return found

    def window(found: Any) -> dict[str, Any]:
        return {"stride": [found.StrideH(), found.StrideW()], "same": found.Padding() == SAME}

    if name in ("CONV_2D", "DEPTHWISE_CONV_2D"):
        found = table("Conv2DOptions" if name == "CONV_2D" else "DepthwiseConv2DOptions")
        return window(found) | {"activation": found.FusedActivationFunction()}
    if name == "ADD":
        return {"activation": table("AddOptions").FusedActivationFunction()}
    if name == "MAX_POOL_2D":
        found = table("Pool2DOptions")
        return window(found) | {"kernel": [found.FilterHeight(), found.FilterWidth()]}
    if name == "RESIZE_BILINEAR":
        found = table("ResizeBilinearOptions")
        if found.AlignCorners():
            raise InputError("this network aligns corners where it resizes: not one that is known here")
        return {"half_pixels": found.HalfPixelCenters()}
    if name == "DEPTH_TO_SPACE":
        return {"block": table("DepthToSpaceOptions").BlockSize()}
    if name == "CONCATENATION":
        return {"axis": table("ConcatenationOptions").Axis()}
    if name == "RESHAPE":
        return {"shape": shape}
    if name in ("PAD", "LOGISTIC"):
        return {}
    raise InputError(f"this network has an operator {name}, which is not known here")


def _full(sparsity: Any, shape: tuple[int, ...], values: np.ndarray) -> np.ndarray:
    """A sparse tensor's values at their places: its tree of dimensions is walked level by level.

    A dense level has all its indices; a sparse one has, for each place of the level above, a segment of indices. The
    levels beyond the tensor's own axes count within blocks (the schema's `SparsityParameters`).
    """
    tflite = import_tflite()
    order = sparsity.TraversalOrderAsNumpy().tolist()
    blocked = sparsity.BlockMapAsNumpy().tolist() if sparsity.BlockMapLength() else []
    levels = [sparsity.DimMetadata(i) for i in range(sparsity.DimMetadataLength())]

    def numbers(level: Any, which: str) -> np.ndarray:
        kind = {1: tflite.Int32Vector, 2: tflite.Uint16Vector, 3: tflite.Uint8Vector}
        union = getattr(level, f"Array{which}")()
        vector = kind[getattr(level, f"Array{which}Type")()]()
        vector.Init(union.Bytes, union.Pos)
        return vector.ValuesAsNumpy().astype(int)

    index, place = np.zeros((1, 0), int), np.zeros(1, int)
    for level in levels:
        if level.Format() == 0:
            size = level.DenseSize()
            own = np.tile(np.arange(size), len(place))
            index = np.column_stack([np.repeat(index, size, 0), own])
            place = (place[:, None] * size + np.arange(size)).ravel()
        else:
            segments, indices = numbers(level, "Segments"), numbers(level, "Indices")
            counts = segments[place + 1] - segments[place]
            place = np.concatenate([np.arange(segments[p], segments[p + 1]) for p in place])
            index = np.column_stack([np.repeat(index, counts, 0), indices[place]])
    where: list[np.ndarray] = [np.zeros(len(place), int)] * len(shape)
    for column, axis in sorted(enumerate(order), key=lambda each: each[1]):  # axes first, then what is within blocks
        if axis < len(shape):
            where[axis] = index[:, column]
        else:
            inside = blocked[axis - len(shape)]
            where[inside] = where[inside] * levels[column].DenseSize() + index[:, column]
    full = np.zeros(shape, values.dtype)
    full[tuple(where)] = values[place]
    return full


def import_tflite() -> Any:
    """The package that knows the schema. Raises InputError when it is not installed."""
    try:
        import tflite
    except ImportError:
        raise InputError("reading the weights needs one more package: pip install 'invdyn[tracking]'") from None
    return tflite
