"""`report.html`: one page, without anything from outside, that tells a person in a minute what was found.

Same diagnosis, same bytes. All that a file contained (names of joints, keypoints, recordings) is escaped by the
template; beyond that the page's content security policy lets only the one script run whose digest it carries, and no
request out.
"""

import base64
import hashlib
from functools import cache, partial
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Estimate
from invdyn.diagnosis.problem.regime import REGIMES
from invdyn.diagnosis.report.arm import arm
from invdyn.diagnosis.report.figures import maps, residuals, timeline
from invdyn.diagnosis.report.numbers import apart, estimate, fixed, handies, handy, known, percent, plain, plus_minus
from invdyn.diagnosis.report.regression_sentences import number_words, of_parts
from invdyn.diagnosis.report.replay import replay
from invdyn.diagnosis.report.sentences import details, kind, left, left_over, verdict
from invdyn.diagnosis.report.words import (
    SHORT_SIDES,
    cause_words,
    finding_words,
    key_words,
    meaning,
)
from invdyn.diagnosis.rules import FIXED
from invdyn.recordings.atomic import write_text

GIVEN = (
    apart,
    fixed,
    handies,
    handy,
    known,
    percent,
    plain,
    estimate,
    plus_minus,
    cause_words,
    finding_words,
    meaning,
)
"""Functions that the page's template calls."""
TEMPLATES = Path(__file__).parent / "templates"


def write_report(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write the page to `path`, whole or not at all. Raises OSError as :func:`invdyn.recordings.check_writable`."""
    write_text(path, render(diagnosis))


def render(diagnosis: Diagnosis) -> str:
    """The page as HTML."""
    answer = kind(diagnosis)
    script = (TEMPLATES / "replay.js").read_text(encoding="utf-8")
    enough = answer != "not_enough_data"
    moving = replay(diagnosis) if enough else None
    page = environment(TEMPLATES).get_template("report.html.j2")
    return page.render(
        d=diagnosis,
        answer=answer,
        verdict=verdict(diagnosis),
        details=details(diagnosis),
        regime=REGIMES[diagnosis.regime].phrase,
        tiles=_tiles(diagnosis) if enough else [],
        sides=SHORT_SIDES,
        arm=arm(diagnosis),
        timeline=timeline(diagnosis) if enough else None,
        maps=maps(diagnosis) if enough else [],
        residuals=residuals(diagnosis) if enough else [],
        ranked=_ranked(diagnosis),
        best=max((c.log_evidence for c in diagnosis.causes if known(c.log_evidence)), default=0.0),
        left_over=left_over(diagnosis),
        shown=FIXED.num_shown,
        replay=moving,
        data=htmlsafe_json_dumps(moving["data"], separators=(",", ":"), allow_nan=False) if moving else None,
        left=left(diagnosis),
        regressed=_regressed(diagnosis),
        faint=plain(diagnosis.rules.evidence.min_dprime, 2),
        clear=plain(diagnosis.rules.evidence.clear_dprime, 2),
        hidden_torque=not diagnosis.knows_torque,
        hidden=[key_words(key, diagnosis) for key in diagnosis.not_identifiable],
        visible=by_visibility(diagnosis),
        screened=[(key_words(key, diagnosis), fixed(value, 1)) for key, value in diagnosis.screened],
        words_of=partial(key_words, diagnosis=diagnosis),
        method={name.replace("_", " "): text for name, text in diagnosis.method.items()},
        **{each.__name__: each for each in GIVEN},
        script=Markup(script),
        style=Markup((TEMPLATES / "report.css").read_text(encoding="utf-8")),
        digest=digest(script),
    )


def digest(script: str) -> str:
    """What a content security policy calls a script, base64 of its SHA-256."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


@cache
def environment(folder: Path) -> Environment:
    """Templates of a folder, which escape all that they are given."""
    return Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _ranked(diagnosis: Diagnosis) -> list[Cause | None]:
    """The causes, None for what is outside the catalogue among them, most probable first."""
    outside = diagnosis.outside

    def probable(cause: Cause | None) -> float:
        share = (cause or outside).probability
        return share if known(share) else 0.0

    some = diagnosis.causes or known(outside.probability)
    return sorted([*diagnosis.causes, *([None] if some else [])], key=lambda cause: -probable(cause))


def _regressed(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Rows of what a regression found: what, value, interval, probability; what a link's number is known with."""
    found = diagnosis.regression.numbers if diagnosis.regression is not None else ()
    rows: list[tuple[str, ...]] = []
    for each in found:
        with_others = "".join(
            f" {'+' if f > 0 else '−'} {plain(abs(f), 2)} × {name}" for name, f in each.known_with.items()
        )
        value, interval = estimate(Estimate(each.value, each.sd, each.interval_90, each.unit))
        value += f" ({', '.join(of_parts(each))})" * bool(each.by_part)
        rows.append((number_words(each) + with_others, value, interval, percent(each.probability)))
    return rows


def _tiles(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """Name, number and note of the few numbers that stand next to the verdict."""
    gap, shrinkage = diagnosis.gap, diagnosis.shrinkage
    tiles = [("Gap", percent(gap.probability), "probability that there is one")]
    nominal, corrected = (gap.elpd_per_frame.get(name) for name in ("nominal", "corrected"))
    if gap.detected and known(nominal) and known(corrected):
        tiles.append(("Size", f"{fixed(corrected - nominal, 2)} nats", "a frame, gained by the correction"))
    if gap.detected and known(shrinkage.gap_closed):
        low, high = shrinkage.interval_90 or (None, None)
        note = f"90 % interval {percent(low)} to {percent(high)}" if known(low) else "share of the gap"
        tiles.append(("Closed", percent(shrinkage.gap_closed), note))
    before, after = (gap.replay_rms_m.get(name) for name in ("nominal", "corrected"))
    if known(before):
        old, new = handies("m", before, after)
        fixed_by = f"; corrected {new}" if gap.detected and known(after) else ""
        tiles.append(("Replay", old, f"rms off the smoothed recording{fixed_by}"))
    return tiles


def by_visibility(diagnosis: Diagnosis) -> dict[str, list]:
    """Candidates by whether the recording could have shown them, with d′."""
    groups: dict[str, list] = {"yes": [], "faintly": [], "no": []}
    for v in sorted(diagnosis.visibility, key=lambda v: (-v.dprime if known(v.dprime) else 0.0, v.key)):
        name = (
            "no"
            if not v.dprime >= diagnosis.rules.evidence.min_dprime
            else "yes"
            if v.dprime >= diagnosis.rules.evidence.clear_dprime
            else "faintly"
        )
        groups[name].append((key_words(v.key, diagnosis), plain(v.dprime, 2)))
    return groups
