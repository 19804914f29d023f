"""Which engine moves a body, by what its file holds, and an inference by MuJoCo's."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .input_names import body_file, frame_range

if TYPE_CHECKING:
    import arviz as az

    from .inference_options import Inference

ENGINES = ("auto", "mujoco", "own")
UNUSED = ("learn", "scale", "base", "calibration", "tracker", "zero_torque", "hide_torque", "checkpoint", "forces")
"""Options that have no part in an inference by MuJoCo's engine."""


def engine_reasons(given: "Inference", engine: str) -> list[str] | None:
    """Why MuJoCo's engine is taken, or None where it is not.

    By default it is for a table of keypoints whose body's file holds what rigid links with joints lack. Raises
    InputError for another word than ``ENGINES``, and for a file that MuJoCo does not read.
    """
    from invdyn.models.engine.needed import reasons_for_engine
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
        found = reasons_for_engine(path)
    if engine == "mujoco":
        return found or ["as --set engine says"]
    return found or None


def infer_by_engine(
    given: "Inference", method: str, drive: str, reasons: list[str], progress: Callable[..., Any], executor: Any
) -> "az.InferenceData":
    """Read recording, model and truth, and infer. Raises InputError, BodyError or OSError as readers do."""
    from invdyn.inference.infer_engine import DRAWS, FILTERS, PARTICLES, infer_engine
    from invdyn.models import TORQUE_PROCESSES, Scene
    from invdyn.recordings import FORMATS, InputError, load, read_truth
    from invdyn.recordings.formats.registry import recognise
    from invdyn.recordings.plane import FLAT, in_space

    usual = type(given).__dataclass_fields__
    for name in UNUSED:
        if getattr(given, name) != usual[name].default:
            option = name.replace("_", "-")
            raise InputError(f"--{option}: has no part in MuJoCo's engine: leave it out, or --set engine=own")
    name = given.recording
    options = {key: getattr(given, key) for key in ("units", "fps", "format", "individual")}
    seen = load(name, **options)
    flat = given.plane is not None or not in_space(seen)
    with body_file(str(given.body)) as path:
        scene = Scene.of(Path(path), dimensions=2 if flat and seen.keypoint_names else 3)
    slides = tuple(
        joint for joint, dof in zip(scene.joint_names, scene.model.dof_jntid, strict=True)
        if scene.model.jnt_type[dof] == 2
    )  # fmt: skip
    plane = (given.plane or FLAT) if flat else None
    recording = load(name, joints=scene.joint_names, shifting=slides, plane=plane, **options)
    if recording.length_unit == "px":
        raise InputError(f"{name}: keypoints are in px, and MuJoCo's model is in metres: pass --units and a scale")
    points, sites = recording.keypoint_names, scene.keypoint_names
    own = Path(name).exists() and FORMATS[recognise(Path(name), given.format)].read is None
    if not own and any(point in sites for point in points):
        recording = recording.with_keypoints([point for point in points if point in sites])
    recording = recording.at(frame_range(given.frames))
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
