"""A robot's own log, an episode each, as recordings of a body: angles and commands as its file counts them."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn.inference.plausible_for_body import slides
from invdyn.models import Body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.recordings import InputError, Recording, check_readable
from invdyn.recordings.errors import about
from invdyn.recordings.logs import LogMap, recordings_of
from invdyn.recordings.logs.mapping import JointMap
from invdyn.recordings.logs.read import Logged
from invdyn.recordings.reading import Reading

from .input_names import frame_range


def read_logs(
    name: str,
    body: Body,
    mapping: str | None = None,
    episodes: Sequence[int] | None = None,
    frames: str = ":",
    hide_torque: bool = False,
) -> list[Reading]:
    """Episodes of a log, all of them unless their numbers are given.

    Joints' angles become the body's (θ = zero + sign · q), torques get the sign too, and a servo's targets become the
    torque of the targets alone, which is what a model is given. Each reading says where its units stand, and how it
    reads in others. ``hide_torque``: commands are not read, so that it does not matter which a joint takes.

    Raises InputError for a log, a mapping or episodes that make no sense, and targets of a joint without a servo.
    """
    given = None if mapping is None else LogMap.load(check_readable(mapping))
    if given is not None:
        with about(str(mapping)):
            given.check_kinds(slides(body))

    maps = tuple(given.joints.get(name, JointMap()) for name in body.joint_names) if given else ()

    def read(**scales: float) -> list[Recording]:
        found = recordings_of(name, body.joint_names, given, episodes, **scales)
        found = [logged.without_commands() for logged in found] if hide_torque else found
        own = [_in_the_bodys_terms(logged, body, maps).at(frame_range(frames)) for logged in found]
        return [replace(recording, units=(given or LogMap()).units) for recording in own]

    targets = any(own.servo is not None for own in body.joint_parts)
    return [
        Reading(recording, lambda n=n, **scales: read(**scales)[n], targets, maps) for n, recording in enumerate(read())
    ]


def read_log_files(
    files: Sequence[str],
    body: Body,
    *,
    frames: str = ":",
    mapping: str | None = None,
    episodes: str = "0",
    hide_torque: bool = False,
) -> list[Reading]:
    """Some episodes of one log, such as "0,1". Raises InputError for what is no such list, and as :func:`read_logs`."""
    (name,) = files
    return read_logs(name, body, mapping, episode_numbers(episodes), frames, hide_torque)


def episode_numbers(text: str) -> list[int]:
    """Read "0,1". Raises InputError for anything else."""
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise InputError(f"episodes are a list of numbers, such as 0,1, got {text!r}") from None


def _in_the_bodys_terms(logged: Logged, body: Body, maps: Sequence[JointMap] = ()) -> Recording:
    recording, commands = logged.recording, np.full(logged.targets.shape, np.nan)
    sign, zero = body.file_counting
    if recording.torques is not None:
        commands = sign * recording.torques
    for k, (joint, own) in enumerate(zip(body.joint_names, body.joint_parts, strict=True)):
        target, torque = logged.targets[:, k], maps[k].torque if maps else None
        added = torque is not None and torque.feedforward
        if not np.isfinite(target).any():
            if own.servo is not None and not added and np.isfinite(commands[:, k]).any():
                raise InputError(
                    f"{recording.name}: a torque of joint {joint!r}, which has a servo in the robot's file: map the "
                    "servo's target; if the joint is driven by torque, write <motor> for its servo; if a sensor "
                    "measured it, --set hide_torque=yes infers without it"
                )
            continue
        if own.servo is None:
            raise InputError(
                f"{recording.name}: targets of joint {joint!r}, which has no servo in the robot's file: give it one "
                '(<position> in MJCF, motor = {kind = "position", …} in TOML), or its torques'
            )
        wanted = servo_torque(own.servo, sign[k] * target + zero[k] * (own.servo.kind == "position"))
        if torque is not None and not added:
            warnings.warn(
                f"{recording.name}: the torque of joint {joint!r} is not used, as its servo has a target: if it is "
                "added to the servo's, write feedforward = true in its line of the map",
                stacklevel=2,
            )
        commands[:, k] = wanted + (commands[:, k] if added else 0.0)
    angles = None if recording.angles is None else zero + sign * recording.angles
    return replace(recording, angles=angles, torques=commands if np.isfinite(commands).any() else None)
