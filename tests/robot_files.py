"""Files of robots to try readers on: random trees of joints as MJCF and URDF, with all that the formats allow."""

import numpy as np

DEFAULTS = """<default><joint damping="0.3"/><default class="arm"><joint axis="0 0 1" armature="0.01"/>
  <default class="rail"><joint type="slide" axis="0 1 0"/></default></default></default>"""


def random_mjcf(seed, bodies=7):
    """Nested classes, several joints a body off its origin, `ref`, fixed bodies, turns of every notation, sites.

    Masses come from inertial elements and from geoms.
    """
    rng = np.random.default_rng(seed)
    children: dict[int, list[int]] = {}
    for body in range(bodies):
        children.setdefault(-1 if body == 0 else int(rng.integers(max(-1, body - 3), body)), []).append(body)

    def written(body):
        joints = "".join(_joint(rng, f"j{body}_{i}") for i in range(int(rng.choice([0, 1, 1, 1, 2, 3]))))
        if body == 0 and not joints:
            joints = _joint(rng, "j0_0")
        weight = _inertial(rng) if rng.random() < 0.7 else f'<geom size=".1 .2 .05" type="box" pos="{_some(rng)}"/>'
        inner = "".join(written(child) for child in children.get(body, ()))
        site = f'<site name="s{body}" pos="{_some(rng)}"/>'
        return f'<body name="b{body}" pos="{_some(rng)}" {_turned(rng)}>{joints}{weight}{site}{inner}</body>'

    world = "".join(written(body) for body in children[-1])
    return f"""<mujoco><compiler angle="radian"/><option gravity="{_some(rng, 5)}"/>{DEFAULTS}
        <worldbody><body childclass="arm">{world}</body></worldbody></mujoco>"""


def random_urdf(seed, links=8):
    """Revolute, continuous, prismatic and fixed joints, turned everywhere; some links without an inertial element."""
    rng = np.random.default_rng(seed)
    text = '<robot name="random"><link name="l0"/>'
    for k in range(1, links):
        kind = "continuous" if k == 1 else str(rng.choice(["revolute", "continuous", "prismatic", "fixed"]))
        bare = kind == "fixed" and rng.random() < 0.5
        axis = rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)]
        a, b, c, d, e, f = _tensor(rng)
        inertia = f'<inertia ixx="{a!r}" iyy="{b!r}" izz="{c!r}" ixy="{d!r}" ixz="{e!r}" iyz="{f!r}"/>'
        inertial = f'<inertial>{_origin(rng)}<mass value="{rng.uniform(0.2, 2)!r}"/>{inertia}</inertial>'
        text += f'<link name="l{k}">{"" if bare else inertial}</link>'
        text += f"""<joint name="j{k}" type="{kind}"><parent link="l{rng.integers(max(0, k - 3), k)}"/>
            <child link="l{k}"/>{_origin(rng)}<axis xyz="{_text(axis)}"/>
            <limit lower="-9" upper="9" effort="1" velocity="1"/></joint>"""
    return text + "</robot>"


def _joint(rng, name):
    kinds = ['class="arm"', 'class="rail"', f'axis="{_some(rng)}"', f'type="slide" axis="{_some(rng)}"']
    kind = rng.choice(kinds if name.endswith("_0") else kinds[2:])  # two slides along one axis are one too many
    ref = f'ref="{rng.uniform(-1, 1)!r}"' if rng.random() < 0.5 else ""
    return f'<joint name="{name}" {kind} pos="{_some(rng)}" {ref}/>'


def _inertial(rng):
    mass = f'mass="{rng.uniform(0.2, 2)!r}"'
    return f'<inertial pos="{_some(rng)}" {mass} fullinertia="{_text(_tensor(rng))}"/>'


def _tensor(rng):
    spread = rng.normal(size=(3, 3)) * 0.1
    second = spread @ spread.T + 0.01 * np.eye(3)
    inertia = np.trace(second) * np.eye(3) - second
    return inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)].tolist()


def _turned(rng):
    return str(
        rng.choice(
            [
                f'quat="{_some(rng, 1, 4)}"',
                f'euler="{_some(rng)}"',
                f'axisangle="{_some(rng, 1, 4)}"',
                f'xyaxes="{_some(rng, 1, 6)}"',
                'quat="1 1 0 0"',
                'quat="0.7071 0 -0.7071 0"',
                "",
            ]
        )
    )


def _origin(rng):
    rpy = str(rng.choice([_some(rng, 2), "1.57079632679 0 0", "0 -1.5707963267948966 3.141592653589793"]))
    return f'<origin xyz="{_some(rng)}" rpy="{rpy}"/>'


def _some(rng, size=0.3, count=3):
    return _text(size * rng.normal(size=count))


def _text(values):
    return " ".join(repr(float(x)) for x in values)
