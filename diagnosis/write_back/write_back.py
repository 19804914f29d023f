"""Hand the corrected simulation back: write what the best cause changes into a copy of the file, and try the copy.

The copy is loaded by the reader that read the file; an MJCF is loaded by MuJoCo itself, replays the log there, and so
does the original: what both are off by stands in the report.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Written
from invdyn.diagnosis.problem.angles import recorded_angles
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back import toml, urdf
from invdyn.diagnosis.write_back.changes import Correction, FileChange, Refined, correction, in_files
from invdyn.diagnosis.write_back.xml_text import is_mjcf
from invdyn.models import ArticulatedBody
from invdyn.models.bodies import body_xml
from invdyn.models.bodies.whole_file import read_whole
from invdyn.recordings import InputError, Recording, atomic_path, resolved


def check_write_back(source: str | Path, out: str | Path) -> None:
    """Before a long run: raise InputError where a corrected copy of ``source`` could not be used as ``out``."""
    if not resolved(source).exists():
        raise InputError(f"{source} is no file, and only a file has a copy to correct: leave --write-back out")
    content = read_whole(source, body_xml.MOST_BYTES)
    if f"<{body_xml.OSIM}".encode() in content:
        raise InputError(f"{source}: no corrected copy is made of an OpenSim model: leave --write-back out")
    suffixes = (
        (".xml", ".mjcf") if b"<mujoco" in content else (".urdf", ".xml") if body_xml.is_xml(content) else (".toml",)
    )
    if Path(out).suffix not in suffixes:
        raise InputError(f"{out}: expected a name that ends in {' or '.join(suffixes)}, as {source} is such a file")
    if b'file="' in content and Path(out).resolve().parent != Path(source).resolve().parent:
        raise InputError(f"{out}: {source} names other files (meshes, includes): put the copy into the same folder")


def write_back(
    diagnosis: Diagnosis,
    source: str | Path,
    body: ArticulatedBody,
    out: str | Path,
    recording: Recording,
    held_out: bool,
    refined: Refined | None = None,
    why: str = "no cause was found",
) -> Diagnosis:
    """The diagnosis with what was written: a corrected copy of ``source``, the file of ``body``, as ``out``.

    ``recording`` is replayed in both, where MuJoCo reads them; ``held_out`` says whether the causes were found on
    another one; ``refined`` are the numbers of an output-error fit (:mod:`.output_error`). Without a gap, or a cause,
    nothing is written, and that is said, of a cause with ``why``. Raises OSError where the file cannot be written.
    """
    cause = best(diagnosis)
    if cause is None:
        why = why if diagnosis.gap.detected else "there is no gap that a file should change for"
        return replace(diagnosis, written=Written(str(out), (), {}, why))
    content = read_whole(source, body_xml.MOST_BYTES)
    wanted = correction(cause, body) if refined is None else Correction(refined.changes, {})
    mjcf = is_mjcf(content)
    new, left = rewritten(content, source, body, wanted.changes)
    if refined is not None and left:
        # a number that the file cannot say would be missing from those that were fitted with it
        return write_back(diagnosis, source, body, out, recording, held_out)
    tried = None
    try:
        with atomic_path(out) as temporary:
            temporary.write_bytes(new)
            if mjcf:
                tried = _tried(str(source), str(temporary), body, recording, held_out)
            if tried and diagnosis.regressed is not None and _worse(tried):
                raise _Worse  # so that this file does not stay
    except _Worse:
        # MuJoCo has the last word: the file then follows the regression, or the search
        if refined is not None:
            return write_back(diagnosis, source, body, out, recording, held_out)
        why = "MuJoCo replays the file that the regression corrects no better than the original"
        return write_back(replace(diagnosis, regressed=None), source, body, out, recording, held_out, why=why)
    changes = tuple(each.to_json() for each in wanted.changes if each.words not in left)
    fit = None if refined is None else refined.to_json()
    written = Written(str(out), changes, {**wanted.unsaid, **left}, rollout=tried, refined=fit)
    return replace(diagnosis, written=written)


class _Worse(Exception):
    """The copy that follows the regression is further off than the file."""


def _worse(tried: dict) -> bool:
    """Whether replays of the copy are further off than those of the file."""
    return bool(tried["total_rms_rad"]["after"] >= tried["total_rms_rad"]["before"])


def rewritten(
    content: bytes, source: str | Path, body: ArticulatedBody, changes: Sequence[FileChange]
) -> tuple[bytes, dict[str, str]]:
    """The content of the file ``source`` with the changes; and what could not be written: words → why."""
    if is_mjcf(content):
        from invdyn.diagnosis.write_back import mjcf as writer

        return writer.rewritten(content, str(source), body, changes)
    if body_xml.is_xml(content):
        return urdf.rewritten(content, changes)
    return toml.rewritten(content, body, changes)


def best(diagnosis: Diagnosis) -> Cause | None:
    """The cause that most speaks for, by itself or in part; None where it changes no number of the file.

    Without a gap that is no effect, with the joints' and links' numbers that were learned. Where the regression is the
    answer, it is the cause.
    """
    if diagnosis.regressed is not None:
        return diagnosis.regressed
    causes = [c for c in diagnosis.causes if diagnosis.gap.detected or not c.effects]
    cause = max(causes, key=lambda c: c.probability + c.in_part, default=None)
    if cause is None or not (cause.effects or any(map(in_files, cause.learned))):
        return None
    return cause


def _tried(source: str, out: str, body: ArticulatedBody, recording: Recording, held_out: bool) -> dict | None:
    """Rollout errors of both files, as the JSON has them; None of joints that MuJoCo counts otherwise (a ball)."""
    import mujoco

    from invdyn.diagnosis.write_back.rollout import commands, rollout
    from invdyn.models.bodies.joint_parts_mjcf import joint_names

    model = mujoco.MjModel.from_xml_path(source)
    if set(body.joint_names) - set(joint_names(model)):
        return None
    order = [recording.joint_names.index(name) for name in body.joint_names] if recording.joint_names else []
    angle = recorded_angles(recording, body) if recording.angles is None else recording.angles[:, order]
    # the same commands for both: a gear that was changed must change what they do
    given = commands(model, body, recording)
    before, after = (rollout(path, body, recording.time, np.asarray(angle), given) for path in (source, out))
    said = replayed(recording, held_out, before.angle_rms, after.angle_rms)
    whole = {"before": before.whole, "after": after.whole}
    return said | {"whole_rms_rad": {of: x if np.isfinite(x) else None for of, x in whole.items()}}  # None: it ran away


def replayed(recording: Recording, held_out: bool, before: dict[str, float], after: dict[str, float]) -> dict[str, Any]:
    """What a diagnosis.json has of replays of both files: errors of angles, rms in rad, by joint."""
    import mujoco

    totals = [float(np.sqrt(np.mean(np.square(list(each.values()))))) for each in (before, after)]
    return {
        "engine": f"MuJoCo {mujoco.__version__}",
        "recording": recording.name,
        "held_out": held_out,
        "window_s": FIXED.replay_window,
        "angle_rms_rad": {name: {"before": value, "after": after[name]} for name, value in before.items()},
        "total_rms_rad": dict(zip(("before", "after"), totals, strict=True)),
    }
