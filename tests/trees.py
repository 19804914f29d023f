"""Bodies in space to try the dynamics on, and the same in MuJoCo and Pinocchio."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.dh import Inertial, Row, from_dh
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.rotations import UNTURNED
from invdyn.models.bodies.tree_parameters import TreeParameters

F64 = torch.float64
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def paper_arm(gravity=(0.0, 0.0, -1.0)):
    """The paper's arm in space: two joints with yaw and pitch, uniform thin rods of unit length."""
    return Body(
        "paper's arm",
        [
            Link("upper_arm", Joint("shoulder", "universal"), length=1.0, tip="elbow_tip", mass=0.5),
            Link("forearm", Joint("elbow", "universal"), parent="upper_arm", length=1.0, tip="wrist", mass=0.3),
        ],
        gravity,
    )


def panda():
    """The Franka Emika Panda without its hand.

    Geometry, as a modified table: joints of mujoco_menagerie/franka_emika_panda/panda_nohand.xml (Apache-2.0).
    Inertial numbers: C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic identification of the
    Franka Emika Panda robot with retrieval of feasible parameters using penalty-based optimization", IEEE Robotics and
    Automation Letters 4 (2019), as printed in franka_description/robots/fer/inertials.yaml (Apache-2.0).
    """
    right = math.pi / 2
    table = [(0, 0, 0.333), (0, -right, 0), (0, right, 0.316), (0.0825, right, 0)]
    table += [(-0.0825, -right, 0.384), (0, right, 0), (0.088, right, 0)]
    inertials = [
        (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, 0.70661, 0.009117, -0.000139, 0.006772, 0.019169)),
        (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, 0.02811, 0.025995, -0.003925, 0.010254, 0.000704)),
        (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, 0.036155, 0.01083, -0.004761, -0.011396, -0.012805)),
        (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.019552, 0.028323, 0.007796, -0.001332, 0.008641)),
        (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, 0.029474, 0.008627, -0.002117, -0.004037, 0.000229)),
        (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.004354, 0.005433, 0.000109, -0.001158, 0.000341)),
        (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, 0.010027, 0.004815, -0.000428, -0.001196, -0.000741)),
    ]
    return from_dh("panda", [Row(*row) for row in table], [Inertial(*own) for own in inertials], tip="flange")


def twelve_joints() -> Body:
    """The Panda, and its first five links again at its end."""
    links = list(panda().links)
    for link in panda().links[:5]:
        joint = dataclasses.replace(link.joint, name=f"{link.joint.name}_again")
        links.append(dataclasses.replace(link, name=f"{link.name}_again", joint=joint, parent=links[-1].name))
    return Body("twelve joints", links)


def mobile_arm():
    """An arm of three hinges on a base that rolls in the plane and turns, with a mast and a gripper fixed to it."""
    rod = (0.002, 0.03, 0.03, 0.0, 0.001, 0.0)
    ball = (0.01, 0.01, 0.01, 0, 0, 0)
    slide = Joint("forward", "slide", (1.0, 0.0, 0.0))
    return Body(
        "mobile arm",
        [
            Link(
                "gripper",
                Joint("mount", "fixed"),
                parent="forearm",
                origin=(0.3, 0, 0.01),
                mass=0.2,
                inertia=ball,
                sites={"grasp": (0.1, 0, 0)},
            ),
            Link("cart_x", slide, mass=1.0, inertia=ball),
            Link("cart_y", Joint("sideways", "slide", (0.0, 1.0, 0.0)), parent="cart_x", mass=0.5, inertia=ball),
            Link(
                "cart",
                Joint("heading"),
                parent="cart_y",
                mass=12.0,
                com=(0.02, 0, 0.1),
                inertia=(0.3, 0.4, 0.5, 0, 0, 0),
            ),
            Link(
                "mast",
                Joint("bolts", "fixed"),
                parent="cart",
                origin=(0.1, 0, 0.3),
                mass=2.0,
                com=(0, 0, 0.2),
                inertia=ball,
            ),
            Link(
                "turret",
                Joint("turret"),
                parent="mast",
                origin=(0, 0, 0.4),
                mass=1.5,
                inertia=(0.01, 0.01, 0.015, 0, 0, 0),
            ),
            Link(
                "upper_arm",
                Joint("shoulder"),
                parent="turret",
                origin=(0.05, 0, 0),
                rotation=UPRIGHT,
                mass=1.2,
                com=(0.15, 0.01, 0),
                inertia=rod,
            ),
            Link(
                "forearm",
                Joint("elbow"),
                parent="upper_arm",
                origin=(0.3, 0, 0),
                mass=0.8,
                com=(0.12, 0, 0.02),
                inertia=rod,
            ),
        ],
    )


