"""What a cause on MuJoCo's engine changes, written into a copy of the MJCF file, and the copy tried on the log.

What is written is what differs in the changed model (:mod:`..write_back.mjcf_writer`), so that what MuJoCo reads of the
copy is what was diagnosed.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Finding, Written
from invdyn.diagnosis.catalogue.engine_effects import EFFECTS, SEVERAL, Candidate, contacts, pair_name
from invdyn.diagnosis.catalogue.model_numbers import Place, changed
from invdyn.diagnosis.engine.cubature_filter import cubature_filter
from invdyn.diagnosis.engine.problem import EngineLog, engine_log, looked_at
from invdyn.diagnosis.rules import FIXED, Rules
from invdyn.diagnosis.write_back.changes import FileChange, comment_of
from invdyn.diagnosis.write_back.ensemble import Copy, drawn
from invdyn.diagnosis.write_back.mjcf_writer import Writer
from invdyn.diagnosis.write_back.write_back import best, replayed
from invdyn.diagnosis.write_back.xml_text import XmlText
from invdyn.models import Scene
from invdyn.models.bodies.body_xml import MOST_BYTES
from invdyn.models.bodies.whole_file import read_whole
from invdyn.models.divergence import Diverged
from invdyn.recordings import Recording, atomic_path


def write_back(
    diagnosis: Diagnosis,
    source: str | Path,
    scene: Scene,
    out: str | Path,
    recording: Recording,
    passive: bool = False,
    held_out: bool = False,
) -> Diagnosis:
    """The diagnosis with what was written: a corrected copy of ``source``, the file of ``scene``, as ``out``.

    Both replay the recording; ``held_out`` says whether the causes were found on another one.

    Without a gap, or a cause, nothing is written, and that is said. Raises OSError where the file cannot be written.
    """
    cause = best(diagnosis)
    if cause is None:
        why = "there is no gap that a file should change for" if not diagnosis.gap.detected else "no cause was found"
        return replace(diagnosis, written=Written(str(out), (), {}, why))
    new, written, unsaid = rewritten(read_whole(source, MOST_BYTES), scene, cause)
    with atomic_path(out) as temporary:
        temporary.write_bytes(new)
        there = Scene.of(Path(temporary), dimensions=scene.dimensions, where=str(out))
        tried = _tried(scene, there, recording, passive, held_out, diagnosis.rules)
    changes = tuple(each.to_json() for each in written)
    return replace(diagnosis, written=Written(str(out), changes, unsaid, rollout=tried))


def copies(diagnosis: Diagnosis, source: str | Path, scene: Scene, members: int) -> Iterator[Copy]:
    """Members of an ensemble (:mod:`..write_back.ensemble`): the file with draws of the causes' numbers."""
    content = read_whole(source, MOST_BYTES)
    for cause in drawn(diagnosis, members, diagnosis.seed):
        yield (content, (), {}) if cause is None else rewritten(content, scene, cause)


def rewritten(content: bytes, scene: Scene, cause: Cause) -> tuple[bytes, list[FileChange], dict[str, str]]:
    """The content with a cause's numbers; what was written, and what was not: words → why."""
    text = XmlText(content)
    model = now = scene.model
    writer = Writer(text, model)
    written: list[FileChange] = []
    unsaid: dict[str, str] = {}
    for finding in cause.effects:
        candidate = candidate_of(model, finding)
        numbers, place = candidate.effect.numbers, candidate.place
        found = [finding.parameters[number.name] for number in numbers]
        changes = [
            FileChange(place.name, place.word(n.name), n.read(model, place), e.mean, e.interval_90, e.unit, finding.key)
            for n, e in zip(numbers, found, strict=True)
        ]
        after = changed(now, [(n.write, place, e.mean) for n, e in zip(numbers, found, strict=True)])
        why = writer.write(now, after, comment_of(changes))
        if why is None:
            written, now = written + changes, after
        else:
            unsaid |= {change.words: why for change in changes}
    return text.changed(), written, unsaid


def candidate_of(model: Any, finding: Finding) -> Candidate:
    """The effect and place that a finding names."""
    effect = next(each for each in EFFECTS if each.name == finding.effect)
    (name,) = finding.where.values()
    if effect.places is contacts:
        names = {pair_name(model, pair): pair for pair in permutations(range(model.ngeom), 2)}
        pairs = tuple(names[each] for each in name.split(SEVERAL))
        return Candidate(effect, Place("contact", name, pairs[0][0], pairs))
    every = tuple(permutations(range(model.ngeom), 2))
    return Candidate(effect, next(each for each in effect.places(model, every) if each.name == name))


def _tried(
    before: Scene, after: Scene, recording: Recording, passive: bool, held_out: bool, rules: Rules
) -> dict | None:
    """How far replays with the file and with the copy are off the encoders; None without any."""
    if recording.angles is None:
        return None
    recording = looked_at(recording, rules)
    try:
        off = [replay_errors(engine_log(recording, scene, passive=passive, rules=rules)) for scene in (before, after)]
    except Diverged:
        return None
    return replayed(recording, held_out, *off)


def replay_errors(log: EngineLog) -> dict[str, float]:
    """Errors of angles, root mean square by joint, of replays that begin at a filtered state a window; {} without."""
    size = np.array([FIXED.engine_start_size])
    mean = cubature_filter(log.with_residual(1.0), log.observations.numpy(), size).mean[0]
    mean[:, : log.model.torque_size] = 0.0
    rows = len(mean)
    length = max(2, round(FIXED.replay_window / float(np.median(np.diff(log.model.time.numpy())))))
    starts = np.arange(0, rows - 1, length)
    state, off = torch.as_tensor(mean[starts]), []
    seen = log.recording.angles
    if seen is None:
        return {}
    columns = [log.model.scene.joint_names.index(name) for name in log.recording.joint_names]
    for step in range(1, length):
        there = starts + step < rows
        starts, state = starts[there], state[torch.as_tensor(there)]
        if not len(starts):
            break
        state = log.model.moved(state, torch.as_tensor(starts + step))
        _, tangent, _, _ = log.model.split(state)
        angles = log.model.reference_angles + tangent.numpy()
        off.append(angles[:, columns] - seen[starts + step])
    errors = np.sqrt(np.nanmean(np.concatenate(off) ** 2, 0))
    return dict(zip(log.recording.joint_names, errors.tolist(), strict=True))
