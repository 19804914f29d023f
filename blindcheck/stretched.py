"""A body stretched out: how far its links lie from the first joint, how far it reaches, how fast it hangs and swings.

Of a tree each link lies as far out as the way there through the joints is long. SI units.
"""

from typing import NamedTuple

import numpy as np

from invdyn.models import Body

STANDARD_GRAVITY = 9.81  # m/s²


class Stretched(NamedTuple):
    """By link (L,): `mass` kg, `far` m from the first joint to the centre of mass, `inertia` kg·m² about that.

    In space the inertia is the mean of the principal moments.
    """

    mass: np.ndarray
    far: np.ndarray
    inertia: np.ndarray


def stretched(body: Body) -> Stretched:
    """The links of a body, one behind the other."""
    p = body.in_space().parameters()
    inertia = p.inertia[:, 2] if body.is_chain else p.inertia[:, :3].mean(-1)
    return Stretched(p.mass.numpy(), joints_far(body) + np.linalg.norm(p.com.numpy(), axis=-1), inertia.numpy())


def joints_far(body: Body) -> np.ndarray:
    """How long the way from the first joint to each link's is, m (L,)."""
    steps = np.linalg.norm(body.in_space().parameters().position.numpy(), axis=-1)
    far = np.zeros(len(body.links))
    for link, parent in enumerate(body.parents):
        far[link] = far[parent] + steps[link] if parent >= 0 else 0.0
    return far


def reach(body: Body) -> float:
    """Length of the outstretched body to its farthest site, m."""
    sites = iter(np.linalg.norm(body.in_space().parameters().sites.numpy(), axis=-1))
    far = zip(joints_far(body), body.links, strict=True)
    return float(max(before + next(sites) for before, link in far for _ in link.points))


def pendulum_frequency(body: Body) -> float:
    """Hz, of the body hanging straight from its first joint, under 9.81 m/s² in any case."""
    mass, far, inertia = stretched(body)
    return float(np.sqrt(STANDARD_GRAVITY * (mass * far).sum() / (inertia + mass * far**2).sum()) / (2 * np.pi))