def random_tree(K, seed):
    """A tree of K coordinates: any joint types, branches, lumped links, oblique axes and bodies without symmetry."""
    rng = np.random.default_rng(seed)
    widths = {"hinge": 1, "slide": 1, "universal": 2, "ball": 3, "translation": 3, "free": 6, "fixed": 0}
    links, left = [], K
    while left or len(links) < 2:
        kinds = [kind for kind, width in widths.items() if width <= left and (width or links)]
        kind = str(rng.choice([kind for kind in kinds if kind != "free" or not links]))
        left -= widths[kind]
        spread = rng.normal(size=(3, 3)) * 0.1
        second = spread @ spread.T + 0.01 * np.eye(3)
        inertia = np.trace(second) * np.eye(3) - second
        name = f"link{len(links)}"
        chart = {"universal": ("zy", "xz", "yx"), "ball": ("zyx", "zxz", "yxz"), "free": ("zyx", "xyz")}.get(
            kind, ("",)
        )
        joint = Joint(
            f"joint{len(links)}",
            kind,
            _axis(rng),
            str(rng.choice(chart)),
            _turn(rng) if kind in ("ball", "universal") else UNTURNED,
        )
        links.append(
            Link(
                name,
                joint,
                parent=str(rng.choice([link.name for link in links[-3:]] or ["world"])),
                origin=(rng.normal(size=3) * 0.3).tolist(),
                rotation=_turn(rng),
                mass=float(rng.uniform(0.3, 3)),
                com=(rng.normal(size=3) * 0.1).tolist(),
                inertia=inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)].tolist(),
                sites={f"site{len(links)}": rng.normal(size=3).tolist()},
            )
        )
    return Body(f"random {seed}", links, rng.normal(size=3) * 5)


def _axis(rng):
    axis = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) if rng.random() < 0.5 else rng.normal(size=3)
    return tuple((axis / np.linalg.norm(axis)).tolist())


def _turn(rng):
    if rng.random() < 0.3:
        return UPRIGHT
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return tuple(map(tuple, (q * np.linalg.det(q)).tolist()))


def random_state(K, seed, batch=(), dtype=F64):
    """q, q̇ and torques (or accelerations), (*batch, K) each; no angle is near a multiple of 90°, where charts end."""
    rng = torch.Generator().manual_seed(seed)

    def uniform(low, high):
        return low + (high - low) * torch.rand(*batch, K, generator=rng, dtype=F64)

    q = uniform(0.3, 1.2) + math.pi / 2 * uniform(-2, 2).floor()
    return [value.to(dtype) for value in (q, uniform(-3, 3), uniform(-10, 10))]


