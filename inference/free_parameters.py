"""What of a model is fitted: noise, the torque process, and what of body and cameras is known in part or not at all."""

import warnings
from collections.abc import Callable, Mapping, Sequence

from pyro.distributions import LogNormal, Normal
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.posterior.initialise import Problem
from invdyn.models import ArmModel, ArticulatedBody
from invdyn.models.bodies.scalars import in_normal_units

CLOCK, POSE = 0.05, {"turn": 0.05, "shift": 0.1}
"""s, rad and m: how far off the clocks and poses of cameras may be that are to be learned, standard deviations."""
DROP, MIN_DROP = "emission.confidence_drop", 0.02
"""The noise's growth between the surest and the least sure rows, and the least that its fit starts from."""


def free_parameters(problem: Problem, given: Sequence[str] = (), learn_lengths: bool = False) -> list[Free]:
    """Parameters to fit when not ``given``: σ_y, the torque process, and what of the body is to be learned.

    The dynamics' own noise ε is not among them. White noise on a velocity is a white torque by another name, and takes
    torque away from τ. On the DFKI arm the evidence likes that, and the torque's error doubles. A moving base's process
    is that of its own track (:mod:`.base_motion`): a person's torques make up for what the base does to the arm, and
    the evidence of both would take that for a base that the arm does not feel.
    """
    body, observed = problem.model.body, [name for name in problem.model.parameters if name.startswith("emission.")]
    wanted = [
        Free("torque.scale"),
        Free("torque.decay", sd=1.0),
        Free("torque.lengthscale", sd=1.0),
        # Small, so that one joint hardly tells it: one share of the joints' torques, and one rate, for all.
        Free("torque.rough_scale", tied=True, sd=1.0),
        Free("torque.rough_decay", tied=True, sd=1.0),
        # One σ_y as in the paper; its ratio between keypoints is that of their misfits at the start.
        *(Free(name, sd=1.0) if name == "emission.df" else Free(name, tied=True) for name in observed),
    ]
    learned = dict(body.learned)
    if learn_lengths and body.is_chain:  # a tree says itself which of its lengths are learned
        learned = {"length": tuple(range(body.num_joints)), **{k: v for k, v in learned.items() if k != "length"}}
    wanted += [
        Free(f"body.{quantity}", sd=sd, entries=entries, unit=unit)
        for quantity, sd, unit, entries in known_in_part(body)
    ]
    wanted += [Free(f"body.{quantity}", sd=0.3, entries=entries) for quantity, entries in learned.items()]
    if (pixels := problem.model.observation.pixels) is not None:
        # The first camera is where it is, and its clock is right: all others' are relative to it.
        clocks, poses = (tuple(range(n, n * len(pixels.camera_names))) for n in (1, 3))
        wanted += [Free("camera.offset", sd=1.0, entries=clocks, unit=CLOCK)]
        wanted += [Free(f"camera.{way}", sd=1.0, entries=poses, unit=unit) for way, unit in POSE.items()]
        # Three numbers a camera say little of their size.
        wanted += [Free("camera.turn_scale", tied=True, sd=0.5)]
    return [f for f in wanted if f.name in problem.model.parameters and f.name not in given]


def of_priors(body: ArticulatedBody) -> Callable[[Free], bool]:
    """Whether a parameter is one of the body's numbers that have priors."""
    own = {(f"body.{quantity}", entry) for quantity, entries in body.priors.items() for entry in entries}
    return lambda free: bool(free.entries) and {(free.name, entry) for entry in free.entries or ()} <= own


def known_in_part(body: ArticulatedBody) -> list[tuple[str, float, float | None, tuple[int, ...]]]:
    """The body's numbers that have priors: quantity, sd and unit as of :class:`Free`, and entries that these are of."""
    alike: dict[tuple[str, float, float | None], list[int]] = {}
    for quantity, own in body.priors.items():
        for entry, each in own.items():
            if not isinstance(each, Normal | LogNormal):
                warnings.warn(
                    f"body.{quantity}[{entry}]: the prior {type(each).__name__} is replaced by a (log-)normal of "
                    "its mean and sd, whose draws may be beyond its bounds; give a LogNormal to say so yourself",
                    stacklevel=2,
                )
            alike.setdefault((quantity, *in_normal_units(each)[1:]), []).append(entry)
    return [(*which, tuple(entries)) for which, entries in alike.items()]


def at_start(problem: Problem, free: Sequence[Free]) -> ArmModel:
    """The model at the parameters that a fit begins at."""
    model = problem.model
    names = {f.name for f in free}
    if DROP in names:  # a logarithm is fitted, and 0 has none
        model = model.replace(**{DROP: model.parameters[DROP].clamp(min=MIN_DROP)})
    priors = {quantity: own for quantity, own in model.body.priors.items() if f"body.{quantity}" in names}
    middles = {
        quantity: {entry: in_normal_units(each)[0] for entry, each in own.items()} for quantity, own in priors.items()
    }
    return with_entries(model, middles)


def with_entries(model: ArmModel, values: Mapping[str, Mapping[int, float | Tensor]]) -> ArmModel:
    """The model with other ``values`` of some of its body's numbers, by the number's name and flat index."""
    found = {f"body.{quantity}": model.parameters[f"body.{quantity}"].clone() for quantity in values}
    for quantity, own in values.items():
        for entry, value in own.items():
            found[f"body.{quantity}"].view(-1)[entry] = value
    return model.replace(**found)
