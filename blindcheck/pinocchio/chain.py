"""A planar chain in Pinocchio, with conventions of its own, and its dynamics in the body's angles.

Featherstone's recursive algorithms (Rigid Body Dynamics Algorithms, Springer 2008) as Pinocchio has them (Carpentier
et al., IEEE SII 2019). The arm moves in a robot's x–z plane. Angles φ are its own: that of the first joint counts from
hanging, those of the others between the two links, π where they are stretched out. With θ of `invdyn.models.Body`,

    θ₀ = φ₀ − π/2,     θₖ = π − φₖ     (σ = 1, zero −π/2; σ = −1, zero π; hidden hinges σ = 1, zero 0)

Shapes: K joints, S ≥ K hinges, N rows. SI units, radians.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.stretched import STANDARD_GRAVITY
from invdyn.models import Body


@dataclass
class Piece:
    """One rigid piece behind a hinge, in metres and kilograms; `joint` that drives it, `tip` at its end, or None."""

    length: float
    mass: float
    com: float
    inertia: float
    joint: int | None = None
    tip: int | None = None
    sign: float = 1.0
    zero: float = 0.0


class Chain:
    """Pieces of a body, which may be changed until :meth:`compile`.

    Raises ImportError, with what to install, when Pinocchio is missing.
    """

    def __init__(self, body: Body):
        self.pin = _pinocchio()
        self.num_joints = body.num_joints
        self.base, self.gravity = np.array(body.base), np.array(body.gravity)
        self.pieces = []
        for k, link in enumerate(body.links):
            length, mass, com, inertia = (link.nominal(key) for key in ("length", "mass", "com", "inertia"))
            convention = (-1.0, np.pi) if k else (1.0, -np.pi / 2)
            self.pieces.append(Piece(length, mass, com, inertia, k, k, *convention))
        self.rotors: dict[int, float] = {}  # joint → kg·m² in addition to the links'
        self.model: Any = None

    @property
    def possible(self) -> bool:
        """Whether every piece has a mass, and none a negative inertia."""
        return all(piece.mass > 0 and piece.inertia >= 0 for piece in self.pieces)

    def own(self, joint: int, angle: float) -> float:
        """φ at a body's angle θ of a joint."""
        piece = self.pieces[self.hinge(joint)]
        return piece.sign * (angle - piece.zero)

    def sign(self, joint: int) -> float:
        """dφ/dθ of a joint: 1 or −1."""
        return self.pieces[self.hinge(joint)].sign

    def hinge(self, joint: int) -> int:
        """Index of the hinge that a joint's motor drives."""
        return next(s for s, piece in enumerate(self.pieces) if piece.joint == joint)

    def compile(self) -> None:
        """Build Pinocchio's model; later changes by mechanisms do nothing."""
        pin = self.pin
        model, parent, offset = pin.Model(), 0, np.zeros(3)
        for s, piece in enumerate(self.pieces):
            rotation = np.array(
                [[np.cos(piece.zero), 0, -np.sin(piece.zero)], [0, 1, 0], [np.sin(piece.zero), 0, np.cos(piece.zero)]]
            )
            hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, -piece.sign, 0.0]))
            parent = model.addJoint(parent, hinge, pin.SE3(rotation, offset), f"hinge{s}")
            about = np.eye(3) * max(piece.inertia, 1e-14)  # about x and z nothing turns
            model.appendBodyToJoint(
                parent, pin.Inertia(piece.mass, np.array([piece.com, 0.0, 0.0]), about), pin.SE3.Identity()
            )
            offset = np.array([piece.length, 0.0, 0.0])
        model.gravity.linear = np.array([self.gravity[0], 0.0, self.gravity[1]])
        own = np.zeros(model.nv)
        for joint, inertia in self.rotors.items():
            own[self.hinge(joint)] += inertia
        model.armature = own
        self.model, self.data = model, model.createData()
        self.at = [self.hinge(k) for k in range(self.num_joints)]
        self.signs = np.array([piece.sign for piece in self.pieces])
        self.zeros = np.array([piece.zero for piece in self.pieces])

    def ready(self) -> None:
        """Compile, unless that was done."""
        if self.model is None:
            self.compile()

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torques (N, S), N·m, of motions (N, S) in the body's angles; mechanisms' forces are left out."""
        self.ready()
        x, v, a = self.signs * (q - self.zeros), self.signs * qd, self.signs * qdd
        return self.signs * np.array([self.pin.rnea(self.model, self.data, *row) for row in zip(x, v, a, strict=True)])

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """The inertia matrix, kg·m² (S, S), at a posture (S,) in the body's angles."""
        self.ready()
        upper = np.triu(self.pin.crba(self.model, self.data, self.signs * (q - self.zeros)))
        return np.outer(self.signs, self.signs) * (upper + np.triu(upper, 1).T)

    def mobility(self) -> np.ndarray:
        """The largest mobilities (K,), 1/(kg·m²), of the joints, stretched out and folded at right angles."""
        bent = np.array([0.0 if piece.joint is None else np.pi / 2 for piece in self.pieces])
        inverses = [np.linalg.inv(self.inertia(q) + np.diag(self.model.armature)) for q in (0 * bent, bent)]
        return np.max([np.diagonal(each)[self.at] for each in inverses], axis=0)

    def fastest_swing(self) -> float:
        """The highest angular frequency, rad/s, at which the arm swings about hanging straight, under 9.81 m/s²."""
        lengths, masses, coms = (np.array([getattr(p, key) for p in self.pieces]) for key in ("length", "mass", "com"))
        beyond = masses * coms + lengths * (masses.sum() - np.cumsum(masses))
        straight = np.where(np.arange(len(lengths)) == 0, -np.pi / 2, 0.0)
        absolute = np.tril(np.ones((len(lengths), len(lengths))))  # headings of hinge angles
        stiffness = STANDARD_GRAVITY * absolute.T @ np.diag(beyond) @ absolute
        driven = [s for s in range(len(lengths)) if self.pieces[s].joint is not None]
        pick = np.ix_(driven, driven)
        square = np.linalg.eigvals(np.linalg.solve(self.inertia(straight)[pick], stiffness[pick])).real.max()
        return float(np.sqrt(max(square, 1e-6)))


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError as error:
        raise ImportError("this reality needs Pinocchio: pip install 'invdyn[robots]'") from error
    return pinocchio
