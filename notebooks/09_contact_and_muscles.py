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
# # Contact and muscles
#
# A leg falls on its foot, and an arm is moved by two muscles. Both are MJCF, and MuJoCo's own step is the dynamics.
# From keypoints alone we infer the torques, the force of the floor, and how active the muscles are.
#
# **You will learn**
#
# * how any MJCF becomes a state-space model;
# * what keypoints say of a contact's force;
# * which of two muscles a motion tells, and which it does not.
#
# You need the extra `robots`, which has MuJoCo.

# %% tags=["hide-input"]
# %matplotlib inline
import logging
import warnings

warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
warnings.filterwarnings("ignore", "IProgress not found")
logging.getLogger("arviz").setLevel(logging.ERROR)

# %% [markdown]
# ## A leg on the floor
#
# The trunk slides on a rail, hip and knee have motors. Each `site` is a keypoint.

# %%
import matplotlib.pyplot as plt
import numpy as np

from invdyn.inference import infer_engine
from invdyn.models import Controls, EngineModel, JointTorques, Keypoints, Observation, Scene
from invdyn.models.engine.contacts import contact_forces
from invdyn.recordings import Recording

LEG = """<mujoco model="leg"><option timestep="0.002" integrator="implicitfast"/>
<worldbody><geom name="floor" type="plane" size="2 2 .1"/>
  <body name="trunk" pos="0 0 .47"><joint name="height" type="slide" axis="0 0 1"/><site name="hip"/>
    <geom type="box" size=".1 .05 .06" mass="3"/>
    <body name="thigh" euler="0 -30 0"><joint name="hip" axis="0 1 0" damping=".05" stiffness="60"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".5"/>
      <body name="shank" pos="0 0 -.25" euler="0 60 0"><joint name="knee" axis="0 1 0" damping=".5" stiffness="60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".015" mass=".3"/><site name="knee"/>
        <geom name="foot" size=".025" pos="0 0 -.25"/><site name="foot" pos="0 0 -.25"/>
      </body></body></body></worldbody></mujoco>"""

scene = Scene.of(LEG, dimensions=2)
known = {"emission.keypoint_scale": 0.002, "initial.angle_scale": 0.005, "initial.velocity_scale": 0.05}
leg = EngineModel(scene, np.arange(30) * 0.01, drive=JointTorques(("hip", "knee")), parameters=known)
states, rows = leg.simulate(seed=0)
points = rows.numpy().reshape(30, 3, 2)
recording = Recording(time=leg.time.numpy(), keypoints=points, keypoint_names=scene.keypoint_names, name="fall")

# %% [markdown]
# The model knows that its motion has kinks. Lines are then fitted over the posterior, and no tangents taken.

# %%
print("kinks:", leg.nonsmooth)
found = infer_engine(recording, scene, num_filters=4, num_particles=50, num_draws=20, seed=0)
print(found.attrs["hidden"])

# %% [markdown]
# ## The force of the floor
#
# Nobody measured it: mass and motion tell it. The impulse, the sum of the forces, is known best.

# %%
force = found["posterior"]["contact_force"].sel(contact="floor-foot", axis="z").stack(draws=("chain", "draw"))
low, middle, high = np.quantile(force.transpose("draws", "time").values, [0.05, 0.5, 0.95], axis=0)
figure, axes = plt.subplots(figsize=(7, 2.6))
axes.fill_between(recording.time, low, high, alpha=0.3, label="90 %")
axes.plot(recording.time, middle, label="median")
true = contact_forces(leg, states.numpy()[None])
floor = true.force[0, :, true.names.index("floor-foot"), 2]
axes.plot(recording.time, floor, "k--", label="true")
axes.set(xlabel="time (s)", ylabel="floor on foot (N)")
axes.legend()
impulse = 0.01 * force.isel(time=slice(0, -1)).sum("time").values
print(f"impulse {impulse.mean():.2f} ± {impulse.std():.2f} N·s, truly {0.01 * floor[:-1].sum():.2f}")

# %% [markdown]
# ## Two muscles
#
# A muscle's excitation is between 0 and 1, and its activation follows. The drive of a file with muscles is its
# actuators.

# %%
ARM = """<mujoco model="arm"><option timestep="0.002"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
  <site name="top" pos="0 0 .3"/><site name="behind" pos="-.03 0 .28"/>
  <body name="fore"><joint name="elbow" axis="0 -1 0" damping=".3"/>
    <geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass="1.2"/>
    <site name="front" pos=".05 0 .02"/><site name="back" pos="-.03 0 -.01"/><site name="wrist" pos=".25 0 0"/>
  </body></worldbody>
<tendon><spatial name="flexor"><site site="top"/><site site="front"/></spatial>
  <spatial name="extensor"><site site="behind"/><site site="back"/></spatial></tendon>
<actuator><muscle name="flexor" tendon="flexor" force="400" lengthrange=".2 .32"/>
  <muscle name="extensor" tendon="extensor" force="400" lengthrange=".24 .32"/></actuator></mujoco>"""

arm = Scene.of(ARM, dimensions=2)
start = {
    "emission.keypoint_scale": 0.002,
    "initial.angle": 0.8,
    "initial.angle_scale": 0.1,
    "initial.velocity_scale": 0.3,
}
muscled = EngineModel(arm, np.arange(30) * 0.01, Observation(Keypoints(["wrist"])), drive=Controls(), parameters=start)
truth, seen = muscled.simulate(seed=3)
wrist = Recording(
    time=muscled.time.numpy(), keypoints=seen.numpy().reshape(30, 1, 2), keypoint_names=("wrist",), name="arm"
)
moved = infer_engine(wrist, arm, num_filters=4, num_particles=50, num_draws=20, seed=0, settings=start)
print(moved.attrs.get("hidden", "both are told"))

# %%
activation = moved["posterior"]["activation"].stack(draws=("chain", "draw")).transpose("draws", "time", "activation_of")
low, middle, high = np.quantile(activation.values, [0.05, 0.5, 0.95], axis=0)
figure, axes = plt.subplots(1, 2, figsize=(7, 2.6), sharey=True)
for k, name in enumerate(activation["activation_of"].values):
    axes[k].fill_between(wrist.time, low[:, k], high[:, k], alpha=0.3)
    axes[k].plot(wrist.time, middle[:, k])
    axes[k].plot(wrist.time, truth[:, 4 + k], "k--")
    axes[k].set(title=name, xlabel="time (s)", ylim=(0, 1))
width = (high - low).mean()
print(f"bands of activations are {width:.2f} wide on average, of 1 at most")

# %% [markdown]
# The arm moves by the difference of both pulls. What both do against each other is left to the prior, and to the arm's
# stiffness that it brings.

# %% [markdown]
# ## Exercises
#
# 1. Which sensor would tell the two muscles apart?
# 2. Why is the impulse known better than the force of a row?

# %% [markdown] tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# 1. One on a muscle: electromyography shows an excitation, a strap on a tendon its force. In MJCF an `actuatorfrc`
#    sensor is such a strap, and `Readings` observes it.

# %% [markdown] tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# 2. Keypoints show positions. The sum of forces is a difference of momenta, a slope of positions. One force is a
#    difference of slopes, and depends on how soft the contact is.
