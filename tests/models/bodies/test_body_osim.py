"""OpenSim models: joints against the formulas of OpenSim's classes, written out here."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from invdyn.models import Body, BodyError, dynamics_for

FRAME = (
    '<PhysicalOffsetFrame name="{name}"><socket_parent>{on}</socket_parent><translation>{at}</translation>'
    "<orientation>{turned}</orientation></PhysicalOffsetFrame>"
)
BODY = (
    '<Body name="{name}"><mass>{mass}</mass><mass_center>0.1 -0.2 0.05</mass_center>'
    "<inertia>0.02 0.03 0.025 0.001 0 -0.002</inertia></Body>"
)
LINEAR = "<LinearFunction><coefficients>{slope} {offset}</coefficients></LinearFunction>"
CONSTANT = "<Constant><value>{value}</value></Constant>"
CURVE = (
    "<MultiplierFunction><function><SimmSpline><x>-1 0 1 2</x><y>0.1 0.3 0.2 0.1</y></SimmSpline></function>"
    "<scale>2</scale></MultiplierFunction>"
)
PARENT, CHILD = ("0.1 0.2 0.3", "0.2 -0.4 0.6"), ("-0.05 0.3 0.02", "0.5 0.1 -0.3")


def coordinate(name, locked=False, default=0.0):
    return (
        f'<Coordinate name="{name}"><default_value>{default}</default_value>'
        f"<locked>{str(locked).lower()}</locked></Coordinate>"
    )


def joint(kind, name, parent, child, coordinates, inner="", ends=(PARENT, CHILD)):
    frames = [
        FRAME.format(name=f"{end}_{name}", on=on, at=at, turned=turned)
        for end, on, (at, turned) in (("outer", parent, ends[0]), ("inner", f"/bodyset/{child}", ends[1]))
    ]
    return (
        f'<{kind} name="{name}"><socket_parent_frame>outer_{name}</socket_parent_frame>'
        f"<socket_child_frame>inner_{name}</socket_child_frame><coordinates>{''.join(coordinates)}</coordinates>"
        f"<frames>{''.join(frames)}</frames>{inner}</{kind}>"
    )


def transform(*axes):
    return "".join(
        f"<TransformAxis><coordinates>{name}</coordinates><axis>{axis}</axis>{function}</TransformAxis>"
        for name, axis, function in axes
    ).join(("<SpatialTransform>", "</SpatialTransform>"))


def model(joints, bodies=("arm",), more=""):
    marker = (
        '<Marker name="{0}_m"><socket_parent_frame>/bodyset/{0}</socket_parent_frame>'
        "<location>0.3 0.1 -0.2</location></Marker>"
    )
    return (
        '<OpenSimDocument Version="40000"><Model name="m"><gravity>0 -9.81 0</gravity><BodySet><objects>'
        + "".join(BODY.format(name=body, mass=1.5) for body in bodies)
        + f"</objects></BodySet><JointSet><objects>{''.join(joints)}</objects></JointSet>"
        + f"<MarkerSet><objects>{''.join(marker.format(body) for body in bodies)}</objects></MarkerSet>"
        + f"{more}</Model></OpenSimDocument>"
    )


def loaded(text, path):
    (path / "m.osim").write_text(text)
    return Body.load(path / "m.osim")


def pose(at, turned):
    """4 × 4 of an offset frame."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("XYZ", np.fromstring(turned, sep=" ")).as_matrix()
    found[:3, 3] = np.fromstring(at, sep=" ")
    return found


def moved(turns=(), shift=(0.0, 0.0, 0.0)):
    found = np.eye(4)
    found[:3, 3] = shift
    for axis, angle in turns:
        found[:3, :3] = found[:3, :3] @ Rotation.from_rotvec(np.array(axis) / np.linalg.norm(axis) * angle).as_matrix()
    return found


def marker(frame):
    """In our world, where z is up."""
    x, y, z, _ = frame @ [0.3, 0.1, -0.2, 1.0]
    return [x, -z, y]


def site(body, q):
    return dynamics_for(body).keypoints(torch.tensor(q, dtype=torch.float64), body.parameters()).numpy()


