"""Dynamics of a tree in space, batched and differentiable: algorithms traced for the body, behind the common interface.

    D(q) q̈ + h(q, q̇) + c(q) = τ

as in the interface, for K coordinates that hinges (rad, N·m) and slides (m, N) have. What the tree states as 0 (and, of
rotations, ±1) is left out of the traced programs. Whether the `TreeParameters` that come agree is looked at once for
each: where they do not, or where a gradient of them is needed, a program that leaves less out is traced.
"""

import math
import pickle
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.spatial import articulated_bodies, composite_bodies, kinematics, newton_euler
from invdyn.models.dynamics.spatial.algebra import ZERO
from invdyn.models.dynamics.spatial.frames import Entry, frames_of
from invdyn.models.dynamics.spatial.kinematics import Motion
from invdyn.models.dynamics.traced.compiled import PAYS, Compiled, has_tangent, is_plain, is_there
from invdyn.models.dynamics.traced.expressions import Graph, Scalar
from invdyn.models.dynamics.traced.programs import Program, program
from invdyn.models.dynamics.traced.sincos import ANGLE, FUNCTIONS, turned
from invdyn.models.shapes import common, stacked

POSES = ((0.6, 1.1), (2.3, -0.7), (-1.9, 0.4))
"""Of coordinates, nothing special: a first value and a step, rad or m."""
RESISTS = 1e-10
"""Of a coordinate's own inertia: what is left of it, with those further out free, that still counts."""


class _Body(NamedTuple):
    """Parameters that came: the key of which of them are known to be 0 or ±1, and their common leading dimensions.

    ``is_plain``: no transform of torch.func wraps them.
    """

    p: Any
    structure: bytes
    batch: tuple[int, ...]
    is_plain: bool
    is_differentiated: bool
    has_tangent: bool


