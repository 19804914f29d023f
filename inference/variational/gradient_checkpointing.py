"""A function whose graph is not kept but computed again on the way back: memory for the price of a second forward pass.

:func:`torch.utils.checkpoint.checkpoint` keeps the nodes of the graph, if not their tensors: with small particles
that is most of the memory, and its hooks double the time.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def recomputed(
    function: Callable[..., tuple[Tensor, ...]], inputs: Sequence[Tensor], leaves: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """``function(*inputs)``, keeping no graph of it.

    ``inputs`` are of floating point. ``leaves`` are the tensors that require gradients and that ``function`` finds by
    itself, in Pyro's store. Gradients of gradients raise RuntimeError.
    """
    return _Stretch.apply(function, len(leaves), *leaves, *inputs)


class _Stretch(torch.autograd.Function):
    """Outputs of a function without its graph; backward calls it again, with the same random numbers."""

    @staticmethod
    def forward(ctx: Any, function: Callable[..., tuple[Tensor, ...]], num_leaves: int, *tensors: Tensor) -> Any:
        ctx.function, ctx.leaves = function, tensors[:num_leaves]
        ctx.save_for_backward(*tensors[num_leaves:])
        ctx.random = torch.get_rng_state()
        ctx.device = next((tensor.device for tensor in tensors if tensor.is_cuda), None)
        ctx.device_random = None if ctx.device is None else torch.cuda.get_rng_state(ctx.device)
        # Views, since what went in unchanged must not come out as the same tensor.
        return tuple(value.view_as(value) for value in function(*tensors[num_leaves:]))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        inputs = [tensor.detach().requires_grad_() for tensor in ctx.saved_tensors]
        with torch.random.fork_rng(devices=[] if ctx.device is None else [ctx.device]), torch.enable_grad():
            torch.set_rng_state(ctx.random)
            if ctx.device is not None:
                torch.cuda.set_rng_state(ctx.device_random, ctx.device)
            outputs = ctx.function(*inputs)
        pairs = [pair for pair in zip(outputs, gradients, strict=True) if pair[0].requires_grad]
        if not pairs:
            return None, None, *[None] * (len(ctx.leaves) + len(inputs))
        values, gradients = zip(*pairs, strict=True)
        found = torch.autograd.grad(values, [*ctx.leaves, *inputs], gradients, allow_unused=True)
        return None, None, *found