@pytest.mark.parametrize(
    ("kind", "names", "q", "turns", "shift"),
    [
        ("PinJoint", "a", [0.7], [((0, 0, 1), 0.7)], (0, 0, 0)),
        ("SliderJoint", "a", [0.7], [], (0.7, 0, 0)),
        ("UniversalJoint", "ab", [0.7, -0.4], [((1, 0, 0), 0.7), ((0, 1, 0), -0.4)], (0, 0, 0)),
        ("BallJoint", "abc", [0.7, -0.4, 1.2], [((1, 0, 0), 0.7), ((0, 1, 0), -0.4), ((0, 0, 1), 1.2)], (0, 0, 0)),
        ("PlanarJoint", "abc", [0.3, -0.2, 0.9], [((0, 0, 1), 0.9)], (0.3, -0.2, 0)),
    ],
)
def test_a_marker_moves_as_the_joint_says(kind, names, q, turns, shift, tmp_path):
    body = loaded(model([joint(kind, "j", "/ground", "arm", map(coordinate, names))]), tmp_path)
    assert set(body.joint_names) == set(names)
    frame = pose(*PARENT) @ moved(turns, shift) @ np.linalg.inv(pose(*CHILD))
    np.testing.assert_allclose(site(body, q)[0], marker(frame), atol=1e-12)


def test_a_kneecap_that_follows_the_knee_by_curves_alone_is_held(tmp_path):
    """A coordinate that a coupler drives need not move an axis by itself, as of OpenSim's own models of the leg."""
    inner = transform(
        ("beta", "0 0 1", CURVE),
        ("", "0 1 0", CONSTANT.format(value=0)),
        ("", "1 0 0", CONSTANT.format(value=0)),
        ("beta", "1 0 0", CURVE),
        ("", "0 1 0", CONSTANT.format(value=0)),
        ("", "0 0 1", CONSTANT.format(value=0)),
    )
    knee = joint("PinJoint", "knee", "/ground", "arm", [coordinate("a")])
    cap = joint("CustomJoint", "cap", "/bodyset/arm", "cap", [coordinate("beta")], inner)
    coupler = (
        '<ConstraintSet><objects><CoordinateCouplerConstraint name="follows"><dependent_coordinate_name>{}'
        "</dependent_coordinate_name></CoordinateCouplerConstraint></objects></ConstraintSet>"
    )
    with pytest.warns(UserWarning, match=r"\(a rotation of cap with beta, a shift of cap with beta\)"):
        body = loaded(model([knee, cap], ("arm", "cap"), coupler.format("beta")), tmp_path)
    assert body.joint_names == ("a",)
    held = moved([((0, 0, 1), 0.6)], (0.6, 0, 0))
    frame = pose(*PARENT) @ moved([((0, 0, 1), 0.7)]) @ np.linalg.inv(pose(*CHILD))
    frame = frame @ pose(*PARENT) @ held @ np.linalg.inv(pose(*CHILD))
    np.testing.assert_allclose(site(body, [0.7])[1], marker(frame), atol=1e-12)
    with pytest.raises(BodyError, match="coordinate 'beta' moves no axis by itself"):
        loaded(model([knee, cap], ("arm", "cap"), coupler.format("a")), tmp_path)


def test_a_custom_joint_has_axes_signs_offsets_and_curves(tmp_path):
    inner = transform(
        ("a", "0 3 4", LINEAR.format(slope=-1, offset=0.2)),
        ("", "1 0 0", CONSTANT.format(value=0.3)),
        ("b", "0 0 1", LINEAR.format(slope=1, offset=0)),
        ("a", "1 0 0", CURVE),
        ("c", "0 1 0", LINEAR.format(slope=1, offset=0.1)),
        ("", "0 0 1", CONSTANT.format(value=-0.4)),
    )
    names = [coordinate("a"), coordinate("b"), coordinate("c")]
    with pytest.warns(UserWarning, match=r"held where the model has them by default \(a shift of j with a\)"):
        body = loaded(model([joint("CustomJoint", "j", "/ground", "arm", names, inner)]), tmp_path)
    assert body.joint_names == ("c", "a", "b")
    turns = [((0, 3, 4), 0.2 - 0.8), ((1, 0, 0), 0.3), ((0, 0, 1), -0.5)]
    frame = pose(*PARENT) @ moved(turns, (2 * 0.3, 0.7 + 0.1, -0.4)) @ np.linalg.inv(pose(*CHILD))
    np.testing.assert_allclose(site(body, [0.7, 0.8, -0.5])[0], marker(frame), atol=1e-12)


