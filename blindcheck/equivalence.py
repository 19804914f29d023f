"""When an answer is the truth: by name and place; by exact equivalence; by an ambiguity set that was reported.

An entry is one effect of an answer or of a cause: {"effect": …, "joint" | "link" | "keypoint": …, perhaps "partner",
"stop", …}. A pair of places is the same in either order; an effect of the whole arm is so wherever it is said to be.

Exact equivalences: there is a size of the other that makes the same recording for any motion. They are written
down here, once, and nowhere else:

    gravity_tilt      ≡ camera_roll           the base at the origin, no encoders
    actuator_delay    ≡ camera_latency        all joints with the same delay, no encoders
    camera_scale      ≡ lens_distortion       one link, the base at the origin: its tip stays on one circle
    armature          ≡ inertial_error        first joint, its link, no gravity, or in space an upright axis: both are
                      ≡ payload, actuator_gain           its inertia about the joint; and with one link those too
    armature          ≡ payload, inertial_error, clock_rate      passive, one link: all are its period, as far
                                                               as each can change it

(A marker's offset along its link is as exactly the link's length, and one gain of all motors one factor of all masses,
but neither is an effect of the catalogue.) An effect that is another one's special case is not equivalent to it: the
simpler of the two is the better answer. But the other one can imitate it, with the same recording:

    coulomb_friction  by stribeck_friction    the same torque at rest
    viscous_friction  by drifting_friction    that does not drift
    payload           by inertial_error       of the last link
    armature          by inertial_error       first joint, its link
    camera_scale      by keypoint_offset      one link, the base at the origin: along the link
    lens_distortion   by keypoint_offset      likewise
    camera_roll       by keypoint_offset      likewise: across the link
    gravity_tilt      by keypoint_offset      one link, no encoders: likewise
    encoder_offset    by gravity_tilt         first joint, about a level axis, no keypoints

And one link has two numbers, its inertia and the moment of its weight, to the motor's torque: of rotor, payload, gain,
clock and inertial error each changes one or both, and two together what a third does, as far as each can.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import permutations
from typing import TypeVar

PLACES = ("joint", "link", "keypoint", "partner", "stop")
Entry = Mapping[str, object]
NUMBERS = {"armature", "payload", "actuator_gain", "clock_rate", "inertial_error"}
"""Effects that change the two numbers of a single link."""


def place(entry: Entry) -> frozenset[str]:
    """Names of where an effect acts."""
    return frozenset(str(entry[key]) for key in PLACES if entry.get(key) is not None)


def same(truth: Entry, found: Entry) -> bool:
    """Whether effect and place agree."""
    if truth["effect"] != found.get("effect"):
        return False
    here, there = place(truth), place(found)
    if "stop" in truth and "stop" not in found:
        here = here - {str(truth["stop"])} if not {"upper", "lower"} & there else here
    return not here or here == there


def exactly_equivalent(truth: Entry, found: Entry, answer: Mapping) -> bool:
    """Whether no recording of this case can tell two effects apart; see the top of the file."""
    names = {str(truth["effect"]), str(found.get("effect"))}
    joints, body = answer["joints"], answer["body"]
    one, at_origin = len(joints) == 1, not any(body["base"])

    def at_first(entry: Entry) -> bool:
        return entry["effect"] != "armature" or entry.get("joint") == joints[0]

    if names == {"gravity_tilt", "camera_roll"}:
        return at_origin and any(body["gravity"]) and not _has_encoders(answer)
    if names == {"actuator_delay", "camera_latency"}:
        every = one or not any(place(e) for e in (truth, found) if e["effect"] == "actuator_delay")
        return every and not _has_encoders(answer)
    if names == {"camera_scale", "lens_distortion"}:
        return one and at_origin
    if not any(body["gravity"]) and one and answer["regime"] == "commanded":
        return names <= {"armature", "inertial_error", "payload", "actuator_gain"}
    if (not any(body["gravity"]) or body.get("upright")) and names == {"armature", "inertial_error"}:
        first = answer.get("links", [None])[0]
        return at_first(truth) and at_first(found) and all(e.get("link") in (None, first) for e in (truth, found))
    if one and answer["regime"] == "passive":
        return names <= {"clock_rate", "armature", "payload", "inertial_error"}
    return False


def _has_encoders(answer: Mapping) -> bool:
    """What they show is not changed by what the camera does."""
    return answer.get("noise", {}).get("encoder_sd") is not None


def stand_ins(truth: Entry, answer: Mapping) -> tuple[str, ...]:
    """Names of the effects that can make this very recording in place of the true one; see the top of the file."""
    name, joints = str(truth["effect"]), answer["joints"]
    one = len(joints) == 1
    if one and name in NUMBERS:
        return tuple(sorted(NUMBERS - {name}))
    on_a_circle = one and not any(answer["body"]["base"])
    twins: tuple[str, ...] = (
        "gravity_tilt",
        "camera_roll",
        "actuator_delay",
        "camera_latency",
        "camera_scale",
        "lens_distortion",
    )
    twins = (*twins, "armature", "inertial_error", "payload", "actuator_gain", "clock_rate")
    at = {"armature": {"joint": joints[0]}}
    equal = [
        other
        for other in twins
        if other != name and exactly_equivalent(truth, {"effect": other} | at.get(other, {}), answer)
    ]
    imitated = {
        "coulomb_friction": "stribeck_friction",
        "viscous_friction": "drifting_friction",
        "payload": "inertial_error",
        "armature": "inertial_error" if truth.get("joint") == joints[0] else None,
        "camera_scale": "keypoint_offset" if on_a_circle else None,
        "lens_distortion": "keypoint_offset" if on_a_circle else None,
        "camera_roll": "keypoint_offset" if on_a_circle else None,
        "gravity_tilt": "keypoint_offset" if one and not _has_encoders(answer) else None,
        "encoder_offset": "gravity_tilt" if truth.get("joint") == joints[0] else None,
    }.get(name)
    return tuple(sorted({*equal, *([imitated] if imitated else [])}))


def in_group(entry: Entry, key: str) -> bool:
    """Whether a key of an ambiguity set, "effect" or "effect.place", means this entry."""
    effect, _, where = key.partition(".")
    names = [str(entry[k]) for k in PLACES if entry.get(k) is not None]
    if effect != entry["effect"]:
        return False
    return not where or not names or where in {".".join(order) for order in permutations(names)}


A = TypeVar("A")
B = TypeVar("B")


def paired(truth: Sequence[A], found: Sequence[B], agree: Callable[[A, B], bool], least: int | None = None) -> bool:
    """Whether each true effect has a found one of its own that agrees; with `least`, so many of them at least."""
    if least is None:
        if len(truth) != len(found):
            return False
        least = len(truth)
    if len(truth) <= len(found):
        orders = (zip(truth, order, strict=True) for order in permutations(found, len(truth)))
    else:
        orders = (zip(order, found, strict=True) for order in permutations(truth, len(found)))
    return any(sum(agree(a, b) for a, b in order) >= least for order in orders)


def together(entries: Sequence[Entry], group: Sequence[str]) -> bool:
    """Whether an ambiguity set has these effects, as a whole, among its keys ("a+b" for several)."""
    return any(paired(entries, key.split("+"), in_group) for key in group)


def equivalent(
    truth: Sequence[Entry], found: Sequence[Entry], answer: Mapping, groups: Sequence[Sequence[str]]
) -> bool:
    """Whether a cause is the truth up to what is indistinguishable: exactly, or by what was reported."""
    if any(together(truth, group) and together(found, group) for group in groups):
        return len(truth) == len(found)
    return paired(truth, found, lambda a, b: agreeing(a, b, answer, groups))


def agreeing(truth: Entry, found: Entry, answer: Mapping, groups: Sequence[Sequence[str]]) -> bool:
    """Whether two effects are indistinguishable."""
    return (
        same(truth, found)
        or exactly_equivalent(truth, found, answer)
        or any(together([truth], group) and together([found], group) for group in groups)
    )
