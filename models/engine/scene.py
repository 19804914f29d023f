"""A MuJoCo model as sensors and posteriors see it: names of its sites, coordinates and bodies; whether it is usable.

What a file may hold is MuJoCo's to say. What no inference can use is refused here in one line: plugins, delays and
other memory that is no part of a state, more shapes than contacts can be searched for, more joints than slopes can be
taken for, a start inside the floor, and a simulation that has no inertia or runs away by itself.

Shapes: nq entries of qpos, nv degrees of freedom, na activations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from invdyn.models.bodies.body_mjcf import engine, own_warnings
from invdyn.models.bodies.body_mjcf_file import one_text
from invdyn.models.bodies.body_xml import MOST_BYTES, parse
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import read_whole
from invdyn.models.engine.chart import Chart
from invdyn.models.engine.drives import dof_names

KEPT_SECTIONS = ("keyframe", "sensor", "statistic")
"""Of a file, besides those that a body is made of."""
MAX_COLLIDING = 500
"""Shapes that may touch something, each of which may touch all others."""
MAX_FREEDOM = 200
"""Degrees of freedom: a row's slopes take a simulation for each, which takes longer the more there are."""
MAX_START_DEPTH = 0.02
"""m: a shape that starts deeper than this in another one is shot out of it."""
TRIAL, TRIAL_STEPS = 0.2, 10_000
"""s, and steps at most, of a simulation at rest that must not run away."""
POINT = "invdyn point "
"""What names of added sensors, of sites' places, begin with."""


class Gravity(NamedTuple):
    """(3,) m/s²."""

    gravity: torch.Tensor


@dataclass(frozen=True)
class Scene(ArticulatedBody):
    """A compiled MuJoCo model with sensors for all of its sites; the body that an observation is bound to.

    Attributes:
        model: the ``mujoco.MjModel``.
        name: of the model.
        dimensions: 3, or 2 where points are seen in a plane.
        plane: axes of the world that a point is seen by, (dimensions,).
        chart: of its configurations.
        reference: (nq,) configuration about which the chart is.
        points: columns of the model's sensor data with the sites' places, (S, 3).
        spec: the ``mujoco.MjSpec`` that it was compiled of; None in a worker.
    """

    model: Any
    name: str
    dimensions: int
    plane: tuple[int, ...]
    chart: Chart
    reference: np.ndarray
    points: np.ndarray
    spec: Any = field(repr=False)
    keypoint_names: tuple[str, ...] = ()

    @classmethod
    def of(cls, source: "str | Path | Any", *, dimensions: int = 3, where: str | None = None) -> "Scene":
        """Read a file (Path), a text (str) or a ``mujoco.MjSpec``, which is changed.

        With two ``dimensions`` keypoints have x and the coordinate along gravity. The chart is about the first
        keyframe, or else the file's own pose. Raises BodyError, one line, for what MuJoCo cannot read and what the top
        of the file names.
        """
        mujoco = engine(where or str(source)[:60])
        where = where or (str(source) if isinstance(source, Path) else "the model")
        with own_warnings(mujoco, where):
            try:
                spec = source if isinstance(source, mujoco.MjSpec) else _read(mujoco, source, where)
                if spec.plugins:
                    raise BodyError(f"{where}: plugins have states that cannot be inferred: remove them from the file")
                for number, geom in enumerate(spec.geoms):
                    geom.name = geom.name or f"geom{number}"
                for number, site in enumerate(spec.sites):
                    site.name = site.name or f"site{number}"
                    spec.add_sensor(
                        name=POINT + site.name,
                        type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
                        objtype=mujoco.mjtObj.mjOBJ_SITE,
                        objname=site.name,
                    )
                model = spec.compile()
            except BodyError:
                raise
            except ValueError as error:
                raise BodyError(f"{where}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
            _check(mujoco, model, where)
            _check_start(mujoco, model, where)
        chart = Chart.of(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr)
        up = int(np.argmax(np.abs(model.opt.gravity))) if np.any(model.opt.gravity) else 2
        plane = (0, 1, 2) if dimensions == 3 else (0 if up else 1, up)
        names = tuple(model.site(s).name for s in range(model.nsite))
        start = [int(model.sensor(POINT + name).adr[0]) for name in names]
        points = np.array(start, int)[:, None] + np.arange(3)
        reference = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
        title = spec.modelname if spec.modelname != "MuJoCo Model" else Path(where).stem
        return cls(model, title, dimensions, plane, chart, reference, points, spec, names)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"spec": None}  # which does not travel; workers compile nothing

    # -- what sensors ask a body for -------------------------------------------------------------
    @property
    def joint_names(self) -> tuple[str, ...]:
        """Of the nv degrees of freedom."""
        return dof_names(self.model)

    @property
    def num_joints(self) -> int:
        """Nv."""
        return int(self.model.nv)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Of its moving bodies."""
        return tuple(self.model.body(b).name or f"body{b}" for b in range(1, self.model.nbody))

    @property
    def gravity(self) -> Sequence[float]:
        """(3,) m/s²."""
        return self.model.opt.gravity.tolist()

    def parameters(self) -> "Gravity":
        """Gravity alone: MuJoCo keeps all other numbers."""
        return Gravity(torch.tensor(self.gravity, dtype=torch.float64))

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Of the file's actuators."""
        return tuple(self.model.actuator(a).name or f"actuator{a}" for a in range(self.model.nu))

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Of the file's own sensors."""
        names = [self.model.sensor(s).name for s in range(self.model.nsensor)]
        return tuple(name for name in names if name and not name.startswith("invdyn "))

    @property
    def reach(self) -> float:
        """M, the size of the moving bodies."""
        return float(np.clip(self.model.stat.extent, 1e-3, 10.0))

    @property
    def nonsmooth(self) -> bool:
        """Whether its motion has kinks: contacts, limits, dry friction."""
        from invdyn.models.bodies.body_mjcf_left_out import touching

        model = self.model
        limits = model.jnt_limited.any() or (model.ntendon and model.tendon_limited.any())
        dry = model.dof_frictionloss.any() or (model.ntendon and model.tendon_frictionloss.any())
        return bool(touching(engine(self.name), model)) or bool(limits or dry)


