"""A body file of two links, as tests write it and spoil it."""

ARM = """\
name = "bench arm"
gravity = [0.0, -9.81]
base = [0.1, 0.2]

[[links]]
name = "upper_arm"
joint = "shoulder"
tip = "elbow"
length = 0.30
mass = 1.5

[[links]]
name = "forearm"
joint = "elbow"
tip = "wrist"
length = 0.25
mass = 1.0
com = 0.1
inertia = 0.004

[uncertainty]
mass = 0.05
"""
