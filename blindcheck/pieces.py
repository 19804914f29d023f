"""A body as rigid pieces behind hinges, in the order of its links, and where its sites are; mechanisms change pieces.

A planar chain is a tree whose hinges turn about z. Shapes: S pieces, P sites, N rows. SI units, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from invdyn.models import Body
from invdyn.models.bodies.inertia import tensor


@dataclass(eq=False)
class Piece:
    """One rigid piece behind a hinge about `axis`, at `position` and `turn` (3, 3) in the frame of its parent.

    In its own frame: `com` (3,), `inertia` (3, 3) about it, `sites` (3,). `joint` is the one whose angle the hinge adds
    to, None of a hidden hinge; `servo` its stiffness and damping.
    """

    hinge: str
    parent: "Piece | None"
    position: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    joint: int | None = None
    sites: dict[str, np.ndarray] = field(default_factory=dict)
    actuated: bool = False
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    servo: tuple[float, float] | None = None
    damping: float = 0.0

    @property
    def tip(self) -> np.ndarray:
        """Place (3,) of the first site: the end of a link in the plane."""
        return next(iter(self.sites.values()))


def pieces_of(body: Body) -> list[Piece]:
    """One for each link, with the damping and the servo that its joint has in the file."""
    tree, found = body.in_space(), list[Piece]()
    p, sites = tree.parameters(), iter(tree.parameters().sites.numpy())
    for place, (link, parts) in enumerate(zip(tree.links, tree.joint_parts, strict=True)):
        servo, inertia = parts.servo, p.inertia[place].numpy()
        found.append(
            Piece(
                hinge=f"joint{place}",
                parent=None if tree.parents[place] < 0 else found[tree.parents[place]],
                position=p.position[place].numpy(),
                turn=np.array(link.rotation),
                axis=np.array(link.joint.axis),
                mass=float(p.mass[place]),
                com=p.com[place].numpy(),
                # in the plane nothing turns about x and y; three equal moments are a body's that can be
                inertia=inertia[2] * np.eye(3) if body.is_chain else tensor(inertia),
                joint=place,
                sites={name: next(sites) for name in link.points},
                actuated=True,
                servo=None if servo is None else (servo.stiffness, servo.damping),
                damping=parts.damping,
            )
        )
    return found


def sites_at(pieces: Sequence[Piece], q: np.ndarray) -> np.ndarray:
    """Places (N, P, 3) of all sites at the hinges' angles (N, S)."""
    found, frames = list[np.ndarray](), dict[Piece, tuple[np.ndarray, np.ndarray]]()
    for piece, angle in zip(pieces, q.T, strict=True):
        # Rodrigues' formula: R (1 + sin φ K + (1 − cos φ) K²), K v = axis × v
        cross = np.cross(np.eye(3), piece.axis)
        fixed, by_sine, by_rest = (each[..., None] for each in piece.turn @ (np.eye(3), cross, cross @ cross))
        turn, place = fixed + np.sin(angle) * by_sine + (1 - np.cos(angle)) * by_rest, piece.position[:, None]
        if piece.parent is not None:
            outer, origin = frames[piece.parent]
            turn = np.einsum("ijn,jkn->ikn", outer, turn)
            place = origin + np.einsum("ijn,j->in", outer, piece.position)
        frames[piece] = turn, place
        found += [place + np.einsum("ijn,j->in", turn, site) for site in piece.sites.values()]
    return np.stack(found).transpose(2, 0, 1)
