# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # My robot
#
# You have a robot, its simulation as an MJCF file, and a log. The simulation moves otherwise than the robot. This
# notebook goes from the two files to a third: a copy of the simulation that moves as the robot does. MuJoCo plays the
# robot here, so that we know the truth. Nothing else uses it.
#
# **You will learn**
#
# * what of a robot's file is the simulation, and what an effect on top of it means;
# * how `check` finds a wrong sign before an hour of work;
# * how `diagnose` names what changes, from … to …, with an interval;
# * how the corrected file is written, and how MuJoCo itself tries it on a log that nobody has fitted.
#
# You need the idea of [notebook 4](04_diagnose_the_gap.py). Three exercises stand at the end.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import invdyn
from invdyn.diagnosis import diagnose
from invdyn.diagnosis.check.check import check
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.inputs import load_body, read_logs
from invdyn.models.effects import EFFECTS
from invdyn.plots import BLUE, GREY, STYLE, VERMILION

plt.rcParams.update(STYLE | {"figure.constrained_layout.use": True, "figure.dpi": 90})
folder = Path(mkdtemp())

# %% [markdown]
# ## The simulation
#
# Two links hang in the vertical plane. The shoulder has a position servo, the elbow a motor behind a gear of 10.

# %%
ROBOT = """<mujoco model="robot">
  <compiler angle="radian"/>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 -1 0" damping="0.3" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1.2" contype="0" conaffinity="0"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 -1 0" damping="0.1"/>
        <inertial pos="0 0 -0.12" mass="0.8" diaginertia="0.005 0.005 0.0002"/>
        <site name="tip" pos="0 0 -0.25"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="s" joint="shoulder" kp="40" kv="3"/>
    <motor name="e" joint="elbow" gear="10"/>
  </actuator>
</mujoco>
"""
(folder / "robot.xml").write_text(ROBOT)
body = load_body(str(folder / "robot.xml"))
for link in body.links:
    print(f"{link.joint}: {link.nominal('mass')} kg; {link.parts}")

# %% [markdown]
# All of it is the simulation, and nothing needs to be cut down. A joint's torque is
#
# $$\tau = u - b\,\dot\theta - f\,\mathrm{sgn}\,\dot\theta - I_a \ddot\theta, \qquad
#   u = K (c - \theta) - D\,\dot\theta \;\text{ of a servo that is told } c.$$
#
# The file says $b = 0.1$ N·m·s/rad at the elbow. An effect that a diagnosis finds there comes on top: viscous friction
# of $\Delta b$ means that the file should say $b + \Delta b$.
#
# ## The robot
#
# In reality the elbow's damping is 0.25. Everything else is as the file has it. The robot logs its encoders in degrees,
# the servo's target, and the elbow's motor current, which makes 50 mN·m an ampere. Reality has no time step, so MuJoCo
# takes tiny ones here.

# %%
TRUE, STEP, RATE = 0.25, 2e-4, 50.0


def reality(seed, seconds=2.4):
    """Time, angles q (T, 2) rad, target of the shoulder, rad, and current of the elbow's motor, A."""
    root = ET.fromstring(ROBOT)
    root.find(".//joint[@name='elbow']").set("damping", str(TRUE))
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, "unicode"))
    model.opt.timestep = STEP
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    a, b, c = rng.uniform(0, 6, 3)
    target = 0.5 * np.sin(4 * time + a) + 0.2 * np.sin(9 * time + b)
    current = 0.9 * np.sin(6 * time + c)
    angles = []
    for row in range(len(time)):
        angles.append(data.qpos + rng.normal(0, 2e-4, 2))
        data.ctrl[:] = target[row], 0.05 * current[row]
        for _ in range(round(1 / RATE / STEP)):
            mujoco.mj_step(model, data)
    return time, np.array(angles), target, current


def write_log(name, seed):
    """The log as a table; somebody wired the ammeter the wrong way round."""
    time, q, target, current = reality(seed)
    rows = np.column_stack([1e3 * time, np.degrees(q), np.degrees(target), -1e3 * current])
    names = "t_ms,q1_deg,q2_deg,target1_deg,current2_mA"
    np.savetxt(folder / name, rows, delimiter=",", header=names, comments="", fmt="%.6f")
    return time, q