def _read(mujoco: Any, source: "str | Path", where: str) -> Any:
    content = read_whole(source, MOST_BYTES) if isinstance(source, Path) else source.encode()
    root = parse(content, where)
    if any(each.get("type") == "hfield" or "hfield" in each.attrib for each in root.iter("geom")):
        raise BodyError(f"{where}: a height field is not read: make the ground of planes, boxes or meshes")
    text, meshes, left_out = one_text(root, where, KEPT_SECTIONS)
    for words, names in left_out.items():
        raise BodyError(f"{where}: {words} ({', '.join(names)}) are no part of a state: remove them from the file")
    return mujoco.MjSpec.from_string(text, assets=meshes)


def _check(mujoco: Any, model: Any, where: str) -> None:
    """Raise BodyError for a model without motion, with other memory than qpos, qvel, act, or with too many shapes."""
    if model.nv == 0:
        raise BodyError(f"{where}: expected a joint, got none: nothing moves")
    if model.nv > MAX_FREEDOM:
        raise BodyError(f"{where}: expected at most {MAX_FREEDOM} degrees of freedom, got {model.nv}: weld some")
    if not model.opt.timestep > 0:
        raise BodyError(f"{where}: expected a timestep above 0 s, got {model.opt.timestep:g}")
    state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    if state != 1 + model.nq + model.nv + model.na:
        raise BodyError(f"{where}: plugins, delays and plastic parts have states that cannot be inferred: remove them")
    colliding = int(((model.geom_contype != 0) | (model.geom_conaffinity != 0)).sum())
    if colliding > MAX_COLLIDING:
        raise BodyError(
            f"{where}: expected at most {MAX_COLLIDING} shapes that may touch something, got {colliding}: set contype "
            "and conaffinity of the others to 0"
        )


def _check_start(mujoco: Any, model: Any, where: str) -> None:
    """Raise BodyError where shapes start inside one another, or a simulation at rest runs away."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    if data.ncon:
        deepest = int(np.argmin(data.contact.dist[: data.ncon]))
        depth = -float(data.contact.dist[deepest])
        if depth > MAX_START_DEPTH:
            pair = sorted(
                data.contact.geom[deepest].tolist(), key=lambda g: model.body_weldid[model.geom_bodyid[g]] == 0
            )
            one, other = (geom_name(model, g) for g in pair)
            raise BodyError(
                f"{where}: {one} starts {depth:.3g} m inside {other}: move the body, or exclude the pair from contact"
            )
    model_flags = model.opt.disableflags
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    try:
        for step in range(int(np.clip(TRIAL / model.opt.timestep, 1, TRIAL_STEPS))):
            mujoco.mj_step(model, data)
            if not (np.abs(data.qpos).max() < 1e6 and np.abs(data.qvel).max() < 1e6):
                raise BodyError(
                    f"{where}: the simulation runs away by itself after {(step + 1) * model.opt.timestep:.3g} s: a "
                    "smaller timestep, softer contacts or weaker servos keep it finite"
                )
        if (inertia := data.warning[mujoco.mjtWarning.mjWARN_INERTIA]).number:
            raise BodyError(
                f"{where}: the inertia at {dof_names(model)[inertia.lastinfo]} is not above 0: give its bodies mass, "
                "and no joint a negative armature or damping"
            )
    finally:
        model.opt.disableflags = model_flags


def geom_name(model: Any, geom: int) -> str:
    """Its name; that of its body, if it has none of its own, with its number where others of the body touch, too."""
    number = int(model.geom_bodyid[geom])
    own, body = model.geom(geom).name, model.body(number).name
    if own and (own != f"geom{geom}" or not body or body == "world"):
        return own
    touch = (model.geom_bodyid == number) & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return body if touch.sum() < 2 else f"{body} geom{geom}"
