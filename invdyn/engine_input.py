"""Which engine moves a body, by what its file holds; an inference and a diagnosis by MuJoCo's."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .input_names import body_file, frame_range
from .settings import spelled

if TYPE_CHECKING:
    import arviz as az

    from invdyn.models import Scene
    from invdyn.recordings import Recording

    from .diagnosis_options import Diagnosed
    from .inference_options import Inference
    from .recording_options import Recorded

    EngineLog = tuple[list[Recording], Recording | None, Scene, list[str]]
    """Logs, the one that is held out, their simulation, and why MuJoCo simulates it."""

ENGINES = ("auto", "mujoco", "own")
UNUSED = ("learn", "scale", "base", "calibration", "tracker", "zero_torque", "hide_torque", "checkpoint", "forces")
"""Options that have no part in an inference by MuJoCo's engine."""
UNUSED_IN_DIAGNOSIS = (
    *("camera", "estimate", "budget", "hide_torque", "checkpoint"),
    *("scale", "base", "calibration", "tracker", "workers"),
)
"""The same of a diagnosis."""


def engine_reasons(given: "Recorded", engine: str) -> list[str] | None:
    """Why MuJoCo's engine is taken, or None where it is not.

    By default it is for a table of keypoints whose body's file holds what rigid links with joints lack. Raises
    InputError for another word than ``ENGINES``, and for a file that MuJoCo does not read.
    """
    from invdyn.models import Scene
    from invdyn.models.engine.needed import reasons, reasons_for_engine
    from invdyn.recordings import InputError

    from .inputs import TABLE, source_of

    if engine not in ENGINES:
        raise InputError(f"--set engine: expected {', '.join(ENGINES)}, got {engine!r}")
    if engine == "own":
        return None
    table = source_of(given.recordings, given.calibration, given.mapping) is TABLE
    if engine == "auto" and not table:
        return None
    if not table:
        raise InputError("--set engine=mujoco: expected a table of keypoints or angles: track or export it first")
    if given.body is None:
        if engine == "mujoco":
            raise InputError("--set engine=mujoco: expected --body with MuJoCo's file, got a person's height")
        return None
    with body_file(given.body) as path:
        if engine == "mujoco":
            return reasons(Scene.of(Path(path))) or ["as --set engine says"]
        return reasons_for_engine(path) or None


def infer_by_engine(
    given: "Inference", method: str, drive: str, reasons: list[str], progress: Callable[..., Any], executor: Any
) -> "az.InferenceData":
    """Read recording, model and truth, and infer. Raises InputError, BodyError or OSError as readers do."""
    from invdyn.inference.infer_engine import DRAWS, FILTERS, PARTICLES, infer_engine
    from invdyn.models import TORQUE_PROCESSES
    from invdyn.recordings import load, read_truth

    _refuse_unused(given, UNUSED)
    recording, scene = _recording(given, load(given.recording, **_reading(given)))
    usual = type(given).__dataclass_fields__
    truth = None if given.truth is None else read_truth(given.truth)
    sizes: dict[str, Any] = {
        "num_filters": FILTERS if given.filters == usual["filters"].default else given.filters,
        "num_particles": PARTICLES if given.particles == usual["particles"].default else given.particles,
        "num_draws": DRAWS if given.draws == usual["draws"].default else given.draws,
    }
    return infer_engine(
        recording,
        scene,
        method=method,
        **sizes,
        seed=given.seed,
        drive=drive,
        torque=None if given.torque == usual["torque"].default else TORQUE_PROCESSES[given.torque](),
        family=given.family,
        truth=truth,
        progress=progress,
        executor=executor,
        reasons=reasons,
    )


def _reading(given: "Recorded") -> dict[str, Any]:
    return {key: getattr(given, key) for key in ("units", "fps", "format", "individual")}


def _refuse_unused(given: "Recorded", unused: Sequence[str]) -> None:
    from invdyn.recordings import InputError

    usual = type(given).__dataclass_fields__
    for name in unused:
        if getattr(given, name) != usual[name].default:
            option = spelled(type(given), name)
            raise InputError(f"{option}: has no part in MuJoCo's engine: leave it out, or --set engine=own")


