"""TensorFlow Lite files made here, of BlazePose's operators, read and run against sums written out."""

import numpy as np
import pytest
import torch

from invdyn.recordings import InputError
from invdyn.recordings.tracking.blazepose_weights import load_graph, save_graph
from invdyn.recordings.tracking.graph import Graph, Step
from invdyn.recordings.tracking.tflite_file import read_tflite

tflite = pytest.importorskip("tflite")
flatbuffers = pytest.importorskip("flatbuffers")
OPERATOR, OPTIONS = tflite.BuiltinOperator, tflite.BuiltinOptions
RNG = np.random.default_rng(0)


def numbers(builder, values):
    builder.StartVector(4, len(values), 4)
    for value in reversed(values):
        builder.PrependInt32(int(value))
    return builder.EndVector()


def offsets(builder, values):
    builder.StartVector(4, len(values), 4)
    for value in reversed(values):
        builder.PrependUOffsetTRelative(value)
    return builder.EndVector()


def file_of(code, options, shapes, constants, options_kind=0, sparse=None):
    """A model of one operator: tensors are the input, then the constants, then the output; shapes of all."""
    b = flatbuffers.Builder(0)
    buffers = []
    for values in (None, *constants):
        data = None if values is None else b.CreateByteVector(values.tobytes())
        tflite.BufferStart(b)
        if data is not None:
            tflite.BufferAddData(b, data)
        buffers.append(tflite.BufferEnd(b))
    tensors = []
    for number, shape in enumerate(shapes):
        at = numbers(b, shape)
        own = constants[number - 1] if 0 < number <= len(constants) else None
        how = None if sparse is None or number != 1 else sparse(b)
        tflite.TensorStart(b)
        tflite.TensorAddShape(b, at)
        tflite.TensorAddType(b, {"float16": 1, "int32": 2}.get(str(getattr(own, "dtype", "")), 0))
        tflite.TensorAddBuffer(b, number if own is not None else 0)
        if how is not None:
            tflite.TensorAddSparsity(b, how)
        tensors.append(tflite.TensorEnd(b))
    table = options(b)
    takes, makes = numbers(b, range(len(shapes) - 1)), numbers(b, [len(shapes) - 1])
    tflite.OperatorStart(b)
    tflite.OperatorAddOpcodeIndex(b, 0)
    tflite.OperatorAddInputs(b, takes)
    tflite.OperatorAddOutputs(b, makes)
    if table is not None:
        tflite.OperatorAddBuiltinOptionsType(b, options_kind)
        tflite.OperatorAddBuiltinOptions(b, table)
    operator = tflite.OperatorEnd(b)
    tensors, operators = offsets(b, tensors), offsets(b, [operator])
    given, wanted = numbers(b, [0]), numbers(b, [len(shapes) - 1])
    tflite.SubGraphStart(b)
    tflite.SubGraphAddTensors(b, tensors)
    tflite.SubGraphAddInputs(b, given)
    tflite.SubGraphAddOutputs(b, wanted)
    tflite.SubGraphAddOperators(b, operators)
    graph = tflite.SubGraphEnd(b)
    tflite.OperatorCodeStart(b)
    tflite.OperatorCodeAddDeprecatedBuiltinCode(b, code)
    tflite.OperatorCodeAddBuiltinCode(b, code)
    codes = offsets(b, [tflite.OperatorCodeEnd(b)])
    graphs, buffers = offsets(b, [graph]), offsets(b, buffers)
    tflite.ModelStart(b)
    tflite.ModelAddVersion(b, 3)
    tflite.ModelAddOperatorCodes(b, codes)
    tflite.ModelAddSubgraphs(b, graphs)
    tflite.ModelAddBuffers(b, buffers)
    b.Finish(tflite.ModelEnd(b), file_identifier=b"TFL3")
    return bytes(b.Output())


def convolution(kind, stride, same, activation):
    def options(b):
        name = {"Conv2D": "Conv2DOptions", "Depthwise": "DepthwiseConv2DOptions"}[kind]
        getattr(tflite, f"{name}Start")(b)
        getattr(tflite, f"{name}AddPadding")(b, 0 if same else 1)
        getattr(tflite, f"{name}AddStrideH")(b, stride[0])
        getattr(tflite, f"{name}AddStrideW")(b, stride[1])
        getattr(tflite, f"{name}AddFusedActivationFunction")(b, activation)
        return getattr(tflite, f"{name}End")(b)

    return options


def run(content, x, tmp_path):
    """Through the file in the cache, as the product does."""
    save_graph(content, tmp_path / "g.safetensors")
    (out,) = load_graph(tmp_path / "g.safetensors")(torch.from_numpy(x))
    return out.numpy()


