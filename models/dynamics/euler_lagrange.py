"""SymPy derives a planar chain's equation of motion by Euler–Lagrange and writes it as torch functions.

    T = Σ ½ m v·v + ½ I φ̇²      V = −Σ m g·r      d/dt ∂(T−V)/∂φ̇ − ∂(T−V)/∂φ = F

The generalised coordinates are the links' absolute angles φ = A θ (A: lower-triangular ones), in which the
terms stay short: M(φ) φ̈ + b(φ, φ̇) + G(φ) = F, each term a number of the body × cosines or sines × velocities.
Joint torques are τ = Aᵀ F, so D = Aᵀ M A, h = Aᵀ b, c = Aᵀ G. Units: SI and radians.

What is derived is kept as arithmetic (:mod:`.arithmetic`: data, and no program of anybody's) in a cache folder that is
the user's alone. A file is believed when, at bodies and states drawn anew, it gives what the recursion along the chain
does (:mod:`.planar_recursive`, which shares nothing with it); else it is derived again. A folder that cannot be written
costs only the seconds of deriving.
"""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
import torch

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.bodies.whole_file import read_whole, write_whole
from invdyn.models.dynamics.arithmetic import function
from invdyn.models.dynamics.planar_recursive import RecursiveDynamics

DERIVATION = 3  # raise it whenever this file's output changes, so that old cache files are left alone

# What each generated expression reads, in this order; `_symbols` has the scalars behind each word.
ARGUMENTS = {
    "inertia": ("phi", "length", "mass", "com", "inertia"),
    "coriolis": ("phi", "w", "length", "mass", "com"),
    "gravity_load": ("phi", "length", "mass", "com", "gravity"),
    "system": ("phi", "w", "length", "mass", "com", "inertia", "gravity"),
    "kinetic_energy": ("phi", "w", "length", "mass", "com", "inertia"),
    "potential_energy": ("phi", "length", "mass", "com", "gravity", "base"),
    "keypoints": ("phi", "length", "base"),
}
MOVING = ("phi", "w")
MOST_BYTES = 2**18
"""Bytes of a cache file; of four joints it has 5 kB."""
AGREES = 1e-8
"""Relative; rounding of both ways is 10⁻¹² of the largest term at most."""


@dataclass(frozen=True)
class Generated:
    """An expression of `ARGUMENTS` in two functions, from lists of scalar tensors to a list of them.

    `numbers` takes the words of the body and gives its coefficients, `values` the words of `MOVING`, then those.
    """

    numbers: Callable[..., list]
    values: Callable[..., list]


@dataclass(frozen=True)
class Equations:
    """SymPy expressions of a chain of K links in absolute angles φ and angular velocities w = φ̇; SymPy has no types.

    `symbols` maps "phi", "w", "length", "mass", "com", "inertia", "gravity", "base" to lists of symbols.
    """

    symbols: dict
    inertia: Any  # M, (K, K)
    coriolis: Any  # b, (K, 1)
    gravity_load: Any  # G, (K, 1)
    kinetic_energy: Any  # T
    potential_energy: Any  # V
    keypoints: Any  # tips, (K, 2)

    def in_joint_angles(self) -> tuple:
        """Return D (K, K), h (K, 1), c (K, 1) in the joint angles θ and velocities θ̇, and those symbols.

        These are the equations as papers print them: D θ̈ + h + c = τ.
        """
        import sympy as sp

        K = len(self.symbols["phi"])
        q, qd = sp.symbols(f"theta1:{K + 1}", real=True), sp.symbols(f"thetadot1:{K + 1}", real=True)
        A = sp.Matrix(K, K, lambda i, j: 1 if j <= i else 0)
        joint = dict(zip(self.symbols["phi"], A * sp.Matrix(q), strict=True))
        joint.update(zip(self.symbols["w"], A * sp.Matrix(qd), strict=True))
        M, b, G = (matrix.subs(joint) for matrix in (self.inertia, self.coriolis, self.gravity_load))
        return A.T * M * A, A.T * b, A.T * G, q, qd