class MuJoCo:
    """The tree in MuJoCo: each joint of several coordinates as several joints of one body."""

    def __init__(self, tree):
        self.mj = pytest.importorskip("mujoco")
        children = [[] for _ in range(len(tree.links) + 1)]
        for place, parent in enumerate(tree.parents):
            children[parent].append(place)
        self.model = self.mj.MjModel.from_xml_string(
            f"""<mujoco>
            <compiler boundmass="0" boundinertia="0" angle="radian"/>
            <option gravity="{_text(tree.gravity)}" timestep="1e-3" integrator="Euler">
              <flag energy="enable" contact="disable"/>
            </option>
            <worldbody>{self._bodies(tree, children, -1)}</worldbody>
            </mujoco>"""
        )
        self.data = self.mj.MjData(self.model)
        names = [motion.name for _, motion in tree.motions()]
        self.order = np.array([self.model.joint(name).dofadr[0] for name in names])
        self.sites = [self.model.site(name).id for name in tree.keypoint_names]

    def _bodies(self, tree, children, parent):
        xml = ""
        for place in children[parent]:
            link, p = tree.links[place], tree.parameters()
            reference = np.array(link.joint.reference)
            pose = np.array(link.rotation) @ reference
            joints = "".join(
                f'<joint name="{motion.name}" type="{"hinge" if motion.turns else "slide"}" '
                f'axis="{_text(reference.T @ motion.axis)}"/>'
                for motion in link.joint.motions()
            )
            inertial = (
                f'<inertial pos="{_text(p.com[place])}" mass="{p.mass[place].item()!r}" '
                f'fullinertia="{_text(p.inertia[place])}"/>'
            )
            sites = "".join(
                f'<site name="{name}" pos="{_text(p.sites[tree.keypoint_names.index(name)])}"/>' for name in link.points
            )
            pinned = f'pos="{_text(p.position[place])}" xyaxes="{_text(pose[:, :2].T.ravel())}"'
            xml += f"<body {pinned}>{joints}{inertial}{sites}{self._bodies(tree, children, place)}</body>"
        return xml

    def __call__(self, q, qd, qdd):
        """What it says of a state, in the order of the tree's motions."""
        mj, model, data, order = self.mj, self.model, self.data, self.order
        data.qpos[order], data.qvel[order] = q, qd
        mj.mj_forward(model, data)
        D = np.zeros((model.nv, model.nv))
        for row, unit in zip(D, np.eye(model.nv), strict=True):
            mj.mj_mulM(model, data, row, unit)
        jacobians = []
        for site in self.sites:
            jacobians.append(np.zeros((3, model.nv)))
            mj.mj_jacSite(model, data, jacobians[-1], None, site)
        found = {
            "inertia_matrix": D[np.ix_(order, order)],
            "bias": data.qfrc_bias[order].copy(),
            "kinetic_energy": data.energy[1],
            "potential_energy": data.energy[0],
            "keypoints": data.site_xpos[self.sites].copy(),
            "jacobian": np.stack(jacobians)[:, :, order] if jacobians else None,
        }
        data.qacc[order] = qdd
        mj.mj_inverse(model, data)
        return found | {"inverse": data.qfrc_inverse[order].copy()}


def _text(numbers):
    return " ".join(repr(float(x)) for x in numbers)


def pinocchio_of(tree):
    """Pinocchio, the tree as its model with one joint a coordinate, and where it has the tree's motions."""
    pin = pytest.importorskip("pinocchio")
    model, p, carriers = pin.Model(), tree.parameters(), {-1: (0, pin.SE3.Identity())}
    model.gravity.linear = np.array(tree.gravity)
    for place in _branch_by_branch(tree, -1):
        link = tree.links[place]
        at, pose = carriers[tree.parents[place]]
        pose = pose * pin.SE3(np.array(link.rotation), p.position[place].numpy())
        for motion in link.joint.motions():
            kind = pin.JointModelRevoluteUnaligned if motion.turns else pin.JointModelPrismaticUnaligned
            at = model.addJoint(at, kind(motion.axis), pose, motion.name)
            pose = pin.SE3.Identity()
        pose = pose * pin.SE3(np.array(link.joint.reference), np.zeros(3))
        carriers[place] = at, pose
        xx, yy, zz, xy, xz, yz = p.inertia[place].tolist()
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        model.appendBodyToJoint(at, pin.Inertia(p.mass[place].item(), p.com[place].numpy(), tensor), pose)
    return pin, model, np.array([model.idx_vs[model.getJointId(motion.name)] for _, motion in tree.motions()])


def _branch_by_branch(tree, parent):
    """Places of the links, depth first: Pinocchio wants what a joint carries in one piece."""
    for place, inner in enumerate(tree.parents):
        if inner == parent:
            yield place
            yield from _branch_by_branch(tree, place)


def parameters_in_space(p):
    """The numbers (...) of a chain in the plane for the dynamics of the same body in space."""

    def vectors(**entries):
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
        rotation=torch.eye(3, dtype=p.mass.dtype).expand(p.mass.shape[-1], 3, 3),
        sites=vectors(x=p.length),
        gravity=vectors(x=p.gravity[..., 0], y=p.gravity[..., 1]),
    )
