"""`blind.html`: figures with their targets, the calibration curve and the confusion matrix, on one page by itself."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from markupsafe import Markup

from invdyn.blindcheck.measures import Calibration
from invdyn.blindcheck.score import LAST, Scores, shown
from invdyn.diagnosis.report.drawing import Plot
from invdyn.diagnosis.report.report import TEMPLATES as REPORT
from invdyn.diagnosis.report.report import environment
from invdyn.diagnosis.report.words import effect_words
from invdyn.recordings import write_text

TEMPLATES = Path(__file__).parent / "templates"


def write_page(scores: Scores, about: Mapping[str, object], path: str | Path) -> None:
    """Write the page to `path`, whole or not at all; `about` stands in its head as name: value."""
    write_text(path, render(scores, about))


def render(scores: Scores, about: Mapping[str, object]) -> str:
    """The page as HTML. Same scores, same bytes; what comes from files is escaped."""
    styles = [REPORT / "report.css", TEMPLATES / "blind.css"]
    confusion = scores.confusion
    answers = {answer for row in confusion.values() for answer in row} | set(confusion)
    foot = (f"{name.replace('_', ' ')}: {value}" for name, value in about.items() if name != "method")
    return (
        environment(TEMPLATES)
        .get_template("blind.html.j2")
        .render(
            scores=scores,
            about={"method": None, **about},
            judged=[m.met for measures in scores.measures.values() for m in measures if m.met is not None],
            curve=_curve(scores.calibrations["all"]),
            truths=_ordered(confusion),
            answers=_ordered(answers),
            foot="; ".join(foot),
            shown=shown,
            words=_words,
            style=Markup("\n".join(path.read_text(encoding="utf-8") for path in styles)),
        )
    )


def _curve(found: Calibration) -> Markup:
    """How often answers are right, over the probability that they were given."""
    plot = Plot((0.0, 1.0), (0.0, 1.0), "probability of the answer", "share that is right", (5, 5), 260)
    plot.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "line ideal")
    if found.bins:
        stated, right, _ = (np.array(column) for column in zip(*found.bins, strict=True))
        plot.line(stated, right, "line after")
        plot.dots(stated, right, "dot found")
    return plot.html(f"Calibration curve, expected calibration error {shown(found.ece)}")


def _ordered(names: Iterable[str]) -> list[str]:
    """By name; several effects after single ones, then what is no effect."""
    return sorted(names, key=lambda name: (LAST.index(name) + 2 if name in LAST else " + " in name, name))


def _words(name: str) -> str:
    return name if name in LAST else " + ".join(effect_words(part) for part in name.split(" + "))