def _recording(given: "Recorded", seen: "Recording", actuators: bool = False) -> "tuple[Recording, Scene]":
    """The table, in metres, of keypoints, joints and, if wanted, actuators that the body's file has; and its scene.

    ``seen`` is the table as it stands, which tells whether it lies in a plane.
    """
    from invdyn.models import Scene
    from invdyn.recordings import FORMATS, InputError, load
    from invdyn.recordings.formats.registry import recognise
    from invdyn.recordings.plane import FLAT, in_space

    flat = given.plane is not None or not in_space(seen)
    with body_file(str(given.body)) as path:
        scene = Scene.of(Path(path), dimensions=2 if flat and seen.keypoint_names else 3)
    columns = tuple(dict.fromkeys((*scene.joint_names, *(scene.actuator_names if actuators else ()))))
    plane = (given.plane or FLAT) if flat and seen.keypoint_names else None
    name = given.recording
    slides = tuple(
        joint for joint, dof in zip(scene.joint_names, scene.model.dof_jntid, strict=True)
        if scene.model.jnt_type[dof] == 2
    )  # fmt: skip
    recording = load(name, joints=columns, shifting=slides, plane=plane, **_reading(given))
    if recording.length_unit == "px":
        raise InputError(f"{name}: keypoints are in px, and MuJoCo's model is in metres: pass --units and a scale")
    points, sites = recording.keypoint_names, scene.keypoint_names
    own = Path(name).exists() and FORMATS[recognise(Path(name), given.format)].read is None
    if not own and any(point in sites for point in points):
        recording = recording.with_keypoints([point for point in points if point in sites])
    return recording.at(frame_range(given.frames)), scene


def _another(given: "Diagnosed", name: str) -> "Recording":
    """One more table, whole."""
    from dataclasses import replace

    from invdyn.recordings import load

    given = replace(given, recordings=[name], frames=type(given).frames)
    return _recording(given, load(name, **_reading(given)), actuators=True)[0]


def engine_log_of(given: "Diagnosed", engine: str) -> "EngineLog | None":
    """The logs, their simulation, and why MuJoCo's engine diagnoses it; None where it does not.

    By default it does where the file has equality constraints, tendons, muscles or lagging actuators, or where the
    joints' own angles touch what stands in the world; and commands are known. A log of encoders that lacks one of the
    file's joints shows no such part. Raises as :func:`engine_reasons`, and
    InputError for options that have no part in it.
    """
    from invdyn.diagnosis.engine.problem import sensed
    from invdyn.models.engine.needed import touched
    from invdyn.recordings import InputError, load

    several = len(given.recordings) > 1
    if several and engine == "mujoco":
        raise InputError("--set engine=mujoco: expected one recording, got several: name the others with --with")
    reasons = None if several else engine_reasons(given, engine)
    if reasons is None:
        return None
    seen = load(given.recording, **_reading(given))
    if engine == "auto" and (given.hide_torque or not (given.zero_torque or seen.torques is not None)):
        return None
    recording, scene = _recording(given, seen, actuators=True)
    by_contact = engine == "auto" and all(reason.startswith("contact of") for reason in reasons)
    if by_contact and not touched(scene, recording.angles, recording.joint_names):
        return None
    by_encoders = engine == "auto" and not recording.keypoint_names
    if by_encoders and not by_contact and set(scene.joint_names) - set(sensed(recording, scene).joint_names):
        return None  # a gripper's tendon, say, of an arm's log: nothing shows it
    _refuse_unused(given, UNUSED_IN_DIAGNOSIS)
    held_out = None if given.held_out is None else _another(given, given.held_out)
    return [recording, *(_another(given, name) for name in given.more)], held_out, scene, reasons


def diagnose_by_engine(
    given: "Diagnosed",
    recordings: "list[Recording]",
    held_out: "Recording | None",
    scene: "Scene",
    reasons: list[str],
    progress: Callable[..., Any],
    out: Path | None,
    members: int,
) -> Any:
    """The diagnosis, with a corrected copy of the body's file as ``out``, and ``members`` of an ensemble.

    Raises InputError or OSError.
    """
    from dataclasses import replace
    from functools import partial

    from invdyn.diagnosis.engine.diagnose import diagnose_engine
    from invdyn.diagnosis.engine.write_back import copies, write_back
    from invdyn.diagnosis.rules import DEFAULT

    tolerance = given.tolerance
    if tolerance is None and given.robot:
        tolerance = DEFAULT.evidence.robot_tolerance
    rules = DEFAULT if tolerance is None else DEFAULT.replace(tolerance=tolerance)
    passive = given.zero_torque
    without = partial(replace, torques=None) if passive else lambda each: each
    diagnosis = diagnose_engine(
        list(map(without, recordings)),
        scene,
        held_out=None if held_out is None else without(held_out),
        passive=passive,
        without=given.excluded,
        most=given.max_effects,
        seed=given.seed,
        rules=rules,
        force=given.force,
        reasons=reasons,
        progress=progress,
    )
    with body_file(str(given.body)) as path:
        if out is not None:
            shown = held_out or recordings[0]
            diagnosis = write_back(diagnosis, path, scene, out, shown, passive, held_out is not None)
        return diagnosis, list(copies(diagnosis, path, scene, members))
