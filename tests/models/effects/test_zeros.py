"""No effect's law depends on where a joint's angle is zero: with other zeros, parameters are there that say the same.

Of a body in space a joint's ``reference`` turns the link against it, so that other angles are the same posture. In the
plane the first joint counts from the frame's x axis: a turned frame has another zero there. What the camera makes of a
whole picture (site "arm") has axes of its own, which a turned frame moves with good reason.
"""

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from variants import nonideal

from invdyn.models import ArmModel, Body, Encoders, Keypoints, Link, Observation, planar_body
from invdyn.models.bodies.joints import Joint
from invdyn.models.bodies.rotations import about
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.base import Effect, stages_of

ROWS, STEP = 8, 0.01
ZEROS = np.array([0.7, -0.4])
"""rad, from the old zeros to the new ones."""
EXACT = 1e-6
"""Of predictions, in rad, rad/s and m: stops, whose contact ends a sub-step, lose that much to rounding."""
AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
SIZES = ((0.3, 1.5), (0.25, 0.8))
"""m and kg of the links."""


def forms(kind, body):
    """The effect at all places of a body, in every form, and the non-ideal ones."""
    for effect in kind.everywhere(body, body.keypoint_names):
        while effect is not None:
            yield effect
            effect = nonideal(effect)


def drawn(model):
    """The model with its effects' parameters from their priors."""
    with torch.random.fork_rng():
        torch.manual_seed(5)
        values = {name: prior.expand((1,)).sample().to(model.dtype) for name, prior in model.priors.items()}
    return model.replace(**values), values


LAWS = {name: kind for name, kind in EFFECTS.items() if not {"outlier", "mistiming"} & set(stages_of(kind))}
"""What a tracker gets wrong now and then knows no angle."""
IN_SPACE = [name for name, kind in LAWS.items() if not kind.planar]
IN_PLANE = [name for name, kind in LAWS.items() if kind.planar and kind.site != "arm"]


def in_space(zeros):
    joints = [
        Joint(f"j{k}", axis=tuple(a), reference=about(a, z)) for k, (a, z) in enumerate(zip(AXES, zeros, strict=True))
    ]
    (long, heavy), (short, light) = SIZES
    upper = Link("upper", joints[0], length=long, tip="elbow", mass=heavy)
    return model_of(
        Body("arm", [upper, Link("fore", joints[1], parent="upper", length=short, tip="wrist", mass=light)])
    )


def in_plane(zeros):
    links = [Link(f"l{k}", f"j{k}", f"tip{k}", length=length, mass=mass) for k, (length, mass) in enumerate(SIZES)]
    return model_of(planar_body("arm", links, gravity=tuple(turned(np.array([0.0, -9.81]), zeros[0])), base=(0.0, 0.0)))


def turned(vectors, angle):
    """Vectors (..., 2) in a frame whose x axis is turned by an angle, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cos, -sin], [sin, cos]])


def model_of(body):
    rng = np.random.default_rng(2)
    sure = rng.uniform(0.2, 1.0, size=(ROWS, 2))
    seen = Observation(Keypoints(range(2), confidence=sure), Encoders())
    return ArmModel(body, STEP * np.arange(ROWS), seen, command=rng.normal(size=(ROWS, 2)) * [3.0, 1.0])


def predicted(model, x, zeros, *, plane):
    """Next states and what is seen, in the old coordinates, of states x (T, D) in those."""
    K, rows = 2, torch.arange(ROWS)
    shift = torch.zeros(x.shape[-1], dtype=x.dtype)
    shift[-2 * K : -K] = torch.as_tensor(zeros)
    with torch.no_grad():
        # without hidden states, which may be vectors of the frame; what they do is seen
        after = (model.transition_mean(x[:-1] - shift, rows[1:]) + shift)[:, -2 * K :]
        seen = model.emission(x - shift, rows).mean.clone()
    seen[:, -K:] += torch.as_tensor(zeros)
    if plane:
        points = seen[:, :-K].reshape(ROWS, -1, 2).numpy()
        seen[:, :-K] = torch.as_tensor(turned(points, -zeros[0]).reshape(ROWS, -1))
    return torch.cat([after.reshape(-1), seen.reshape(-1)]).numpy()


@pytest.mark.quick("*-False")
@pytest.mark.parametrize(("name", "plane"), [*((n, False) for n in IN_SPACE), *((n, True) for n in IN_PLANE)])
def test_no_law_depends_on_where_an_angle_is_zero(name, plane, states):
    zeros = ZEROS * [1, 0] if plane else ZEROS
    old, new = (in_plane if plane else in_space)(0 * zeros), (in_plane if plane else in_space)(zeros)
    for effect in forms(EFFECTS[name], old.body):
        here, values = drawn(old.with_effects(effect))
        there = new.with_effects(effect)
        x = states(here, ROWS)
        wanted = predicted(here, x, 0 * zeros, plane=plane)
        names, given = list(values), np.array([float(value) for value in values.values()])
        effect = effect.bound(old.body)
        parameters = {f"effect.{effect.key}.{p.name}": p for p in effect.parameters(here.scale)}
        angles = np.array([parameters[key].unit == "rad" for key in names])

        def off(guess, there=there, names=names, x=x, wanted=wanted):
            with_them = there.replace(
                **{key: torch.tensor([v], dtype=torch.float64) for key, v in zip(names, guess, strict=True)}
            )
            return predicted(with_them, x, zeros, plane=plane) - wanted

        starts = [given, *(given - angles * zero for zero in zeros if angles.any() and zero)]
        best = min(starts, key=lambda start: np.abs(off(start)).max())
        if np.abs(off(best)).max() > EXACT:
            best = least_squares(off, best, x_scale=np.abs(given) + 0.1, xtol=1e-12, ftol=1e-14, max_nfev=20).x
        assert np.abs(off(best)).max() < EXACT, f"{effect.key}: {dict(zip(names, best, strict=True))}"


class RestAtZero(Effect):
    """A spring that rests where its joint's angle is zero, wherever that is."""

    parameters = EFFECTS["viscous_friction"].parameters

    def force(self, p, now):
        return now.at(0, -p["damping"] * now.q[..., :1])


def test_one_that_does_is_found(states, monkeypatch):
    monkeypatch.setitem(globals(), "EFFECTS", {"rest_at_zero": RestAtZero})
    with pytest.raises(AssertionError, match="rest_at_zero"):
        test_no_law_depends_on_where_an_angle_is_zero("rest_at_zero", False, states)
