"""Arms with two and six muscles, and recordings of markers on them that excitations moved."""

import mujoco
import numpy as np

from invdyn.recordings import Recording

HEAD = (
    '<mujoco model="muscled"><option timestep="0.002" gravity="0 0 -9.81"/><default><geom contype="0" conaffinity="0"/>'
)
TWO = (
    HEAD
    + """<joint damping=".3"/></default><worldbody>
  <site name="top" pos="0 0 .3"/><site name="behind" pos="-.03 0 .28"/>
  <body name="fore"><joint name="elbow" axis="0 -1 0" range="-.2 2.4" ref="0"/>
    <geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass="1.2"/>
    <site name="front" pos=".05 0 .02"/><site name="back" pos="-.03 0 -.01"/><site name="wrist" pos=".25 0 0"/>
  </body></worldbody>
<tendon><spatial name="flexor"><site site="top"/><site site="front"/></spatial>
  <spatial name="extensor"><site site="behind"/><site site="back"/></spatial></tendon>
<actuator><muscle name="flexor" tendon="flexor" force="400" lengthrange=".2 .32"/>
  <muscle name="extensor" tendon="extensor" force="400" lengthrange=".24 .32"/></actuator></mujoco>"""
)
"""One joint with a flexor and an extensor."""
SIX = (
    HEAD
    + """<joint damping=".3"/></default><worldbody>
  <site name="chest" pos=".06 0 .02"/><site name="blade" pos="-.06 0 .02"/><site name="above" pos=".02 0 .04"/>
  <site name="over" pos="-.03 0 .04"/>
  <body name="upper"><joint name="shoulder" axis="0 -1 0" range="-1.5 3"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.29" size=".03" mass="1.9"/>
    <site name="front_up" pos=".025 0 -.12"/><site name="back_up" pos="-.025 0 -.12"/>
    <site name="mid" pos=".02 0 -.15"/>
    <site name="rear" pos="-.025 0 -.15"/><site name="elbow" pos="0 0 -.29"/>
    <body name="fore" pos="0 0 -.29"><joint name="elbow" axis="0 -1 0" range="-.1 2.4"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass="1.5"/>
      <site name="radius" pos=".03 0 -.05"/><site name="ulna" pos="-.025 0 .02"/><site name="wrist" pos="0 0 -.25"/>
    </body></body></worldbody>
<tendon>
  <spatial name="deltoid_front"><site site="chest"/><site site="front_up"/></spatial>
  <spatial name="deltoid_back"><site site="blade"/><site site="back_up"/></spatial>
  <spatial name="biceps_long"><site site="above"/><site site="mid"/><site site="radius"/></spatial>
  <spatial name="brachialis"><site site="mid"/><site site="radius"/></spatial>
  <spatial name="triceps_long"><site site="over"/><site site="rear"/><site site="ulna"/></spatial>
  <spatial name="triceps_lateral"><site site="rear"/><site site="ulna"/></spatial>
</tendon>
<actuator>
  <muscle name="deltoid_front" tendon="deltoid_front" force="900" lengthrange=".08 .2"/>
  <muscle name="deltoid_back" tendon="deltoid_back" force="900" lengthrange=".08 .2"/>
  <muscle name="biceps_long" tendon="biceps_long" force="500" lengthrange=".25 .42"/>
  <muscle name="brachialis" tendon="brachialis" force="700" lengthrange=".1 .22"/>
  <muscle name="triceps_long" tendon="triceps_long" force="600" lengthrange=".25 .42"/>
  <muscle name="triceps_lateral" tendon="triceps_lateral" force="700" lengthrange=".1 .22"/>
</actuator></mujoco>"""
)
"""Shoulder and elbow with six muscles in the places of OpenSim's arm26, two of which cross both joints."""
SEEN = {TWO: ("wrist",), SIX: ("elbow", "wrist")}


def recording(text, rows, seed, interval=0.01, noise=0.001):
    """Markers of an arm that smooth excitations move, as x and z in m; and the truth by name, a row each."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    data, steps = mujoco.MjData(model), round(interval / model.opt.timestep)
    data.qpos[:] = 0.8
    data.act[:] = 0.2
    phase, pace = rng.uniform(0, 2 * np.pi, model.nu), rng.uniform(0.5, 1.5, model.nu)
    middle = rng.uniform(0.1, 0.3, model.nu)
    sites = [model.site(name).id for name in SEEN[text]]
    seen, activation, torque, states = [], [], [], []
    for t in range(rows):
        data.ctrl[:] = np.clip(middle * (1 + np.sin(2 * np.pi * pace * t * interval + phase)), 0.005, 0.995)
        mujoco.mj_forward(model, data)
        seen.append(data.site_xpos[sites][:, [0, 2]] + noise * rng.normal(size=(len(sites), 2)))
        activation.append(data.act.copy())
        torque.append(data.qfrc_actuator.copy())
        states.append(np.concatenate([data.qpos, data.qvel]))
        for _ in range(steps):
            mujoco.mj_step(model, data)
    truth = {"activation": np.array(activation), "torque": np.array(torque), "states": np.array(states)}
    time = np.arange(rows) * interval
    return Recording(time=time, keypoints=np.array(seen), keypoint_names=SEEN[text], name="muscled"), truth