write_log("log.csv", seed=0)
later, moved = write_log("later.csv", seed=1)

# %% [markdown]
# ## Check first
#
# A mapping says which column is which joint's. It is written once for a robot.

# %%
MAP = """
time = "t_ms"
time_unit = "ms"

[joints.shoulder]
angle = {track = "q1_deg", unit = "deg"}
target = {track = "target1_deg", unit = "deg"}

[joints.elbow]
angle = {track = "q2_deg", unit = "deg"}
torque = {track = "current2_mA", unit = "mA", constant = 0.05, gear = 10}
"""


def load_one(name, mapping=MAP):
    """A log with its mapping."""
    (folder / "map.toml").write_text(mapping)
    (found,) = read_logs(str(folder / name), body, str(folder / "map.toml"))
    return found.recording


log = load_one("log.csv")
for wrong in check(log, body, effects=False).mistakes:
    print(wrong.kind, "|", wrong.sentence)

# %% [markdown]
# The motion asks for one torque and the log states another. With the elbow's sign turned, they agree. Otherwise some
# effect would get the blame. So the mapping gets the sign:

# %%
MAP = MAP.replace("gear = 10}", "gear = 10, sign = -1}")
log, held_out = load_one("log.csv", MAP), load_one("later.csv", MAP)
found = check(log, body, effects=False)
print("mistakes:", len(found.mistakes))
print(f"of the torque the body and some friction leave {100 * found.unexplained:.0f} %")
for known in found.excited[:4]:
    print(f"the motion tells {known.words}: {known.value:.3f} ± {known.sd:.3f} {known.unit}")

# %% [markdown]
# ## Diagnose
#
# All effects of the catalogue would take a minute or two. Six of them are enough to see how it goes.

# %%
LOOKED_FOR = ("viscous_friction", "coulomb_friction", "armature", "payload", "actuator_delay", "actuator_gain")
STRUCK = [name for name in EFFECTS if name not in LOOKED_FOR]
diagnosis = diagnose(log, body, held_out=held_out, without=STRUCK, most=1)
print(verdict(diagnosis))
for cause in diagnosis.causes[:3]:
    names = "+".join(finding.key for finding in cause.effects) or "no gap"
    print(f"  {cause.probability + cause.in_part:.2f}  {names}")
(finding,) = diagnosis.causes[0].effects
change = finding.changes["damping"]
low, high = change.after.interval_90
print(f"damping of the elbow: from {change.before} to {change.after.mean:.4f} ({low:.4f} to {high:.4f}); truth {TRUE}")

# %% [markdown]
# The diagnosis is told nothing of which numbers are wrong. It compares what each effect would change at each place
# with what is seen ([notebook 4](04_diagnose_the_gap.py)), and says what is the change of which number.
#
# ## Write back, and try it
#
# The copy is the user's own file with that one number changed. MuJoCo loads it and replays the held-out log, set to the
# recorded state once a second.

# %%
diagnosis = write_back(diagnosis, folder / "robot.xml", body, folder / "corrected.xml", held_out, True)
for line in (folder / "corrected.xml").read_text().splitlines():
    if "invdyn:" in line or '<joint name="elbow"' in line:
        print(line.strip())
for sentence in details(diagnosis)[-2:]:
    print(sentence)

# %%