def test_locked_coordinates_stand_where_the_file_puts_them(tmp_path):
    free = joint(
        "FreeJoint", "j", "/ground", "base", [coordinate(n, True, v) for n, v in zip("abcdef", VALUES, strict=True)]
    )
    pin = joint("PinJoint", "k", "/bodyset/base", "arm", [coordinate("q")])
    body = loaded(model([pin, free], ("arm", "base")), tmp_path)  # in any order
    assert body.joint_names == ("q",)
    turns = [((1, 0, 0), VALUES[0]), ((0, 1, 0), VALUES[1]), ((0, 0, 1), VALUES[2])]
    base = pose(*PARENT) @ moved(turns, VALUES[3:]) @ np.linalg.inv(pose(*CHILD))
    frame = base @ pose(*PARENT) @ moved([((0, 0, 1), 0.9)]) @ np.linalg.inv(pose(*CHILD))
    np.testing.assert_allclose(site(body, [0.9])[list(body.keypoint_names).index("arm_m")], marker(frame), atol=1e-12)


VALUES = (0.1, -0.2, 0.3, 0.5, 2.0, -0.4)


def test_gravity_pulls_down_and_the_weight_hangs_at_the_centre_of_mass(tmp_path):
    """About a level axis, z of OpenSim's ground, of a link whose frame is the joint's own."""
    ends = ("0 1 0", "0 0 0"), ("0 0 0", "0 0 0")
    body = loaded(model([joint("PinJoint", "j", "/ground", "arm", [coordinate("q")], ends=ends)]), tmp_path)
    q = torch.tensor([[0.0], [0.5]], dtype=torch.float64)
    load = dynamics_for(body).gravity_load(q, body.parameters()).numpy()[:, 0]
    lever = [0.1 * np.cos(a) + 0.2 * np.sin(a) for a in (0.0, 0.5)]  # of the com (0.1, −0.2)
    np.testing.assert_allclose(load, 1.5 * 9.81 * np.array(lever), atol=1e-12)
    inertia = dynamics_for(body).inertia_matrix(q, body.parameters()).numpy()
    np.testing.assert_allclose(inertia[0, 0, 0], 0.025 + 1.5 * (0.1**2 + 0.2**2), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model([]), "expected a JointSet with joints, as OpenSim 4 writes it"),
        (model([joint("PinJoint", "j", "/bodyset/x", "arm", [coordinate("q")])]), "'j' hangs on no body"),
        (model([joint("PinJoint", "j", "/ground", "hand", [coordinate("q")])]), "expected a body of its own"),
        (model([joint("PinJoint", "j", "/ground", "arm", [coordinate("q")])], ("arm", "b")), "'b' hangs on nothing"),
        (model([joint("ScapulothoracicJoint", "j", "/ground", "arm", [coordinate("q")])]), "joint among PinJoint"),
        (model([joint("UniversalJoint", "j", "/ground", "arm", [coordinate("q")])]), "expected 2 coordinates, got 1"),
        (
            model([joint("PinJoint", "j", "/ground", "arm", [coordinate("q", default="x")])]).replace("1.5", "heavy"),
            "body 'arm': expected numbers as mass",
        ),
        (
            model(
                [
                    joint(
                        "CustomJoint",
                        "j",
                        "/ground",
                        "arm",
                        [coordinate("q")],
                        transform(*[("q", "0 0 1", LINEAR.format(slope=2, offset=0))] * 6),
                    )
                ]
            ),
            "coordinate 'q' moves no axis by itself",
        ),
    ],
)
def test_what_is_not_read_is_refused_in_one_line(text, message, tmp_path):
    with pytest.raises(BodyError, match=message) as refusal:
        loaded(text, tmp_path)
    assert "\n" not in str(refusal.value)
