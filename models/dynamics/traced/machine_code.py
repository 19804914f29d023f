"""A traced program as machine code: one loop over blocks of particles, written for LLVM and compiled by it.

The program is a straight line of +, −, × and ÷ (:mod:`.programs`), so that LLVM has nothing to find out: every line is
one instruction on a vector of particles, as many as fill 64 bytes. Cosines and sines of angles are lines as well
(:mod:`.sincos`). Compiling takes a tenth of a second where a just-in-time compiler
of Python takes several. Nothing is joined or reordered: each operation is rounded as torch rounds it, to the same bits,
and NaN and infinity are kept.

Shapes, for R results, M numbers of the body, B bodies and N ≥ ``lanes(dtype)`` particles of each:

    words    pointers to (columns, B, N), what moves, in the order of :func:`.sincos.inputs`
    numbers  (M, B), or (M, B, N) where each particle has a body of its own
    out      (R, B, N)

LLVM: C. Lattner and V. Adve, CGO 2004; reached through llvmlite (extra ``fast``).
"""

import ctypes
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import torch

from invdyn.models.dynamics.traced.programs import Lines, Program
from invdyn.models.dynamics.traced.sincos import ANGLE, FUNCTIONS, cosine_and_sine, inputs

BYTES = {torch.float32: 4, torch.float64: 8}


def lanes(dtype: torch.dtype) -> int:
    """Particles in a block: what a vector register of the widest kind holds, 64 bytes."""
    return 64 // BYTES[dtype]


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
    count, size = lanes(dtype), BYTES[dtype]
    i64, vector = ir.IntType(64), ir.VectorType(real, count)
    array, module = real.as_pointer(), ir.Module()
    kind = ir.FunctionType(ir.VoidType(), [array.as_pointer(), array, array, i64, i64])
    loop = ir.Function(module, kind, "loop")
    words, numbers, out, bodies, particles = loop.args

    begin, body, some, body_end, end = (loop.append_basic_block(n) for n in ("begin", "body", "block", "next", "end"))
    at = ir.IRBuilder(begin)
    starts = {word: at.load(at.gep(words, [i64(place)])) for place, word in enumerate(inputs(traced))}
    each = at.mul(bodies, particles)
    at.branch(body)
    of = ir.IRBuilder(body)
    b = of.phi(i64, "b")
    b.add_incoming(i64(0), begin)
    row = of.mul(b, particles)
    whole = of.sub(particles, i64(count))
    of.branch(some)

    at = ir.IRBuilder(some)
    first = at.phi(i64, "first")
    first.add_incoming(i64(0), body)
    # The last block is a whole one, too: it does some particles once more.
    here = at.add(row, at.select(at.icmp_signed("<", first, whole), first, whole))

    def column(start: Any, place: int) -> Any:
        """Where the block's lanes are in a column."""
        return at.bitcast(at.gep(start, [at.add(at.mul(i64(place), each), here)]), vector.as_pointer())

    def block(start: Any, place: int) -> Any:
        return at.load(column(start, place), align=size)

    def broadcast(place: int) -> Any:
        """One number for all lanes."""
        number = at.load(at.gep(numbers, [at.add(at.mul(i64(place), bodies), b)]))
        nothing = ir.Constant(vector, ir.Undefined)
        return at.shuffle_vector(
            at.insert_element(nothing, number, ir.IntType(32)(0)),
            nothing,
            ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count),
        )

    values = {}
    turning = {place for word, place in traced.moving if word in FUNCTIONS}
    turned = {place: _turned(block(starts[ANGLE], place), dtype, at) for place in sorted(turning)}
    source = traced.source
    for name, (word, place) in zip(source.arguments, traced.moving, strict=True):
        values[name] = turned[place][word] if word in FUNCTIONS else block(starts[word], place)
    values |= {name: block(numbers, place) if own else broadcast(place) for place, name in enumerate(source.numbers)}
    for place, value in enumerate(_results(source, values, at, vector)):
        at.store(value, column(out, place), align=size)
    after = at.add(first, i64(count))
    first.add_incoming(after, some)
    at.cbranch(at.icmp_signed("<", after, particles), some, body_end)

    of = ir.IRBuilder(body_end)
    following = of.add(b, i64(1))
    b.add_incoming(following, body_end)
    of.cbranch(of.icmp_signed("<", following, bodies), body, end)
    ir.IRBuilder(end).ret_void()
    return module


def _turned(angle: Any, dtype: torch.dtype, at: Any) -> dict[str, Any]:
    """Cos and sin of the angles in a vector, by word."""
    source = cosine_and_sine(dtype).source
    values = dict(zip(source.arguments, [angle], strict=True))
    return dict(zip(FUNCTIONS, _results(source, values, at, angle.type), strict=True))


def _results(source: Lines, given: Mapping[str, Any], at: Any, vector: Any) -> list[Any]:
    """Values of a program's results, of given ones by name: each line is written at the end of a block of code."""
    from llvmlite import ir

    def constant(x: float) -> Any:
        return ir.Constant(vector, [x] * vector.count)

    def clamped(x: Any, bound: Any) -> Any:
        low, high = at.fneg(bound), bound
        x = at.select(at.fcmp_ordered(">", x, high), high, x)
        return at.select(at.fcmp_ordered("<", x, low), low, x)

    operation = {
        "+": at.fadd,
        "-": at.fsub,
        "*": at.fmul,
        "/": at.fdiv,
        "neg": at.fneg,
        "round": partial(_by_llvm, "rint", at),
        "floor": partial(_by_llvm, "floor", at),
        "clamp": clamped,
        "choose": lambda condition, *both: at.select(at.fcmp_unordered("!=", condition, constant(0.0)), *both),
    }
    values = {**{name: constant(x) for name, x in source.literals.items()}, **given}
    for line in source.lines:
        values[line.name] = operation[line.kind](*(values[x] for x in line.operands))
    return [values[name] for name in source.results]


def _by_llvm(name: str, at: Any, x: Any) -> Any:
    """One of LLVM's own functions of a vector."""
    from llvmlite import ir

    full = f"llvm.{name}.v{x.type.count}{x.type.element.intrinsic_name}"
    function = at.module.globals.get(full) or ir.Function(at.module, ir.FunctionType(x.type, [x.type]), full)
    return at.call(function, [x])
