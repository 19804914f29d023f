"""Traced programs without gradients, as machine code: torch's numbers to the last bit, in a fraction of its time.

torch takes one operation after the other over all particles, and each costs microseconds for any number of them. The
machine code (:mod:`.machine_code`) takes all operations for a block of particles, then for the next. Angles' cosines
and sines are computed there too.

Compiling pays where a program runs often. As both ways give the same bits, it is only a matter of time which one runs:
a program is compiled once torch has spent on it about what compiling costs (the ski-rental rule: Karlin, Manasse,
Rudolph and Sleator 1988).

Arguments lie by column, (columns, B, N): B bodies with N particles each, or B = 1 where all have the same body.
"""

import ctypes
import logging
import math
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor
from torch.autograd import forward_ad

from invdyn.models.dynamics.traced.machine_code import MachineCode, lanes, machine_code
from invdyn.models.dynamics.traced.programs import Program
from invdyn.models.dynamics.traced.sincos import inputs

PAYS = 20
"""Calls of torch that cost what compiling does; particles beyond the first of a call cost ``EACH`` of one more."""
EACH = 1 / 3000

_log = logging.getLogger(__name__)


def is_there() -> bool:
    """Whether there is a compiler (llvmlite, extra ``fast``)."""
    try:
        import llvmlite  # noqa: F401
    except ImportError:
        return False
    return True


def has_tangent(value: Tensor) -> bool:
    """Whether a derivative is carried forward with it, with or without ``no_grad``."""
    return forward_ad.unpack_dual(value).tangent is not None


def is_plain(*values: Tensor) -> bool:
    """Whether they are numbers of one type on the CPU, and no derivatives, records or transforms are needed."""
    if torch._C._len_torch_dispatch_stack() > 0 or torch._C._functorch.peek_interpreter_stack() is not None:
        return False
    learned, forward, dtype = torch.is_grad_enabled(), forward_ad._current_level >= 0, values[0].dtype
    for value in values:
        if value.dtype != dtype or not value.is_cpu or (learned and value.requires_grad):
            return False
        if forward and has_tangent(value):
            return False
    return True


class Compiled:
    """Machine code of programs, each compiled once it pays."""

    def __init__(self, after: float = PAYS) -> None:
        self._after = after
        self._code: dict[tuple, tuple[MachineCode, Program]] = {}
        self._spent: dict[int, float] = {}
        self._bodies: dict[str, tuple] = {}

    def pays(self, traced: Program, batch: Sequence[int]) -> bool:
        """Whether to run a program as machine code, for a ``batch`` of particles; decided once before each run."""
        spent = self._spent.get(id(traced), 0.0)
        self._spent[id(traced)] = spent + 1 + EACH * math.prod(batch)
        return spent >= self._after

    def __call__(
        self, method: str, traced: Program, joint: Mapping[str, Tensor], numbers: Sequence[Tensor], batch: Sequence[int]
    ) -> Tensor:
        """Outputs (*batch, O) of arguments (..., columns) by word, and of numbers (...), laid out by column."""
        like = next(iter(joint.values()))
        dtype = like.dtype
        body, own = self._body(method, numbers, batch, dtype)
        B = 1 if own or not numbers else body.shape[1]
        N = math.prod(batch) // B
        if not N:
            return like.new_empty(len(traced.source.results), *batch).movedim(0, -1)
        given: Sequence[Tensor] = [_by_column(joint[word], batch) for word in inputs(traced)]
        few = lanes(dtype) > N
        if few and given:  # all at once: this is every step of one body's simulation
            room = _filled(torch.cat([each.reshape(-1, B, N) for each in given]))
            given = room.split([len(each) for each in given])
        words = (ctypes.c_void_p * len(given))(*(each.data_ptr() for each in given))
        rows = len(traced.source.results)
        out = torch.empty(rows, B, max(N, lanes(dtype)), dtype=dtype)
        call = self._compiled(method, traced, dtype, own)
        call(words, body.data_ptr(), out.data_ptr(), B, out.shape[-1])
        return (out[..., :N] if few else out).reshape(rows, *batch).movedim(0, -1)

    def _body(self, method: str, numbers: Sequence[Tensor], batch: Sequence[int], dtype: torch.dtype) -> tuple:
        """Numbers (count, B), or (count, 1, N) where each particle has its own: True then.

        It is kept for as long as the same list of numbers comes.
        """
        known, of, found = self._bodies.get(method, (None, None, None))
        if known is not numbers or of != batch:
            split = _first_shared(numbers, len(batch))
            B, N = math.prod(batch[:split]), math.prod(batch[split:])
            own = N == 1 < B
            array = torch.empty(len(numbers), B, dtype=dtype)
            shape = (*batch[:split], *(1 for _ in batch[split:]))
            for row, number in zip(array, numbers, strict=True):
                row.copy_(number.detach().expand(shape).reshape(B))
            found = _filled(array[:, None, :]) if own else array, own
            self._bodies[method] = numbers, batch, found
        return found

    def _compiled(self, method: str, traced: Program, dtype: torch.dtype, own: bool) -> Callable[..., None]:
        key = (id(traced), own, dtype)
        if key not in self._code:
            # The program is kept with its code: the id of one that is gone could become another's.
            self._code[key] = machine_code(traced, dtype, own), traced
            _log.info("compiled %s of %d operations for %s", method, traced.operations, dtype)
        return self._code[key][0].call


def _first_shared(numbers: Sequence[Tensor], ndim: int) -> int:
    """The first dimension of the batch from which on all particles have the same body."""
    split = 0
    for number in numbers:
        for back, size in enumerate(reversed(number.shape), 1):
            if size != 1:
                split = max(split, ndim - back + 1)
                break
    return split


def _by_column(value: Tensor, batch: Sequence[int]) -> Tensor:
    """Columns (columns, *batch), each in one piece of memory: no copy of what lies so already."""
    if value.shape[:-1] != batch:
        value = value.expand(*batch, value.shape[-1])
    return value.movedim(-1, 0).contiguous()


def _filled(columns: Tensor) -> Tensor:
    """The same, with zeros up to one block where there are fewer particles."""
    missing = lanes(columns.dtype) - columns.shape[-1]
    return torch.nn.functional.pad(columns, (0, missing)) if missing > 0 else columns
