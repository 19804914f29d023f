"""A traced program as machine code: one loop over blocks of particles, written for LLVM and compiled by it.

The program is a straight line of +, −, × and ÷ (:mod:`.programs`), so that LLVM has nothing to find out: every line is
one instruction on a vector of ``LANES`` particles. Compiling takes a tenth of a second where a just-in-time compiler
of Python takes several. Nothing is joined or reordered: each operation is rounded as torch rounds it, to the same bits,
and NaN and infinity are kept.

Shapes, for R results, M numbers of the body, B bodies and N ≥ ``LANES`` particles of each:

    words    pointers to (columns, B, N), what moves, in the order of ``Program.words``
    numbers  (M, B), or (M, B, N) where each particle has a body of its own
    out      (R, B, N)

LLVM: C. Lattner and V. Adve, CGO 2004; reached through llvmlite (extra ``fast``).
"""

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import torch

from invdyn.models.dynamics.traced.programs import Program

LANES = 8
"""Particles in a block: in float64 what one vector register of the widest kind holds, in float32 two of them."""
BYTES = {torch.float32: 4, torch.float64: 8}


class MachineCode(NamedTuple):
    """``call(words, numbers, out, B, N)`` takes addresses; ``owner`` holds the code in memory."""

    call: Callable[..., None]
    owner: Any


def machine_code(traced: Program, dtype: torch.dtype, own: bool) -> MachineCode:
    """Compile a program for this processor; ``own`` says that each particle has numbers of its own."""
    from llvmlite import binding

    module = binding.parse_assembly(str(_module(traced, dtype, own)))
    module.verify()
    owner = binding.create_mcjit_compiler(module, _processor())
    owner.finalize_object()
    signature = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, ctypes.c_int64, ctypes.c_int64)
    return MachineCode(signature(owner.get_function_address("loop")), owner)


@cache
def _ready() -> Any:
    """The target of this machine."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple()


def _processor() -> Any:
    """A description of this processor; LLVM takes it over with the code."""
    from llvmlite import binding

    target = _ready()
    return target.create_target_machine(
        cpu=binding.get_host_cpu_name(), features=binding.get_host_cpu_features().flatten(), opt=2
    )


def _module(traced: Program, dtype: torch.dtype, own: bool) -> Any:
    """The loop in LLVM's language."""
    from llvmlite import ir

    real = ir.FloatType() if dtype == torch.float32 else ir.DoubleType()
    i64, vector, size = ir.IntType(64), ir.VectorType(real, LANES), BYTES[dtype]
    array, module = real.as_pointer(), ir.Module()
    kind = ir.FunctionType(ir.VoidType(), [array.as_pointer(), array, array, i64, i64])
    loop = ir.Function(module, kind, "loop")
    words, numbers, out, bodies, particles = loop.args

    begin, body, block, body_end, end = (loop.append_basic_block(n) for n in ("begin", "body", "block", "next", "end"))
    at = ir.IRBuilder(begin)
    starts = {word: at.load(at.gep(words, [i64(place)])) for place, word in enumerate(traced.words)}
    each = at.mul(bodies, particles)
    at.branch(body)
    of = ir.IRBuilder(body)
    b = of.phi(i64, "b")
    b.add_incoming(i64(0), begin)
    row = of.mul(b, particles)
    whole = of.sub(particles, i64(LANES))
    of.branch(block)

    at = ir.IRBuilder(block)
    first = at.phi(i64, "first")
    first.add_incoming(i64(0), body)
    # The last block is a whole one, too: it does some particles once more.
    here = at.add(row, at.select(at.icmp_signed("<", first, whole), first, whole))

    def column(start: Any, place: int) -> Any:
        """Where the block's lanes are in a column."""
        return at.bitcast(at.gep(start, [at.add(at.mul(i64(place), each), here)]), vector.as_pointer())

    def lanes(start: Any, place: int) -> Any:
        return at.load(column(start, place), align=size)

    def broadcast(place: int) -> Any:
        """One number for all lanes."""
        number = at.load(at.gep(numbers, [at.add(at.mul(i64(place), bodies), b)]))
        nothing = ir.Constant(vector, ir.Undefined)
        return at.shuffle_vector(
            at.insert_element(nothing, number, ir.IntType(32)(0)),
            nothing,
            ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES),
        )

    source = traced.source
    values = {name: ir.Constant(vector, [x] * LANES) for name, x in source.literals.items()}
    moving = zip(source.arguments, traced.moving, strict=True)
    values |= {name: lanes(starts[word], place) for name, (word, place) in moving}
    values |= {name: lanes(numbers, place) if own else broadcast(place) for place, name in enumerate(source.numbers)}
    operation = {"+": at.fadd, "-": at.fsub, "*": at.fmul, "/": at.fdiv, "neg": at.fneg}
    for line in source.lines:
        values[line.name] = operation[line.kind](*(values[x] for x in line.operands))
    for place, name in enumerate(source.results):
        at.store(values[name], column(out, place), align=size)
    after = at.add(first, i64(LANES))
    first.add_incoming(after, block)
    at.cbranch(at.icmp_signed("<", after, particles), block, body_end)

    of = ir.IRBuilder(body_end)
    following = of.add(b, i64(1))
    b.add_incoming(following, body_end)
    of.cbranch(of.icmp_signed("<", following, bodies), body, end)
    ir.IRBuilder(end).ret_void()
    return module
