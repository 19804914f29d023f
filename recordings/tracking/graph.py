"""BlazePose's few operators in plain torch, run in the order of a list of steps (`tflite_file` makes it).

TensorFlow Lite keeps pictures as (N, H, W, C); here they are (N, C, H, W) while a graph runs. Its padding "same" puts
the odd row or column at the end, and its resizing without half pixels samples at i n/N, so neither is torch's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

CHANNELS_LAST = {0: 0, 1: 2, 2: 3, 3: 1}
"""An axis of (N, H, W, C) as one of (N, C, H, W)."""


@dataclass(frozen=True)
class Step:
    """An operator of the TensorFlow Lite schema: names of what it takes, and of what it makes."""

    operator: str
    inputs: list[str]
    output: str
    options: dict[str, Any] = field(default_factory=dict)


class Graph:
    """Steps that can be called.

    Args:
        constants: by name; kernels (out, in, h, w), those of depth-wise convolutions (channels, 1, h, w).
        steps: in their order.
        given: name of the input.
        wanted: names of the outputs.
    """

    def __init__(self, constants: Mapping[str, Tensor], steps: Sequence[Step], given: str, wanted: Sequence[str]):
        self.constants = {
            name: value.contiguous(memory_format=torch.channels_last)
            if value.ndim == 4 and value.shape[1] > 1
            else value
            for name, value in constants.items()
        }
        self.steps, self.given, self.wanted = list(steps), given, list(wanted)

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> list[Tensor]:
        """From (N, H, W, C) to the outputs, pictures among them (N, H, W, C) again."""
        known = dict(self.constants)
        known[self.given] = pictures.permute(0, 3, 1, 2).contiguous(memory_format=torch.channels_last)
        for step in self.steps:
            known[step.output] = _run(step.operator, [known[name] for name in step.inputs], step.options)
        wanted = [known[name] for name in self.wanted]
        return [value.permute(0, 2, 3, 1) if value.ndim == 4 else value for value in wanted]


def _run(operator: str, inputs: list[Tensor], options: dict[str, Any]) -> Tensor:
    x = inputs[0]
    if operator in ("CONV_2D", "DEPTHWISE_CONV_2D"):
        _, kernel, bias = inputs
        groups = 1 if operator == "CONV_2D" else len(kernel)
        x = _padded(x, kernel.shape[2:], options, 0.0)
        return _activated(F.conv2d(x, kernel, bias, options["stride"], groups=groups), options["activation"])
    if operator == "ADD":
        return _activated(x + inputs[1], options["activation"])
    if operator == "MAX_POOL_2D":
        x = _padded(x, options["kernel"], options, -torch.inf)
        return F.max_pool2d(x, options["kernel"], options["stride"])
    if operator == "PAD":
        _, rows, columns, channels = options["value"]
        return F.pad(x, (*columns, *rows, *channels))
    if operator == "RESIZE_BILINEAR":
        if options["half_pixels"]:
            return F.interpolate(x, options["value"], mode="bilinear", align_corners=False)
        return _resized(_resized(x, options["value"][0], 2), options["value"][1], 3)
    if operator == "DEPTH_TO_SPACE":  # torch's pixel_shuffle takes the block from the slow end of the channels
        block, (count, channels, height, width) = options["block"], x.shape
        out = channels // block**2
        x = x.reshape(count, block, block, out, height, width).permute(0, 3, 4, 1, 5, 2)
        return x.reshape(count, out, height * block, width * block)
    if operator == "CONCATENATION":
        axis = options["axis"] % x.ndim
        return torch.cat(inputs, CHANNELS_LAST[axis] if x.ndim == 4 else axis)
    if operator == "RESHAPE":
        x = (x.permute(0, 2, 3, 1) if x.ndim == 4 else x).reshape(options["shape"])
        return x.permute(0, 3, 1, 2) if x.ndim == 4 else x
    if operator == "LOGISTIC":
        return x.sigmoid()
    raise NotImplementedError(operator)


def _padded(x: Tensor, kernel: Sequence[int], options: dict[str, Any], value: float) -> Tensor:
    """Padded such that a window keeps ⌈n/stride⌉ places, if "same"; what is odd comes last."""
    if not options["same"]:
        return x
    sizes = zip(x.shape[2:], options["stride"], kernel, strict=True)
    (top, left) = (max((-(-n // stride) - 1) * stride + k - n, 0) for n, stride, k in sizes)
    if top == left == 0:
        return x
    return F.pad(x, (left // 2, left - left // 2, top // 2, top - top // 2), value=value)


def _resized(x: Tensor, size: int, axis: int) -> Tensor:
    """Linear between samples at i n/N along one axis."""
    count = x.shape[axis]
    at = torch.arange(size, dtype=x.dtype) * (count / size)
    low = at.floor().long()
    share = (at - low).reshape(-1, *[1] * (x.ndim - 1 - axis))
    return x.index_select(axis, low) * (1 - share) + x.index_select(axis, (low + 1).clamp(max=count - 1)) * share


def _activated(x: Tensor, kind: int) -> Tensor:
    """0: as it is, 1: ReLU, 3: ReLU up to 6, by the schema's numbers."""
    if kind == 0:
        return x
    return x.relu() if kind == 1 else x.clamp(0, 6)
