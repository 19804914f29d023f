"""Rigid parts out of MJCF, read by MuJoCo's own compiler.

Everything is taken from the compiled model with all hinges and slides at 0, in world coordinates, so that no default,
no frame and no geom's density is interpreted here. The compiler gets one text without files (:mod:`.body_mjcf_file`);
a ``mujoco.MjSpec`` or ``MjModel`` is taken as it is, with what it has in memory.
Friction, springs and motors of its joints are read as they stand (:mod:`.joint_parts_mjcf`). What the model has
besides is named (:mod:`.body_mjcf_left_out`): it is what a diagnosis then finds.
"""

import copy
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from invdyn.models.bodies import body_mjcf_left_out, joint_parts_mjcf
from invdyn.models.bodies.body_mjcf_file import one_text
from invdyn.models.bodies.joint_parts_mjcf import kept_warnings, without_disabled
from invdyn.models.bodies.parts import Part, PartJoint, Robot, listed
from invdyn.models.bodies.scalars import BodyError


def of(root: Element, where: str) -> Robot:
    """The parts of a parsed MJCF.

    Raises `BodyError` for what MuJoCo cannot read, files outside the folder, and a missing MuJoCo.
    """
    text, meshes, dropped = one_text(root, where)
    mujoco = engine(where)
    with own_warnings(mujoco, where):
        try:
            model = mujoco.MjModel.from_xml_string(text, meshes)
        except ValueError as error:
            raise BodyError(f"{where}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    return _robot(mujoco, model, dropped)


def of_compiled(robot: Any, where: str) -> Robot:
    """The parts of a ``mujoco.MjSpec`` or ``MjModel``, which stays as it is. Raises `BodyError` as :func:`of`."""
    mujoco = engine(where)
    with own_warnings(mujoco, where):
        model = compiled(robot, where)
    delays = np.flatnonzero(getattr(model, "actuator_delay", np.zeros(0)) > 0).tolist()
    plugins = [str(number) for number in range(model.nplugin)]
    return _robot(mujoco, model, {"plugins": plugins, "delays": [model.actuator(a).name or str(a) for a in delays]})


def compiled(robot: Any, where: str = "the robot") -> Any:
    """The ``mujoco.MjModel`` of a file, of an ``MjSpec``, or a copy of one; both stay as they are.

    Raises `BodyError` for what MuJoCo cannot read, and another object.
    """
    mujoco = engine(where)
    if isinstance(robot, mujoco.MjModel):
        return copy.copy(robot)
    if not isinstance(robot, str | Path | mujoco.MjSpec):
        raise BodyError(f"expected a robot as a file, a mujoco.MjSpec or a mujoco.MjModel, got {type(robot).__name__}")
    try:
        if isinstance(robot, mujoco.MjSpec):
            return robot.copy().compile()
        return mujoco.MjModel.from_xml_path(str(robot))
    except ValueError as error:
        raise BodyError(f"{where}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error


def _robot(mujoco: Any, model: Any, dropped: Mapping[str, Sequence[str]]) -> Robot:
    """The parts of a compiled model, which is changed; ``dropped`` are words → names of what it lacks by now."""
    data = mujoco.MjData(model)
    hinges_and_slides = np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE])
    data.qpos[model.jnt_qposadr[hinges_and_slides]] = 0  # where "ref" says otherwise
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    joints = _joints(mujoco, model, data)
    sites: dict[int, list[int]] = {}
    for site, body in enumerate(model.site_bodyid):
        sites.setdefault(int(body), []).append(site)
    parts = [_part(mujoco, model, data, b, joints.get(b, ()), sites.get(b, ())) for b in range(1, model.nbody)]
    names = joint_parts_mjcf.joint_names(model)
    disabled = listed("what the file switches off", without_disabled(mujoco, model))
    joint_parts, motors = joint_parts_mjcf.read(mujoco, model, names)
    beyond = disabled + [entry for words, dropped_names in dropped.items() for entry in listed(words, dropped_names)]
    left_out = body_mjcf_left_out.named(mujoco, model, names, motors) + beyond
    weightless = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return Robot(parts, np.zeros(3) if weightless else model.opt.gravity.copy(), left_out, joint_parts)


def engine(where: str) -> Any:
    """The mujoco package. Raises `BodyError` where there is none."""
    try:
        import mujoco
    except ImportError as error:
        raise BodyError(f"{where}: it needs `pip install 'invdyn[robots]'`; TOML and URDF do without") from error
    return mujoco


@contextmanager
def own_warnings(mujoco: Any, where: str) -> Iterator[None]:
    """MuJoCo's warnings as ours."""
    with kept_warnings(mujoco) as said:
        yield
    for line in dict.fromkeys(said):
        warnings.warn(f"{where}: MuJoCo: {' '.join(str(line).split())}", UserWarning, stacklevel=5)


def _joints(mujoco: Any, model: Any, data: Any) -> dict[int, list[PartJoint]]:
    """Body → its joints, in the order of the model's."""
    found: dict[int, list[PartJoint]] = {}
    for j, name in enumerate(joint_parts_mjcf.joint_names(model)):
        kind = mujoco.mjtJoint(int(model.jnt_type[j])).name.removeprefix("mjJNT_").lower()
        own = PartJoint(name, data.xanchor[j].copy(), data.xaxis[j].copy(), kind)
        found.setdefault(int(model.jnt_bodyid[j]), []).append(own)
    return found


def _part(mujoco: Any, model: Any, data: Any, body: int, joints: Sequence[PartJoint], sites: Sequence[int]) -> Part:
    turn = data.ximat[body].reshape(3, 3)  # principal axes are its columns
    name = model.body(body).name or f"link{body}"
    first = int(model.body_geomadr[body])
    geoms = range(first, first + int(model.body_geomnum[body]))
    return Part(
        name=name,
        parent=int(model.body_parentid[body]) - 1,
        mass=float(model.body_mass[body]),
        com=data.xipos[body].copy(),
        inertia=turn @ np.diag(model.body_inertia[body]) @ turn.T,
        origin=data.xpos[body].copy(),
        turn=data.xmat[body].reshape(3, 3).copy(),
        joints=joints,
        marks=[(model.site(s).name or f"{name}_tip", data.site_xpos[s].copy()) for s in sites],
        ends=[end for geom in geoms for end in _ends(mujoco, model, data, geom)],
    )


def _ends(mujoco: Any, model: Any, data: Any, geom: int) -> list[np.ndarray]:
    """The two ends of a geom along its longest axis, without a capsule's caps; a sphere's or a mesh's centre."""
    centre, turn, size = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
    if kind in ("CAPSULE", "CYLINDER"):
        half = turn[:, 2] * size[1]
    elif kind in ("BOX", "ELLIPSOID"):
        longest = int(size.argmax())
        half = turn[:, longest] * size[longest]
    else:
        half = np.zeros(3)
    return [centre - half, centre + half]
