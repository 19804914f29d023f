"""An arm whose base is carried about, played by MuJoCo: its base stands on three slides, whose motion is given."""

from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import mujoco
import numpy as np

from invdyn.models import Body, planar_body
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.mjcf_writer import write_mjcf

UPPER, FORE = (0.30, 2.0), (0.34, 1.6)
"""Length, m, and mass, kg, of a person's upper arm, and of forearm and hand."""


def person(dimensions=2) -> Body:
    """Shoulder and elbow of a person; in space a shoulder of two angles and an elbow of two, z up."""
    names = (("upper_arm", "shoulder", "elbow", *UPPER), ("forearm", "elbow", "wrist", *FORE))
    if dimensions == 2:
        return planar_body(
            "arm",
            [Link(link, joint, tip, length=length, mass=mass) for link, joint, tip, length, mass in names],
            gravity=(0.0, -9.81),
        )
    links = []
    for link, joint, tip, length, mass in names:
        about = mass * length**2 / 12
        links.append(
            Link(
                link,
                Joint(joint, "universal"),
                parent="upper_arm" if links else "world",
                tip=tip,
                length=length,
                mass=mass,
                inertia=(0.02 * about, about, about, 0.0, 0.0, 0.0),
            )
        )
    return Body("arm in space", links, (0.0, -9.81, 0.0))


class Carried:
    """MuJoCo's model of a body on three slides along x, y and z: coordinates are (b, q)."""

    def __init__(self, body: Body):
        self.body, self.axes = body, body.dimensions
        with TemporaryDirectory() as folder:
            file = Path(folder) / "arm.xml"
            write_mjcf(body, file)
            root = ElementTree.parse(file).getroot()
        world = root.find("worldbody")
        carrier = ElementTree.Element("body", name="carrier")
        for name, axis in zip("xyz", np.eye(3), strict=True):
            way = " ".join(map(str, axis))
            ElementTree.SubElement(carrier, "joint", name=f"slide_{name}", type="slide", axis=way)
        ElementTree.SubElement(carrier, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        for each in world.findall("body"):
            world.remove(each)
            carrier.append(each)
        world.append(carrier)
        for part in root.findall("actuator"):
            root.remove(part)
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self.sites = [self.model.site(name).id for name in body.keypoint_names]

    def points(self, b, q):
        """Base and sites, (T, 1 + S, d) m, of places b (T, d) and coordinates q (T, K)."""
        found = []
        for place, angles in zip(self._in_space(b), q, strict=True):
            self.data.qpos[:] = [*place, *angles]
            mujoco.mj_kinematics(self.model, self.data)
            found.append([place, *self.data.site_xpos[self.sites]])
        return np.array(found)[..., : self.axes]

    def torque(self, q, qd, qdd, b):
        """Torques (T, K) of a motion whose base has accelerations b (T, d), by MuJoCo's inverse dynamics."""
        found = []
        for angles, rates, bends, pushed in zip(q, qd, qdd, self._in_space(b), strict=True):
            self.data.qpos[:] = [0, 0, 0, *angles]
            self.data.qvel[:] = [0, 0, 0, *rates]
            self.data.qacc[:] = [*pushed, *bends]
            mujoco.mj_inverse(self.model, self.data)
            found.append(self.data.qfrc_inverse[3:].copy())
        return np.array(found)

    def falling(self, time, q, qd):
        """Coordinates (T, K) and places (T, d) of a fall from rest at ``q`` and ``qd`` (K,) without any force."""
        self.model.opt.timestep = 1e-4
        self.data.qpos[:], self.data.qvel[:] = [0, 0, 0, *q], [0, 0, 0, *qd]
        self.data.time, rows = 0.0, []
        for t in time - time[0]:
            while self.data.time < t - 5e-5:
                mujoco.mj_step(self.model, self.data)
            rows.append(self.data.qpos.copy())
        rows = np.array(rows)
        return rows[:, 3:], rows[:, : self.axes]

    def _in_space(self, b):
        return np.concatenate([b, np.zeros((len(b), 3 - b.shape[1]))], 1)
