"""Bodies out of MJCF: a planar chain of hinges, read by MuJoCo's own compiler, then :mod:`.body_chain`.

Everything is taken from the compiled model in its reference pose (qpos0), in world coordinates, so that no default, no
frame and no geom's density is interpreted here. The compiler gets one text without files (:mod:`.body_mjcf_file`).
Friction, springs and motors of its joints are read as they stand (:mod:`.joint_parts_mjcf`). What the model has besides
is named (:mod:`.body_mjcf_left_out`): it is what a diagnosis then finds.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from invdyn.models.bodies import body_mjcf_left_out, body_xml, joint_parts_mjcf
from invdyn.models.bodies.body_chain import Hinge, Part, listed, tables
from invdyn.models.bodies.body_mjcf_file import one_text
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import read_whole


def read(path: str | Path) -> dict:
    """Return name, gravity, base and links of an MJCF file, as :func:`.body_toml.read` does.

    Warns (UserWarning) of what is left out. Raises `BodyError` for what MuJoCo cannot read, files outside the folder,
    what is no planar chain of hinges, and a missing MuJoCo; `OSError` when the file cannot be read.
    """
    return of(body_xml.parse(read_whole(path, body_xml.MOST_BYTES), str(path)), str(path))


def of(root: Element, where: str) -> dict:
    """The tables of a parsed MJCF; see :func:`read`."""
    text, meshes, dropped = one_text(root, where)
    mujoco = _engine(where)
    with _own_warnings(mujoco, where):
        try:
            model = mujoco.MjModel.from_xml_string(text, meshes)
        except ValueError as error:
            raise BodyError(f"{where}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
    hinges = _hinges(mujoco, model, data, where)
    sites: dict[int, list[int]] = {}
    for site, body in enumerate(model.site_bodyid):
        sites.setdefault(int(body), []).append(site)
    parts = [_part(mujoco, model, data, b, hinges.get(b), sites.get(b, ())) for b in range(1, model.nbody)]
    joints, played = joint_parts_mjcf.read(mujoco, model)
    left_out = body_mjcf_left_out.named(mujoco, model, {h.name: j for j, h in enumerate(hinges.values())}, played)
    left_out += [entry for words, names in dropped.items() for entry in listed(words, names)]
    weightless = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return tables(parts, np.zeros(3) if weightless else model.opt.gravity.copy(), left_out, where, joints)


def _engine(where: str) -> Any:
    """The mujoco package; raises `BodyError` where there is none."""
    try:
        import mujoco
    except ImportError as error:
        raise BodyError(f"{where}: MJCF needs `pip install 'invdyn[robots]'`; TOML and URDF do without") from error
    return mujoco


@contextmanager
def _own_warnings(mujoco: Any, where: str) -> Iterator[None]:
    """MuJoCo's warnings as ours: by itself it writes them to a log in the folder where one happens to be."""
    before, said = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
    for line in dict.fromkeys(said):
        warnings.warn(f"{where}: MuJoCo: {' '.join(str(line).split())}", UserWarning, stacklevel=5)


def _hinges(mujoco: Any, model: Any, data: Any, where: str) -> dict[int, Hinge]:
    """Body → its hinge, in the order of the joints."""
    found: dict[int, Hinge] = {}
    for j in range(model.njnt):
        body = int(model.jnt_bodyid[j])
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            kind = mujoco.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower()
            raise BodyError(f"{where}: expected hinges alone, joint '{model.joint(j).name}' is of type {kind}")
        if body in found:
            count = int(model.body_jntnum[body])
            raise BodyError(f"{where}: expected one hinge a body, '{model.body(body).name}' has {count}")
        found[body] = Hinge(model.joint(j).name or f"joint{j + 1}", data.xanchor[j].copy(), data.xaxis[j].copy())
    return found


def _part(mujoco: Any, model: Any, data: Any, body: int, hinge: Hinge | None, sites: Sequence[int]) -> Part:
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
        hinge=hinge,
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