def derive(num_joints: int) -> Equations:
    """Derive the `Equations` of a chain of `num_joints` links."""
    import sympy as sp
    from sympy.simplify.fu import TR8  # products of sines and cosines become those of sums and differences

    symbols = _symbols(num_joints)
    phi, w = symbols["phi"], symbols["w"]
    gravity, joint = sp.Matrix(symbols["gravity"]), sp.Matrix(symbols["base"])
    kinetic, potential, tips = sp.Integer(0), sp.Integer(0), []
    for k in range(num_joints):
        direction = sp.Matrix([sp.cos(phi[k]), sp.sin(phi[k])])
        com = joint + symbols["com"][k] * direction
        velocity = com.jacobian(phi) * sp.Matrix(w)
        kinetic += symbols["mass"][k] * velocity.dot(velocity) / 2 + symbols["inertia"][k] * w[k] ** 2 / 2
        potential -= symbols["mass"][k] * gravity.dot(com)
        joint = joint + symbols["length"][k] * direction
        tips.append(joint.T)
    kinetic, potential = sp.expand(TR8(sp.expand(kinetic))), sp.expand(potential)

    momentum = sp.Matrix([kinetic.diff(velocity) for velocity in w])
    coriolis = momentum.jacobian(phi) * sp.Matrix(w) - sp.Matrix([kinetic.diff(angle) for angle in phi])
    return Equations(
        symbols=symbols,
        inertia=momentum.jacobian(w),
        coriolis=coriolis.expand(),
        gravity_load=sp.Matrix([potential.diff(angle) for angle in phi]),
        kinetic_energy=kinetic,
        potential_energy=potential,
        keypoints=sp.Matrix.vstack(*tips),
    )


def torch_functions(num_joints: int, cache_dir: Path | str | None = None) -> dict[str, Generated]:
    """Return {name of `ARGUMENTS`: the functions of that expression}.

    M is given as its upper triangle, row by row; "system" returns that and then b + G. An output is a plain
    number where nothing depends on the arguments. `cache_dir` defaults to the user's cache folder.
    """
    folder = Path(cache_dir or platformdirs.user_cache_dir("invdyn"))
    path = folder / f"planar_chain_{num_joints}_sympy_{version('sympy')}_v{DERIVATION}.json"
    functions = _read_cache(path, num_joints)
    if functions is None:
        programs = generate(num_joints)
        _write_cache(path, programs)
        functions = _compile(programs, num_joints)
    return functions


def generate(num_joints: int) -> dict[str, dict[str, dict]]:
    """Derive the chain and return the programs of `arithmetic` of every name in `ARGUMENTS`."""
    eq = derive(num_joints)
    M = [eq.inertia[i, j] for i in range(num_joints) for j in range(i, num_joints)]
    outputs = {
        "inertia": M,
        "coriolis": list(eq.coriolis),
        "gravity_load": list(eq.gravity_load),
        "system": M + list(eq.coriolis + eq.gravity_load),
        "kinetic_energy": [eq.kinetic_energy],
        "potential_energy": [eq.potential_energy],
        "keypoints": list(eq.keypoints),
    }
    programs = {}
    for name in ARGUMENTS:
        body, numbers, steps, results = _share(outputs[name], eq.symbols)
        programs[name] = {"numbers": _program(body, list(numbers.values())), "values": _program(steps, results)}
    return programs


def _program(steps: list, results: list) -> dict:
    from sympy.printing.pycode import PythonCodePrinter

    printer = PythonCodePrinter({"fully_qualified_modules": False})
    named = {str(symbol): printer.doprint(expression) for symbol, expression in steps}
    return {"steps": named, "results": [printer.doprint(expression) for expression in results]}


def _symbols(K: int) -> dict[str, list]:
    import sympy as sp

    words = ("phi", "w", "length", "mass", "com", "inertia")
    symbols = {word: list(sp.symbols(f"{word}1:{K + 1}", real=True)) for word in words}
    return symbols | {word: list(sp.symbols(f"{word}_x {word}_y", real=True)) for word in ("gravity", "base")}