def by_hand(x, kernel, bias, stride, same, depthwise):
    """Convolution as a sum over a window, by the schema's rule for padding "same"."""
    count, height, width, _ = x.shape
    (k, l) = kernel.shape[1:3]
    rows = -(-height // stride[0]) if same else (height - k) // stride[0] + 1
    columns = -(-width // stride[1]) if same else (width - l) // stride[1] + 1
    top = max((rows - 1) * stride[0] + k - height, 0) // 2 if same else 0
    left = max((columns - 1) * stride[1] + l - width, 0) // 2 if same else 0
    wide = np.pad(x, ((0, 0), (top, k), (left, l), (0, 0)))
    out = np.zeros((count, rows, columns, len(bias)))
    for i in range(rows):
        for j in range(columns):
            window = wide[:, i * stride[0] : i * stride[0] + k, j * stride[1] : j * stride[1] + l]
            product = "nklc,klc->nc" if depthwise else "nklc,oklc->no"
            out[:, i, j] = np.einsum(product, window, kernel[0] if depthwise else kernel) + bias
    return out


@pytest.mark.parametrize("kind", ["Conv2D", "Depthwise"])
@pytest.mark.parametrize(("stride", "same"), [((1, 1), True), ((2, 2), True), ((2, 1), False)])
def test_convolutions(kind, stride, same, tmp_path):
    x = RNG.normal(size=(1, 7, 6, 3)).astype(np.float32)
    depthwise = kind == "Depthwise"
    kernel = RNG.normal(size=(1, 3, 3, 3) if depthwise else (4, 3, 3, 3)).astype(np.float16)
    bias = RNG.normal(size=3 if depthwise else 4).astype(np.float32)
    code, own = (OPERATOR.DEPTHWISE_CONV_2D, OPTIONS.DepthwiseConv2DOptions) if depthwise else (
        OPERATOR.CONV_2D, OPTIONS.Conv2DOptions)  # fmt: skip
    expected = by_hand(x, kernel.astype(float), bias, stride, same, depthwise)
    shapes = [x.shape, kernel.shape, bias.shape, expected.shape]
    options = convolution(kind, stride, same, 3)
    content = file_of(code, options, shapes, [kernel, bias], options_kind=own)
    np.testing.assert_allclose(run(content, x, tmp_path), np.clip(expected, 0, 6), atol=1e-5)


def test_pooling_takes_no_padding_for_a_maximum(tmp_path):
    x = -1 - RNG.random((1, 5, 4, 2)).astype(np.float32)  # all below zero

    def options(b):
        tflite.Pool2DOptionsStart(b)
        tflite.Pool2DOptionsAddPadding(b, 0)
        tflite.Pool2DOptionsAddStrideH(b, 2)
        tflite.Pool2DOptionsAddStrideW(b, 2)
        tflite.Pool2DOptionsAddFilterHeight(b, 2)
        tflite.Pool2DOptionsAddFilterWidth(b, 2)
        return tflite.Pool2DOptionsEnd(b)

    content = file_of(OPERATOR.MAX_POOL_2D, options, [x.shape, (1, 3, 2, 2)], [], options_kind=OPTIONS.Pool2DOptions)
    wide = np.pad(x, ((0, 0), (0, 1), (0, 0), (0, 0)), constant_values=-np.inf)
    np.testing.assert_array_equal(run(content, x, tmp_path), wide.reshape(1, 3, 2, 2, 2, 2).max((2, 4)))


@pytest.mark.parametrize("half", [False, True])
def test_resizing(half, tmp_path):
    x = RNG.normal(size=(1, 3, 4, 2)).astype(np.float32)
    size = np.array([6, 8], np.int32)

    def options(b):
        tflite.ResizeBilinearOptionsStart(b)
        tflite.ResizeBilinearOptionsAddHalfPixelCenters(b, half)
        return tflite.ResizeBilinearOptionsEnd(b)

    content = file_of(
        OPERATOR.RESIZE_BILINEAR,
        options,
        [x.shape, (2,), (1, 6, 8, 2)],
        [size],
        options_kind=OPTIONS.ResizeBilinearOptions,
    )
    rows, columns = ((np.arange(n) + 0.5 * half) / 2 - 0.5 * half for n in size)
    expected = np.empty((1, 6, 8, 2))
    for c in range(2):
        along = np.stack([np.interp(columns, np.arange(4), row) for row in x[0, :, :, c]])
        expected[0, :, :, c] = np.stack([np.interp(rows, np.arange(3), column) for column in along.T], -1)
    np.testing.assert_allclose(run(content, x, tmp_path), expected, atol=1e-6)


def test_depth_to_space_and_padding_and_the_rest(tmp_path):
    x = RNG.normal(size=(1, 2, 3, 8)).astype(np.float32)

    def blocks(b):
        tflite.DepthToSpaceOptionsStart(b)
        tflite.DepthToSpaceOptionsAddBlockSize(b, 2)
        return tflite.DepthToSpaceOptionsEnd(b)

    content = file_of(
        OPERATOR.DEPTH_TO_SPACE, blocks, [x.shape, (1, 4, 6, 2)], [], options_kind=OPTIONS.DepthToSpaceOptions
    )
    expected = x.reshape(1, 2, 3, 2, 2, 2).transpose(0, 1, 3, 2, 4, 5).reshape(1, 4, 6, 2)
    np.testing.assert_array_equal(run(content, x, tmp_path), expected)

    margins = np.array([[0, 0], [1, 2], [0, 3], [0, 1]], np.int32)
    content = file_of(OPERATOR.PAD, lambda b: None, [x.shape, (4, 2), (1, 5, 6, 9)], [margins])
    np.testing.assert_array_equal(run(content, x, tmp_path), np.pad(x, margins))

    content = file_of(OPERATOR.RESHAPE, lambda b: None, [x.shape, (1, 48)], [])
    np.testing.assert_array_equal(run(content, x, tmp_path), x.reshape(1, 48))
    content = file_of(OPERATOR.LOGISTIC, lambda b: None, [x.shape, x.shape], [])
    np.testing.assert_allclose(run(content, x, tmp_path), 1 / (1 + np.exp(-x)), rtol=1e-5)


def test_a_sparse_kernel_is_filled_in(tmp_path):
    """Rows of a kernel (2, 1, 1, 4), of which only some columns are kept: the outermost axis dense, the last sparse."""
    kernel = np.zeros((2, 1, 1, 4), np.float32)
    kernel[0, 0, 0, [1, 3]], kernel[1, 0, 0, 0] = (2.0, 5.0), 7.0

    def vector(b, values):
        at = numbers(b, values)
        tflite.Int32VectorStart(b)
        tflite.Int32VectorAddValues(b, at)
        return tflite.Int32VectorEnd(b)

    def sparse(b):
        segments, indices = vector(b, [0, 2, 3]), vector(b, [1, 3, 0])
        levels = []
        for size in (2, 1, 1, None):
            tflite.DimensionMetadataStart(b)
            tflite.DimensionMetadataAddFormat(b, 0 if size else 1)
            if size:
                tflite.DimensionMetadataAddDenseSize(b, size)
            else:
                tflite.DimensionMetadataAddArraySegmentsType(b, 1)
                tflite.DimensionMetadataAddArraySegments(b, segments)
                tflite.DimensionMetadataAddArrayIndicesType(b, 1)
                tflite.DimensionMetadataAddArrayIndices(b, indices)
            levels.append(tflite.DimensionMetadataEnd(b))
        levels, order = offsets(b, levels), numbers(b, [0, 1, 2, 3])
        tflite.SparsityParametersStart(b)
        tflite.SparsityParametersAddTraversalOrder(b, order)
        tflite.SparsityParametersAddDimMetadata(b, levels)
        return tflite.SparsityParametersEnd(b)

    x = RNG.normal(size=(1, 2, 2, 4)).astype(np.float32)
    kept, bias = np.array([2.0, 5.0, 7.0], np.float32), np.zeros(2, np.float32)
    content = file_of(
        OPERATOR.CONV_2D,
        convolution("Conv2D", (1, 1), True, 0),
        [x.shape, kernel.shape, (2,), (1, 2, 2, 2)],
        [kept, bias],
        options_kind=OPTIONS.Conv2DOptions,
        sparse=sparse,
    )
    np.testing.assert_allclose(run(content, x, tmp_path), by_hand(x, kernel, bias, (1, 1), True, False), atol=1e-5)


def test_an_operator_that_is_not_known():
    x = np.zeros((1, 2, 2, 1), np.float32)
    with pytest.raises(InputError, match="operator TANH, which is not known here"):
        read_tflite(file_of(OPERATOR.TANH, lambda b: None, [x.shape, x.shape], []))


def test_sums_and_joins():
    x = RNG.normal(size=(1, 2, 3, 4)).astype(np.float32)
    constant = torch.tensor([1.0])
    steps = [Step("ADD", ["x", "c"], "s", {"activation": 1}), Step("CONCATENATION", ["x", "s"], "y", {"axis": 2})]
    (found,) = Graph({"c": constant}, steps, "x", ["y"])(torch.from_numpy(x))
    np.testing.assert_allclose(found, np.concatenate([x, np.maximum(x + 1, 0)], 2))
