"""Bodies out of MJCF: a planar chain of hinges, read by MuJoCo's own compiler.

Everything is taken from the compiled model in its reference pose (qpos0), in world coordinates, so that no default, no
frame and no geom's density is interpreted here. With the hinges' common axis n, what moves together is one link, of

    length    from its hinge to the next one, in the plane across n; the last one's to its tip
    mass      Σ m,        com = that of all its parts, along the line from hinge to tip
    inertia   Σ nᵀ I n + m d² about the centre of mass, d across n

The plane is (x, z) for hinges about y, (x, y) about z, (y, z) about x: the recording's x and y. Angles need no
conversion: ours are Denavit–Hartenberg, seen in the picture, whatever pose the file calls zero. Where a robot's own
angles are wanted, q = ±(θ − θ₀), with θ₀ the angle of the link in the file's reference pose, and − for a hinge about
the axis that points away from the viewer; torques then change their sign too, and a warning says so.

Of the last link's sites the one farthest from its hinge is the tip; else the farthest frame of what is welded to it;
else the far end of a geom. What the file has and a rigid body lacks (damping, armature, dry friction, springs, limits,
gears, tendons) is left out and named in a warning: it is what a diagnosis then finds.
"""

import warnings
from pathlib import Path

import numpy as np

from invdyn.models.bodies.scalars import BodyError

PLANES = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
LEFT_OUT = {
    "dof_damping": "damping",
    "dof_frictionloss": "dry friction",
    "dof_armature": "armature",
    "jnt_stiffness": "a spring",
    "jnt_limited": "limits",
}
ASIDE = 1e-3
"""Of a length: what is nearer to a plane, or to a line, is on it."""


def read(path: str | Path) -> dict:
    """Return name, gravity, base and links of an MJCF file, as :func:`.body_toml.read` does.

    Warns (UserWarning) of what is left out. Raises `BodyError` for what MuJoCo cannot read, what is no planar chain of
    hinges, and a missing MuJoCo; `OSError` when the file cannot be read.
    """
    mujoco = engine(path)
    Path(path).read_bytes()  # for the plain OSError
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise BodyError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    return tables(model, str(path))


def engine(path: str | Path):
    """The mujoco package; raises `BodyError` where there is none."""
    try:
        import mujoco
    except ImportError as error:
        raise BodyError(f"{path}: MJCF and URDF need `pip install 'invdyn[robots]'`; TOML does without") from error
    return mujoco


def tables(model, where: str) -> dict:
    """The body's tables of a compiled ``mujoco.MjModel``; see :func:`read`."""
    mujoco = engine(where)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    joints, groups = _chain(mujoco, model, where)
    axis, signs = _axis(data.xaxis[joints], [model.joint(j).name for j in joints], where)
    u, v, normal = _frame(axis)
    plane = np.stack([u, v])
    hinges = data.xanchor[joints] @ plane.T
    tip_name, tip = _tip(mujoco, model, data, joints[-1], groups[-1], plane, where)
    ends = [*hinges[1:], tip]
    names = [model.joint(j).name or f"joint{k + 1}" for k, j in enumerate(joints)]
    links, notes = [], []
    for k, (start, end) in enumerate(zip(hinges, ends, strict=True)):
        body = model.body(int(model.jnt_bodyid[joints[k]]))
        name = body.name or f"link{k + 1}"
        length = float(np.linalg.norm(end - start))
        if length <= 0:
            raise BodyError(f"{where}: link '{name}' has no length: its hinge and its end are at one place")
        mass, com, inertia = _inertial(model, data, groups[k], plane, normal)
        along = (end - start) / length
        (across, outwards) = (com - start) @ np.array([[-along[1], along[0]], along]).T
        reach, aside = float(outwards), float(across)
        if abs(aside) > ASIDE * length:
            notes.append(f"that the centre of mass of {name} is {aside:.3g} m beside the line of its joints")
        # about the hinge the inertia stays what it is
        inertia += mass * aside**2
        shown = names[k + 1] if k + 1 < len(joints) else tip_name
        given = {"length": length, "mass": mass, "com": reach, "inertia": inertia}
        links.append({"name": name, "joint": names[k], "tip": shown, **given})
    _warn(model, joints, names, signs * normal[axis] < 0, notes, where)
    gravity = plane @ model.opt.gravity
    return {
        "name": Path(where).stem,
        "gravity": [float(g) for g in gravity],
        "base": [float(b) for b in hinges[0]],
        "links": links,
    }