def _share(expressions: list, symbols: dict[str, list]) -> tuple[list, dict, list, list]:
    """Common subexpressions, such that a large batch costs few operations: of the body's numbers, and of the rest.

    Steps to the numbers; what each number is called, and what it is; steps from there on; results. The body's numbers
    are worked out on their own: they are one for each parameter set, the state one for each particle and row. Where cos
    and sin of φ are there anyway, those of φᵢ−φⱼ are built from them, since products are cheaper than cosines.
    """
    import sympy as sp

    names: dict[Any, Any] = {}  # coefficient → symbol

    def named(coefficient: Any) -> Any:
        sign = -1 if coefficient.could_extract_minus_sign() else 1
        coefficient = sp.factor(sign * coefficient)
        number, coefficient = coefficient.as_coeff_Mul()
        if coefficient.is_number:
            return sign * number * coefficient
        return sign * number * names.setdefault(coefficient, sp.Symbol(f"p{len(names)}"))

    trig = set().union(*(expression.atoms(sp.cos, sp.sin) for expression in expressions))
    products = any(function.args[0] in symbols["phi"] for function in trig)
    generators = sorted(trig | set(symbols["w"]), key=sp.default_sort_key)
    bases = [sp.expand_trig(generator) if products else generator for generator in generators]
    arranged = []
    for expression in expressions:
        total = sp.Integer(0)
        for powers, coefficient in sp.Poly(expression, *generators).terms():
            factors = [base**power for base, power in zip(bases, powers, strict=True)]
            total += named(coefficient) * sp.Mul(*factors)
        arranged.append(total)
    body, numbers = sp.cse(list(names), symbols=sp.numbered_symbols("k"))
    steps, results = sp.cse(arranged, symbols=sp.numbered_symbols("x"))
    return body, dict(zip(names.values(), numbers, strict=True)), steps, results


def _compile(programs: dict[str, dict[str, dict]], num_joints: int) -> dict[str, Generated]:
    names = {word: [f"{word}{k}" for k in range(1, num_joints + 1)] for word in ("phi", "w", *BodyParameters._fields)}
    names |= {word: [f"{word}_x", f"{word}_y"] for word in ("gravity", "base")}
    made = {}
    for name, words in ARGUMENTS.items():
        numbers, values = programs[name]["numbers"], programs[name]["values"]
        coefficients = [f"p{place}" for place in range(len(numbers["results"]))]
        moving, still = ([names[word] for word in words if (word in MOVING) == moves] for moves in (True, False))
        made[name] = Generated(function(still, numbers), function([*moving, coefficients], values))
    return made


def _right(functions: dict[str, Generated], num_joints: int) -> bool:
    """Whether they give what the recursion does, for bodies and states that nobody knows beforehand."""
    generator = np.random.default_rng()  # no result depends on it, and no file can be written for it

    def drawn(*shape: int) -> torch.Tensor:
        return torch.tensor(generator.normal(size=shape))

    length, mass, com, inertia = (drawn(4, num_joints).exp() for _ in range(4))
    body = BodyParameters(length, mass, com, inertia, 10 * drawn(4, 2), drawn(4, 2))
    phi, w = 3 * drawn(4, num_joints), 3 * drawn(4, num_joints)
    A = torch.ones(num_joints, num_joints, dtype=torch.float64).tril()
    back = torch.linalg.inv(A)
    q, qd = phi @ back.T, w @ back.T
    chain, upper = RecursiveDynamics(num_joints), torch.triu_indices(num_joints, num_joints)
    M = (back.T @ chain.inertia_matrix(q, body) @ back)[:, upper[0], upper[1]]
    b, G = (force @ back for force in (chain.coriolis(q, qd, body), chain.gravity_load(q, body)))
    expected = {
        "inertia": M,
        "coriolis": b,
        "gravity_load": G,
        "system": torch.cat([M, b + G], -1),
        "kinetic_energy": chain.kinetic_energy(q, qd, body)[:, None],
        "potential_energy": chain.potential_energy(q, body)[:, None],
        "keypoints": chain.keypoints(q, body).flatten(-2),
    }
    given = {"phi": phi, "w": w, **body._asdict()}
    for name, words in ARGUMENTS.items():
        moving, still = ([given[w].unbind(-1) for w in words if (w in MOVING) == moves] for moves in (True, False))
        outputs = functions[name].values(*moving, functions[name].numbers(*still))
        found = torch.stack([torch.as_tensor(x, dtype=torch.float64).expand(4) for x in outputs], -1)
        right = expected[name]
        if found.shape != right.shape or not (found - right).abs().max() <= AGREES * (1 + right.abs().max()):
            return False
    return True


def _read_cache(path: Path, num_joints: int) -> dict[str, Generated] | None:
    try:
        functions = _compile(json.loads(read_whole(path, MOST_BYTES)), num_joints)
        return functions if _right(functions, num_joints) else None
    except Exception:  # absent, broken or planted, whatever comes of it: derive again
        return None


def _write_cache(path: Path, programs: dict[str, dict[str, dict]]) -> None:
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        os.chmod(path.parent, 0o700)
        write_whole(path, json.dumps(programs))
    except OSError:
        pass  # read-only home: the next process derives again
