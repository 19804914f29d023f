"""A diagnosis in files: a JSON, a page, and the posterior with what the page draws."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import arviz as az

from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.report.report import render
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference import save_posterior
from invdyn.recordings import whole_set, write_text


def save(diagnosis: Diagnosis, folder: str | Path, *, workers: int = 1) -> None:
    """Write diagnosis.json, report.html and posterior.nc into ``folder``, which exists; all of them or none.

    Without a posterior, one that lies there from an earlier diagnosis is removed. By as many processes as there are
    ``workers``. Raises OSError where they cannot be written.
    """
    folder, posterior = Path(folder), _with_tracks(diagnosis)

    def texts() -> tuple[str, str]:
        return json.dumps(diagnosis.to_json(), indent=1, ensure_ascii=False) + "\n", render(diagnosis)

    with whole_set():  # so this process writes all of it
        parts: list[Callable[[], Any]] = [texts]
        if posterior is not None:
            parts.insert(0, partial(save_posterior, posterior, folder / "posterior.nc"))
        as_json, page = side_by_side(parts, workers)[-1]
        write_text(folder / "diagnosis.json", as_json)
        write_text(folder / "report.html", page)
    if posterior is None:
        (folder / "posterior.nc").unlink(missing_ok=True)


def _with_tracks(diagnosis: Diagnosis) -> az.InferenceData | None:
    """The posterior, and in its group "tracks" what the report draws, with the report's words for it."""
    posterior, tracks = diagnosis.posterior, diagnosis.tracks
    if posterior is None or tracks is None:
        return posterior
    sites = tuple(str(name) for name in posterior["posterior"]["keypoint"].values)
    drawn = tracks.dataset(diagnosis.joint_names, sites)
    drawn.attrs |= {"recording": diagnosis.recording, "verdict": verdict(diagnosis)}
    drawn.attrs["details"] = "\n".join(details(diagnosis))
    groups: dict[str, Any] = {name: posterior[name] for name in posterior.groups()}
    return az.InferenceData(attrs=posterior.attrs, **groups, tracks=drawn)