def _chain(mujoco, model, where: str) -> tuple[list[int], list[list[int]]]:
    """Hinges from the base outwards, and the bodies that each one's link is made of."""
    if not model.njnt:
        raise BodyError(f"{where}: expected a chain of hinges, got a body without joints")
    for j in range(model.njnt):
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            kind = mujoco.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower()
            raise BodyError(f"{where}: expected hinges alone, joint '{model.joint(j).name}' is of type {kind}")
    joints: list[int] = []
    group_of = {0: -1}
    groups: list[list[int]] = []
    for b in range(1, model.nbody):  # parents come before their children
        parent = group_of[int(model.body_parentid[b])]
        count = int(model.body_jntnum[b])
        if count == 0:
            group_of[b] = parent
            if parent >= 0:
                groups[parent].append(b)
            continue
        if count > 1:
            raise BodyError(f"{where}: expected one hinge a body, '{model.body(b).name}' has {count}")
        if parent != len(groups) - 1:
            raise BodyError(f"{where}: expected a chain, but it branches at body '{model.body(b).name}'")
        group_of[b] = len(groups)
        joints.append(int(model.body_jntadr[b]))
        groups.append([b])
    return joints, groups


def _axis(axes: np.ndarray, names: list[str], where: str) -> tuple[int, np.ndarray]:
    """The number of the common axis (0 x, 1 y, 2 z), and along or against it for each hinge."""
    axis = int(np.abs(axes[0]).argmax())
    for name, own in zip(names, axes, strict=True):
        if abs(own[axis]) < 1 - 1e-5:
            raise BodyError(
                f"{where}: expected all hinges about one of the axes x, y and z, so that the chain moves in a plane; "
                f"joint '{name}' turns about ({', '.join(f'{a:.3g}' for a in own)})"
            )
    return axis, np.sign(axes[:, axis])


def _frame(axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plane's x and y, and the axis towards the viewer."""
    u, v = (np.eye(3)["xyz".index(letter)] for letter in PLANES["xyz"[axis]])
    return u, v, np.cross(u, v)


def _inertial(model, data, bodies: list[int], plane: np.ndarray, normal: np.ndarray) -> tuple[float, np.ndarray, float]:
    mass = model.body_mass[bodies]
    com = data.xipos[bodies] @ plane.T
    # principal axes are the columns of ximat
    own = [model.body_inertia[b] @ (data.ximat[b].reshape(3, 3).T @ normal) ** 2 for b in bodies]
    total = float(mass.sum())
    centre = mass @ com / total if total > 0 else com[0]
    return total, centre, float(np.sum(own) + mass @ ((com - centre) ** 2).sum(-1))


def _tip(mujoco, model, data, joint: int, bodies: list[int], plane: np.ndarray, where: str) -> tuple[str, np.ndarray]:
    """Name and place (2,) of the end of the last link."""
    hinge = data.xanchor[joint]
    name = model.body(int(model.jnt_bodyid[joint])).name or "body"
    sites = [s for s in range(model.nsite) if model.site_bodyid[s] in bodies]
    points = [(model.site(s).name or f"{name}_tip", data.site_xpos[s]) for s in sites]
    if not points:
        points = [(model.body(b).name or f"{name}_tip", data.xpos[b]) for b in bodies[1:]]
    if not points:
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in bodies]
        points = [(f"{name}_tip", end) for g in geoms for end in _ends(mujoco, model, data, g)]
    far = max(points, key=lambda point: np.linalg.norm(plane @ (point[1] - hinge)), default=None)
    if far is None or np.linalg.norm(plane @ (far[1] - hinge)) == 0:
        raise BodyError(f"{where}: nothing says where the last link '{name}' ends: give it a site at its tip")
    return far[0], plane @ far[1]


def _ends(mujoco, model, data, geom: int) -> list[np.ndarray]:
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


def _warn(model, joints: list[int], names: list[str], clockwise: np.ndarray, notes: list[str], where: str) -> None:
    found = list(notes)
    for attribute, words in LEFT_OUT.items():
        values = getattr(model, attribute)
        index = model.jnt_dofadr[joints] if attribute.startswith("dof") else joints
        # newer MuJoCos have several coefficients here
        if having := [name for name, value in zip(names, values[index], strict=True) if np.any(value)]:
            found.append(f"{words} ({', '.join(having)})")
    geared = [model.actuator(a).name or str(a) for a in range(model.nu) if model.actuator_gear[a, 0] != 1]
    if geared:
        found.append(f"gears ({', '.join(geared)})")
    if model.ntendon or model.neq:
        found.append("tendons and equality constraints")
    if found:
        warnings.warn(f"{where}: a rigid body leaves out {'; '.join(found)}", UserWarning, stacklevel=4)
    against = [name for name, is_so in zip(names, clockwise, strict=True) if is_so]
    if against:
        warnings.warn(
            f"{where}: {', '.join(against)} turn{'s' * (len(against) == 1)} clockwise in the plane of the picture; "
            "a recording's torques and angles are counter-clockwise positive",
            UserWarning,
            stacklevel=4,
        )