def replayed(file):
    """Angles (T, 2) of a file's own simulation under the later log's commands, from its first state."""
    time, q, target, current = reality(1)
    model = mujoco.MjModel.from_xml_path(str(folder / file))
    data = mujoco.MjData(model)
    data.qpos[:] = q[0]
    angles = []
    for row in range(len(time)):
        angles.append(data.qpos.copy())
        data.ctrl[:] = target[row], 0.05 * current[row]
        for _ in range(round(1 / RATE / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return np.array(angles)


before, after = replayed("robot.xml"), replayed("corrected.xml")
fig, axes = plt.subplots(2, 1, figsize=(7, 4.6), sharex=True)
axes[0].plot(later, np.degrees(moved[:, 1]), color=GREY, lw=4, alpha=0.5, label="the robot")
axes[0].plot(later, np.degrees(before[:, 1]), color=VERMILION, label="its file")
axes[0].plot(later, np.degrees(after[:, 1]), color=BLUE, label="the corrected file")
axes[0].set(ylabel="elbow (°)", ylim=(-70, 95), title="A log that nobody has fitted, replayed by MuJoCo")
axes[0].legend(ncols=3, loc="upper right")
for angles, color in ((before, VERMILION), (after, BLUE)):
    axes[1].semilogy(later[1:], np.degrees(np.abs(angles - moved)).max(1)[1:], color=color)
axes[1].set_yticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
axes[1].set(xlabel="time (s)", ylabel="off by (°)")
plt.show()
rms = [float(np.sqrt(np.mean((angles - moved) ** 2))) for angles in (before, after)]
print(f"rms error of all angles: {rms[0]:.4f} rad before, {rms[1]:.4f} rad after")

# %% [markdown]
# What is left after the correction is the sensors' noise and the coarse steps of the file's own simulation.
#
# **In Python no file is needed between.** `invdyn.diagnose("log.csv", spec, mapping="map.toml")` takes the simulation
# as a `mujoco.MjSpec`, an `MjModel` or a file. `invdyn.corrected` gives a copy of it with the numbers that were found.

# %%
spec = mujoco.MjSpec.from_string(ROBOT)
new = invdyn.corrected(diagnosis, spec)
for name, each in (("as it was", spec), ("corrected", new)):
    print(f"{name}: damping of the elbow {each.compile().joint('elbow').damping.item():.4f} N·m·s/rad")

# %% [markdown]
# **With files of your own** it is two commands, and the report is a page of its own:
#
# ```
# invdyn check robot.xml log.mcap --map map.toml
# invdyn diagnose log.mcap --map map.toml --body robot.xml --out found --write-back corrected.xml
# ```
#
# Numbers of the file that you doubt can be learned with the causes: `--estimate damping,armature`.
#
# ## Exercises
#
# **1. A zero that is off.** Somebody mounted the elbow's encoder 30° off. What does `check` say? Which term of the
# equation of motion tells it?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
off = replace(log, angles=log.angles + np.radians([0, 30]))
(wrong, *_) = check(off, body, effects=False).mistakes
print(f"{wrong.kind} at {wrong.joints[0]}: {np.degrees(wrong.value):+.1f}°")
print("Gravity tells: velocities and accelerations are the same, but m g r sin θ is not.")

# %% [markdown]
# **2. A rotor behind a gear.** A motor's rotor has $5\cdot 10^{-6}$ kg·m² and a gear of 50. What should the file say as
# `armature` at the joint? How does that compare with the forearm's own inertia about the elbow?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
rotor, link = 5e-6 * 50**2, 0.005 + 0.8 * 0.12**2
print(f"The rotor turns 50 times as fast, so it counts 50² times: {rotor:.4f} kg·m², {rotor / link:.0%} of the link's.")
print("A file that leaves it out is wrong at each acceleration, and right at rest: a payload is wrong at both.")

# %% [markdown]
# **3. A servo hides it.** The servo's own damping is $D = 3$ N·m·s/rad. How large a change of $b$ at the shoulder
# moves its angle as much as a change of 0.15 moves it at the elbow? Why should one log *motor torques* where one can?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
K, D, w = 40.0, 3.0, 4.0
inertia = 0.02 + 1.2 * 0.3**2 / 3 + 0.8 * 0.42**2
loop = abs(K + 1j * w * (D + 0.3) - inertia * w**2)
print(f"A servo divides a torque by |K + iω(D + b) − Iω²| = {loop:.0f} N·m/rad at ω = {w} rad/s.")
free = abs(1j * w * 0.1 + 0.8 * 9.81 * 0.12 - link * w**2)
print(f"The free elbow divides it by {free:.1f} N·m/rad: the same change shows {loop / free:.0f} times as much there.")
print("What the servo corrects, its torque says. A log of targets alone says it only through the small angle left.")
