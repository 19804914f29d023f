"""What a diagnosis names in logs of robots whose motors are position servos, with targets and encoders alone.

    python benchmarks/servo.py [--cases 40] [--seed 60000] [--told] [--results FILE]

Each case: a random arm of two hinges hanging in the vertical plane, links of .2 to .4 m and .4 to 1.5 kg, with damping,
a rotor and a position servo at each joint. The true robot differs by one thing: friction, viscous or dry, or a rotor at
one of the joints, a load at its end, or motors that act late. MuJoCo simulates 4 s of it, at 50 rows/s, encoders off by
.2 mrad. Servos are as stiff as holds the arm level with .1 to .3 rad of error; sizes follow its weight and inertia.
The rest is as in :mod:`write_back`.
"""

import numpy as np
from write_back import Robot, joint, late, payload, run

FILE = """<mujoco model="robot"><compiler angle="radian"/><option timestep="0.002" gravity="0 0 -9.81"/><worldbody>
<body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0" damping="{damping[0]:.4g}" armature="{rotor[0]:.4g}"/>
<inertial pos="0 0 {centre[0]:.4g}" mass="{mass[0]:.4g}" diaginertia="{own[0]:.4g} {own[0]:.4g} 1e-4"/>
<body name="fore" pos="0 0 -{length[0]:.4g}">
<joint name="elbow" axis="0 1 0" damping="{damping[1]:.4g}" armature="{rotor[1]:.4g}"/>
<inertial pos="0 0 {centre[1]:.4g}" mass="{mass[1]:.4g}" diaginertia="{own[1]:.4g} {own[1]:.4g} 1e-4"/>
<site name="tip" pos="0 0 -{length[1]:.4g}"/></body></body></worldbody>
<actuator><position name="s" joint="shoulder" kp="{kp[0]:.4g}" kv="{kv[0]:.4g}"/>
<position name="e" joint="elbow" kp="{kp[1]:.4g}" kv="{kv[1]:.4g}"/></actuator></mujoco>"""


def servos(rng: np.random.Generator) -> Robot:
    """A random robot, and what may differ."""
    u = rng.uniform
    length, mass = u(0.2, 0.4, 2), u(0.4, 1.5, 2)
    own = mass * length**2 / 12
    centre = -length / 2
    load = 9.81 * np.array([mass[0] * length[0] / 2 + mass[1] * (length[0] + length[1] / 2), mass[1] * length[1] / 2])
    inertia = np.array([mass[0] * length[0] ** 2 / 3 + mass[1] * length.sum() ** 2, mass[1] * length[1] ** 2 / 3])
    kp = load / u(0.1, 0.3, 2)
    kv = u(0.3, 0.7, 2) * 2 * np.sqrt(kp * inertia)
    speed = np.sqrt(load / inertia)
    damping, rotor = u(0.02, 0.1, 2) * load / speed, u(0.02, 0.1, 2) * inertia
    text = FILE.format(**{k: v for k, v in locals().items() if k not in ("rng", "u")})
    found = {}
    for k, name in enumerate(("shoulder", "elbow")):
        found[f"viscous_friction.{name}"] = joint(name, "damping", damping[k] + u(0.1, 0.4) * load[k] / speed[k])
        found[f"coulomb_friction.{name}"] = joint(name, "frictionloss", u(0.05, 0.25) * load[k])
        found[f"armature.{name}"] = joint(name, "armature", rotor[k] + u(0.2, 0.8) * inertia[k])
    found["payload"] = payload(u(0.1, 0.4) * mass[1], f"0 0 -{length[1]:.4g}")
    found["actuator_delay"] = late(u(0.01, 0.04))
    return Robot(text, found, (0.5, 0.5))


if __name__ == "__main__":
    run(servos, __doc__ or "", 40, 60_000)
