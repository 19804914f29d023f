"""A body's pieces in Pinocchio, and their dynamics.

Featherstone's recursive algorithms (Rigid Body Dynamics Algorithms, Springer 2008) as Pinocchio has them (Carpentier
et al., IEEE SII 2019). Each piece is a body behind a revolute joint; angles are the body's.

Shapes: K joints, S ≥ K hinges, N rows. SI units, radians.
"""

from typing import Any

import numpy as np

from invdyn.blindcheck.pieces import Piece
from invdyn.blindcheck.stretched import STANDARD_GRAVITY
from invdyn.blindcheck.world import ChangeableBody
from invdyn.models import Body


class Dynamics(ChangeableBody):
    """Pieces of a body, which may be changed until :meth:`compile`.

    Raises ImportError, with what to install, when Pinocchio is missing.
    """

    def __init__(self, body: Body):
        self.pin = _pinocchio()
        super().__init__(body)
        self.rotors: dict[int, float] = {}  # joint → kg·m² in addition to the links'

    def compile(self) -> None:
        """Build Pinocchio's model."""
        pin = self.pin
        model = pin.Model()
        numbers: dict[Piece | None, int] = {None: 0}
        for piece in self.pieces:
            placed = pin.SE3(piece.turn, piece.position)
            hinge = pin.JointModelRevoluteUnaligned(piece.axis)
            number = numbers[piece] = model.addJoint(numbers[piece.parent], hinge, placed, piece.hinge)
            inertia = piece.inertia if piece.inertia.any() else 1e-14 * np.eye(3)
            model.appendBodyToJoint(number, pin.Inertia(piece.mass, piece.com, inertia), pin.SE3.Identity())
        model.gravity.linear = self.gravity
        own = np.zeros(model.nv)
        for joint, rotor in self.rotors.items():
            own[self.hinge(joint)] += rotor
        model.armature = own
        self.model, self.data = model, model.createData()
        self.at = [self.hinge(k) for k in range(self.num_joints)]

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torques (N, S), N·m, of motions (N, S); mechanisms' forces are left out."""
        self.ready()
        return np.array([self.pin.rnea(self.model, self.data, *row) for row in zip(q, qd, qdd, strict=True)])

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """The inertia matrix, kg·m² (S, S), at a posture (S,); without rotors."""
        self.ready()
        upper = np.triu(self.pin.crba(self.model, self.data, q))
        return np.asarray(upper + np.triu(upper, 1).T)

    def mobility(self) -> np.ndarray:
        """The largest mobilities (K,), 1/(kg·m²), of the joints, stretched out and folded at right angles."""
        bent = np.array([0.0 if piece.joint is None else np.pi / 2 for piece in self.pieces])
        inverses = [np.linalg.inv(self.inertia(q) + np.diag(self.model.armature)) for q in (0 * bent, bent)]
        return np.max([np.diagonal(each)[self.at] for each in inverses], axis=0)

    def fastest_swing(self) -> float:
        """The highest angular frequency, rad/s, at which the arm swings about hanging straight, under 9.81 m/s²."""
        straight = np.where(np.arange(len(self.pieces)) == 0, -np.pi / 2, 0.0)
        own = self.model.gravity.linear.copy()
        self.model.gravity.linear = np.array([0.0, -STANDARD_GRAVITY, 0.0])
        stiffness = self.pin.computeGeneralizedGravityDerivatives(self.model, self.data, straight)
        self.model.gravity.linear = own

        driven = [s for s, piece in enumerate(self.pieces) if piece.joint is not None]
        pick = np.ix_(driven, driven)
        square = np.linalg.eigvals(np.linalg.solve(self.inertia(straight)[pick], stiffness[pick])).real.max()
        return float(np.sqrt(max(square, 1e-6)))


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError as error:
        raise ImportError("this reality needs Pinocchio: pip install 'invdyn[robots]'") from error
    return pinocchio
