"""Answers and diagnoses of blind cases, written by hand."""

DAMPING = {"damping": {"value": 0.3, "unit": "N·m·s/rad"}}
BODY = {"length": [0.3, 0.2], "mass": [1, 1], "com": [0.1, 0.1], "inertia": [1, 1]}


def answer(
    *effects, kind="commanded", regime="commanded", joints=("shoulder", "elbow"), base=(0, 0), gravity=(0, -9.81)
):
    body = {**BODY, "base": list(base), "gravity": list(gravity)}
    links = [f"link{k + 1}" for k in range(len(joints))]
    return {
        "kind": kind, "regime": regime, "effects": list(effects), "body": body, "joints": list(joints), "links": links
    }  # fmt: skip


def true(effect, side="dynamics", parameters=(), dprime=99.0, interval=None, **where):
    return {
        "effect": effect, "side": side, **where, "parameters": dict(parameters), "dprime": dprime, "interval": interval
    }  # fmt: skip


def said(effect, parameters=(), **where):
    intervals = {name: {"mean": sum(i) / 2, "interval_90": list(i)} for name, i in dict(parameters).items()}
    return {"effect": effect, **where, "parameters": intervals}


def diagnosis(*causes, outside=0.0, detected=True, groups=(), side=None, joints=None, keypoints=None, intervals=(),
              hidden=(), closed=None, gain=1.0):  # fmt: skip
    """`causes`: (probability, entries…)."""
    return {
        "gap": {"detected": detected, "probability": 0.9, "elpd_per_frame": {"nominal": 1.0, "corrected": 1.0 + gain}},
        "where": {
            "side": side or {},
            "joints": joints or {},
            "keypoints": keypoints or {},
            "intervals": list(intervals),
        },
        "causes": [{"effects": list(entries), "probability": p} for p, *entries in causes],
        "ambiguity_set": [list(group) for group in groups],
        "outside_catalogue": {"probability": outside},
        "not_identifiable": list(hidden),
        "shrinkage": {"gap_closed": closed},
    }


FRICTION = true("viscous_friction", parameters=DAMPING, joint="elbow")
FOUND = said("viscous_friction", {"damping": (0.2, 0.4)}, joint="elbow")
RIGHT = diagnosis((0.8, FOUND), (0.15,), outside=0.05, side={"dynamics": 0.9, "observation": 0.1},
                  joints={"shoulder": 0.1, "elbow": 0.9}, closed=0.97)  # fmt: skip