class SpatialDynamics(Dynamics):
    """What a tree does; interface, shapes and units as in `Dynamics`, with p a `TreeParameters`.

    What needs no gradient runs as machine code (extra `fast`) once a program has run about `compile_after` times: the
    same bits, sooner. 0 compiles at once, infinity never.
    `compile_after` and `rotors` are for direct use: a model says neither.

    Raises `BodyError` for a coordinate that nothing resists, unless `rotors` says that own inertias will be given.
    """

    def __init__(self, tree: Body, compile_after: float = PAYS, rotors: bool = False):
        self.tree, self.num_joints, self.space = tree, tree.num_joints, tree.dimensions
        self._nominal = tree.parameters()
        self._constants = [_constants(name, value) for name, value in self._nominal._asdict().items()]
        self._patterns: dict[bytes, list[np.ndarray]] = {}
        self._programs: dict[tuple, Program] = {}
        self._seen: _Body | None = None
        self._known: dict[tuple, tuple[Any, list]] = {}
        self._compiled, self._after = Compiled(compile_after) if is_there() else None, compile_after
        if not rotors:
            self._check_inertia()

    def __reduce__(self) -> tuple:
        """By its tree: programs are traced again, once for all copies in a process."""
        return _restored, (pickle.dumps(self.tree), self._after)

    def _entry(self, graph: Graph, known: Mapping[str, np.ndarray]) -> Entry:
        """Scalars of a `TreeParameters` by place: plain ones where they are ``known``, else arguments of a graph."""

        def entry(field: str, *place: int) -> Scalar:
            value = float(known[field][place])
            return graph.argument((field, place), moving=False) if math.isnan(value) else value

        return entry

    def operations(self, method: str) -> int:
        """Number of operations of a method's program for one state of the tree as it stands."""
        return self._program(method, self._body(self._nominal).structure).operations

    def inertia_matrix(self, q: Tensor, p: Any) -> Tensor:
        """D(q), kg·m² (kg for slides), (..., K, K)."""
        K = self.num_joints
        return self._evaluate("inertia_matrix", p, q=q).unflatten(-1, (K, K))

    def coriolis(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """h(q, q̇), N·m or N, (..., K)."""
        return self._evaluate("coriolis", p, q=q, qd=qd)

    def gravity_load(self, q: Tensor, p: Any) -> Tensor:
        """c(q) = ∂V/∂q, N·m or N, (..., K)."""
        return self._evaluate("gravity_load", p, q=q)

    def uniform_load(self, q: Tensor, field: Tensor, p: Any) -> Tensor:
        """The load c(q) in a gravity ``field`` (..., d) m/s² that may differ from one state to the next, (..., K)."""
        return self._evaluate("uniform_load", p, q=q, field=field)

    def forward(self, q: Tensor, qd: Tensor, tau: Tensor, p: Any, own_inertia: Tensor | None = None) -> Tensor:
        """q̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s² or m/s², (..., K)."""
        return self._evaluate("forward", p, q=q, qd=qd, tau=tau, own=own_inertia)

    def response(self, q: Tensor, tau: Tensor, p: Any, own_inertia: Tensor | None = None) -> Tensor:
        """(D + diag I_own)⁻¹ τ, rad/s² or m/s², (..., K)."""
        return self._evaluate("response", p, q=q, tau=tau, own=own_inertia)

    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: Any) -> Tensor:
        """τ = D q̈ + h + c, N·m or N, (..., K)."""
        return self._evaluate("inverse", p, q=q, qd=qd, qdd=qdd)

    def reactions(self, q: Tensor, qd: Tensor, qdd: Tensor, p: Any) -> Tensor:
        """Of each coordinate the force, N, and in space the moment, N·m, on what it carries, (..., K, 2 or 6).

        By what it hangs on, in the recording's axes, about the coordinate's own place; of a moment in the plane all is
        the torque. Weights are of ``p``: other loads, such as a hand's, are no part of it.
        """
        return self._evaluate("reactions", p, q=q, qd=qd, qdd=qdd).unflatten(-1, (self.num_joints, -1))

    def kinetic_energy(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """½ q̇ᵀ D q̇, J, (...)."""
        return self._evaluate("kinetic_energy", p, q=q, qd=qd).squeeze(-1)

    def potential_energy(self, q: Tensor, p: Any) -> Tensor:
        """V(q) = −Σ m g·r of all that moves, J, zero at the world's origin, (...)."""
        return self._evaluate("potential_energy", p, q=q).squeeze(-1)

    def keypoints(self, q: Tensor, p: Any) -> Tensor:
        """Positions of the S sites in the world's frame, m, (..., S, d)."""
        return self._evaluate("keypoints", p, q=q).unflatten(-1, (len(self.tree.keypoint_names), self.space))

    def jacobian(self, q: Tensor, p: Any) -> Tensor:
        """∂ keypoints / ∂q, m/rad (1 for slides), (..., S, d, K)."""
        shape = len(self.tree.keypoint_names), self.space, self.num_joints
        return self._evaluate("jacobian", p, q=q).unflatten(-1, shape)

    def site_velocities(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """ṙ = J q̇, m/s, (..., S, d)."""
        self._check(qd=qd)
        return (self.jacobian(q, p) @ qd[..., None, :, None]).squeeze(-1)

    def site_accelerations(self, q: Tensor, qd: Tensor, qdd: Tensor, p: Any) -> Tensor:
        """r̈ = J q̈ + J̇ q̇, m/s², (..., S, d)."""
        found = self._evaluate("site_accelerations", p, q=q, qd=qd, qdd=qdd)
        return found.unflatten(-1, (len(self.tree.keypoint_names), self.space))

    def _prepared(self, method: str, p: Any, with_own: bool = False) -> tuple[_Body, Program, list[Tensor]]:
        """What was seen of the body, a method's program for it, and the body's own coefficients in that."""
        body = self._body(p)
        traced = self._program(method, body.structure, with_own)
        return body, traced, self._numbers((method, body.structure, with_own), traced, p)

    def _evaluate(self, method: str, p: Any, **given: Tensor | None) -> Tensor:
        """Outputs (..., O) of a method's program, laid out by column."""
        joint = {name: value for name, value in given.items() if value is not None}
        self._check(**{name: value for name, value in joint.items() if name not in ("own", "field")})
        body, traced, numbers = self._prepared(method, p, "own" in joint)
        batch = common(body.batch, *(value.shape[:-1] for value in joint.values()))
        like = joint["q"]
        learned = body.has_tangent or (torch.is_grad_enabled() and body.is_differentiated)
        plain = not learned and is_plain(*joint.values(), *numbers[:1])
        if self._compiled and plain and self._compiled.pays(traced, batch):
            return self._compiled(method, traced, joint, numbers, batch)
        if any(word in FUNCTIONS for word in traced.words):  # as machine code has them, where that may come
            angles = joint[ANGLE]
            joint |= turned(angles) if self._compiled and plain else {"cos": angles.cos(), "sin": angles.sin()}
        columns = {word: joint[word].unbind(-1) for word in traced.words}
        outputs = traced.values([columns[word][place] for word, place in traced.moving], numbers)
        if not outputs:  # of a tree without sites
            return like.new_empty(*batch, 0)
        return stacked([x.expand(batch) if isinstance(x, Tensor) else like.new_full(batch, x) for x in outputs])

    def _program(self, method: str, structure: bytes, with_own: bool = False) -> Program:
        key = method, structure, with_own
        if key not in self._programs:
            graph = Graph()
            known = dict(zip(self._nominal._fields, self._patterns[structure], strict=True))
            K = self.num_joints

            def moving(word: str, count: int = K) -> list[Scalar]:
                return [graph.argument((word, place), moving=True) for place in range(count)]

            state = Motion(moving("q"), moving("cos"), moving("sin"), moving("qd"), moving("qdd"), moving("tau"))
            own = moving("own") if with_own else None
            frames = frames_of(self.tree, self._entry(graph, known), method not in OF_ITSELF)
            if method == "uniform_load":
                frames = replace(frames, gravity=[*moving("field", self.space), 0.0][:3])
            self._programs[key] = program(graph, TRACED[method](frames, state, own, self.space))
        return self._programs[key]

    def _numbers(self, key: tuple, traced: Program, p: Any) -> list[Tensor]:
        """The body's own coefficients, computed once for all stages of a row while the same body comes.

        Those of a learned body are computed each time, as each backward pass needs them.
        """
        body, numbers = self._known.get(key, (None, []))
        if body is not p:
            seen = self._body(p)
            with _outside(seen.is_plain):
                numbers = traced.numbers([getattr(p, field)[(..., *place)] for field, place in traced.constants])
            if seen.is_plain and not seen.is_differentiated:
                self._known[key] = p, numbers
        return numbers

    def _body(self, p: Any) -> "_Body":
        """What was seen of p when it came first."""
        if self._seen is None or self._seen.p is not p:
            is_plain = not any(map(torch._C._functorch.is_functorch_wrapped_tensor, p))
            with _outside(is_plain):
                pattern = [
                    np.full_like(known, np.nan)
                    if not is_plain or _is_differentiated(value)
                    else _agreeing(known, value)
                    for known, value in zip(self._constants, p, strict=True)
                ]
            structure = b"".join(np.isnan(known).tobytes() for known in pattern)
            self._patterns.setdefault(structure, pattern)
            batches = [value.shape[: value.ndim - known.ndim] for known, value in zip(pattern, p, strict=True)]
            self._seen = _Body(
                p, structure, common(*batches), is_plain, any(map(_is_differentiated, p)), any(map(has_tangent, p))
            )
        return self._seen

    def _check_inertia(self) -> None:
        """Raise `BodyError` for a coordinate that nothing resists, in any pose."""
        K = self.num_joints
        poses = torch.tensor([[first + step * k for k in range(K)] for first, step in POSES], dtype=torch.float64)
        D = self.inertia_matrix(poses, self._nominal).numpy().copy()
        own = D.diagonal(axis1=1, axis2=2).copy()
        for k in reversed(range(K)):  # what is left of it with the joints further out free
            resists = D[:, k, k] > RESISTS * own[:, k]
            if not resists.any():
                raise BodyError(
                    f"body '{self.tree.name}': nothing resists a torque at '{self.tree.joint_names[k]}': give what it "
                    "moves a mass away from its axis, or an inertia about it"
                )
            D, own = D[resists], own[resists]
            D = D - D[:, :, k, None] * D[:, k, None, :] / D[:, k, k, None, None]


@lru_cache(maxsize=16)
def _restored(tree: bytes, compile_after: float) -> SpatialDynamics:
    """Dynamics of a pickled tree, whose inertia was checked where it was pickled."""
    return SpatialDynamics(pickle.loads(tree), compile_after, rotors=True)


def _flat(nested: list) -> list:
    return list(chain.from_iterable(nested))


def _still(motion: Motion, *still: str) -> Motion:
    """The motion with these quantities 0."""
    return motion._replace(**{word: [0.0] * len(motion.q) for word in still})


OF_ITSELF = ("potential_energy", "reactions")
"""Programs that need each body's own inertia, not the regrouped one."""
TRACED = {
    "forward": lambda frames, motion, own, _: articulated_bodies.accelerations(frames, motion, own),
    "response": lambda frames, motion, own, _: articulated_bodies.accelerations(
        replace(frames, gravity=ZERO), _still(motion, "qd", "qdd"), own
    ),
    "inverse": lambda frames, motion, *_: newton_euler.torques(frames, motion),
    "reactions": lambda frames, motion, _, space: _flat(
        [force[:2] if space == 2 else [*force, *moment] for force, moment in newton_euler.reactions(frames, motion)]
    ),
    "coriolis": lambda frames, motion, *_: newton_euler.torques(replace(frames, gravity=ZERO), _still(motion, "qdd")),
    "gravity_load": lambda frames, motion, *_: newton_euler.torques(frames, _still(motion, "qd", "qdd")),
    "uniform_load": lambda frames, motion, *_: newton_euler.torques(frames, _still(motion, "qd", "qdd")),
    "kinetic_energy": lambda frames, motion, *_: [newton_euler.kinetic_energy(frames, motion)],
    "potential_energy": lambda frames, motion, *_: [kinematics.potential_energy(frames, motion)],
    "inertia_matrix": lambda frames, motion, *_: _flat(composite_bodies.inertia_matrix(frames, motion)),
    "keypoints": lambda frames, motion, _, space: _flat([x[:space] for x in kinematics.sites(frames, motion)]),
    "site_accelerations": lambda frames, motion, _, space: _flat(
        [x[:space] for x in kinematics.site_accelerations(frames, motion)]
    ),
    "jacobian": lambda frames, motion, _, space: _flat(
        _flat([rows[:space] for rows in kinematics.jacobian(frames, motion)])
    ),
}


def _constants(name: str, value: Tensor) -> np.ndarray:
    """The nominal numbers that programs may leave out, NaN for all others."""
    array = value.numpy()
    known = (array == 0) | ((name == "rotation") & (np.abs(array) == 1))
    return np.where(known, array, np.nan)


def _agreeing(known: np.ndarray, value: Tensor) -> np.ndarray:
    """What is known of an entry and true of all of ``value`` (..., *shape); NaN elsewhere."""
    if value.is_meta:  # it has a shape alone
        return np.full_like(known, np.nan)
    own = value.detach().cpu().double().numpy()
    return np.where((own == known).reshape(-1, *known.shape).all(0), known, np.nan) if known.size else known


def _outside(is_plain: bool) -> AbstractContextManager:
    """Outside of the transforms of torch.func, for numbers that none of them wraps, so that they can be kept."""
    return torch._C._DisableFuncTorch() if is_plain else nullcontext()


def _is_differentiated(value: Tensor) -> bool:
    return value.requires_grad or has_tangent(value)
