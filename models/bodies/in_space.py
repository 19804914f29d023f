"""Planar bodies as bodies in space, and body files of either kind.

The plane is x–y, its hinges turn about z, and only moments about z play a part: the other moments are 0.
"""

import warnings
from pathlib import Path

import torch
from torch import Tensor

from invdyn.models.bodies import body_toml, body_xml, robot_file, tree_toml
from invdyn.models.bodies.body import Body, BodyParameters
from invdyn.models.bodies.body_chain import masses_aside
from invdyn.models.bodies.joints import WORLD, Joint
from invdyn.models.bodies.parts import is_planar_chain
from invdyn.models.bodies.spatial_link import SpatialLink
from invdyn.models.bodies.tree import Tree
from invdyn.models.bodies.tree_parameters import TreeParameters
from invdyn.models.bodies.whole_file import read_whole


def load_body(path: str | Path, *, filmed: bool = True, dimensions: int | None = None) -> Body | Tree:
    """Read a body file: TOML, MJCF or URDF; raises as `Body.load` and `Tree.from_mjcf` do.

    A TOML says dimensions = 3 for a `Tree`. A robot is a `Tree`, with every site of its file a keypoint, if
    ``dimensions`` is 3, as where a recording shows it in space; by default a chain of hinges about one of the axes x,
    y and z is a `Body`, and anything else a `Tree`. The content of a file says what it is, not its name.

    A chain in the plane has its centres of mass on the lines of its joints. A robot that has one beside them, and is
    not ``filmed`` in a plane, is a `Tree`, which takes it as it is; a warning (UserWarning) says so.
    """
    content = read_whole(path, body_xml.MOST_BYTES)
    if body_xml.is_xml(content):
        robot = robot_file.of(content, str(path))
        kind = Body if dimensions != 3 and is_planar_chain(robot.parts) else Tree
        if kind is Body and not filmed and (aside := masses_aside(robot, str(path))):
            words = "; ".join(aside)
            warnings.warn(f"{path}: taken as a body in space; in the plane it would leave out {words}", stacklevel=2)
            kind = Tree
        return kind.from_robot(robot, path)
    tables = body_toml.parse(content, str(path))
    return (Tree if tree_toml.is_in_space(tables, path) else Body).from_tables(tables, path)


def tree_of(body: Body) -> Tree:
    """Return a planar body as a tree, priors and learned scalars kept; of K joints and K sites, its tips."""
    links = []
    for place, link in enumerate(body.links):
        links.append(
            SpatialLink(
                name=link.name,
                joint=Joint(link.joint),
                parent=body.links[place - 1].name if place else WORLD,
                origin=None if place else (*body.base, 0.0),
                mass=link.mass,
                com=None if link.com is None else (link.com, 0.0, 0.0),
                inertia=None if link.inertia is None else (0.0, 0.0, link.inertia, 0.0, 0.0, 0.0),
                length=link.length,
                tip=link.tip,
                parts=link.parts,
            )
        )
    return Tree(body.name, links, (*body.gravity, 0.0))


def parameters_in_space(p: BodyParameters) -> TreeParameters:
    """Return the parameters (...) of a planar body for the dynamics of its tree; differentiable."""

    def vectors(**entries: Tensor) -> Tensor:
        like = next(iter(entries.values()))
        names = ("x", "y", "z") if "zz" not in entries else ("xx", "yy", "zz", "xy", "xz", "yz")
        return torch.stack([entries.get(name, torch.zeros_like(like)) for name in names], -1)

    base = vectors(x=p.base[..., 0], y=p.base[..., 1])
    steps = vectors(x=p.length[..., :-1])
    batch = torch.broadcast_shapes(base.shape[:-1], steps.shape[:-2])
    position = torch.cat([base.expand(*batch, 3).unsqueeze(-2), steps.expand(*batch, *steps.shape[-2:])], -2)
    return TreeParameters(
        mass=p.mass,
        com=vectors(x=p.com),
        inertia=vectors(zz=p.inertia),
        position=position,
        rotation=torch.eye(3, dtype=p.mass.dtype, device=p.mass.device).expand(p.mass.shape[-1], 3, 3),
        sites=vectors(x=p.length),
        gravity=vectors(x=p.gravity[..., 0], y=p.gravity[..., 1]),
    )
