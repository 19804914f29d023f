"""`blind.html`: figures with their targets, the calibration curve and the confusion matrix, on one page by itself."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from markupsafe import Markup

from invdyn.blindcheck.measures import Calibration, Measure
from invdyn.blindcheck.score import LAST, Scores, shown
from invdyn.diagnosis.report.drawing import Plot
from invdyn.diagnosis.report.report import TEMPLATES
from invdyn.diagnosis.report.words import effect_words
from invdyn.recordings import write_text

STYLE = """
main, header, footer { max-width: 1180px; }
.wide { overflow-x: auto; }
.confusion { font-size: 12px; width: auto; }
.confusion td, .confusion th { padding: 2px 4px; border: 1px solid var(--grid); text-align: center; }
.confusion tbody th { text-align: right; white-space: nowrap; }
.confusion thead th { height: 13em; vertical-align: bottom; padding: 4px 0; }
.confusion thead span { writing-mode: vertical-rl; transform: rotate(180deg); white-space: nowrap; }
.confusion .right { background: color-mix(in srgb, var(--after) calc(var(--share) * 60%), transparent); }
.confusion .wrong { background: color-mix(in srgb, var(--before) calc(var(--share) * 60%), transparent); }
.met { color: var(--after); font-weight: 600; } .missed { color: var(--before); font-weight: 600; }
.line.ideal { stroke: var(--soft); stroke-dasharray: 5 4; }
.dot.found { stroke: var(--after); stroke-width: 9; stroke-linecap: round; }
"""


def write_page(scores: Scores, about: Mapping[str, object], path: str | Path) -> None:
    """Write the page to `path`, whole or not at all; `about` stands in its head as name: value."""
    write_text(path, render(scores, about))


def render(scores: Scores, about: Mapping[str, object]) -> str:
    """The page as HTML. Same scores, same bytes; what comes from files is escaped."""
    report = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    judged = [m.met for measures in scores.measures.values() for m in measures if m.met is not None]
    return Markup(
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; "
        'img-src data:">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><title>Blind check</title>'
        '<link rel="icon" href="data:,"><style>{}{}</style></head><body>'
        '<header><p class="kicker">{}</p><h1>Blind check: {} of {} targets met in {} cases</h1></header><main>'
        "<section><h2>Figures</h2>{}</section>"
        "<section><h2>Calibration</h2><p>How often the most probable answer is right, over the probability that it "
        "was given; exactly right counts, and the dashed line is what it should be. Effects under unknown torque "
        "are left out: what cannot be seen has no right answer.</p>{}</section>"
        "<section><h2>Confusion</h2><p>Rows are the truth, columns the most probable answer, by the effect’s name; "
        'cases with one effect or none.</p><div class="wide">{}</div></section></main>'
        '<footer><p class="note">{}</p></footer></body></html>\n'
    ).format(
        Markup(report),
        Markup(STYLE),
        f"Method: {about.get('method', '–')}",
        sum(judged),
        len(judged),
        len(scores.verdicts),
        _figures(scores),
        _calibration(scores.calibrations),
        _confusion(scores.confusion),
        "; ".join(f"{name.replace('_', ' ')}: {value}" for name, value in about.items() if name != "method"),
    )


def _figures(scores: Scores) -> Markup:
    rows = []
    for kind, measures in scores.measures.items():
        present = [m for m in measures if m.n]
        for number, m in enumerate(present):
            head = Markup('<th scope="rowgroup" rowspan="{}">{}</th>').format(len(present), kind.replace("_", " "))
            rows.append(_figure(m, head if number == 0 else Markup("")))
    return Markup(
        '<div class="wide"><table><thead><tr><th>kind</th><th>figure</th><th>value</th><th>90 % interval</th>'
        "<th>of</th><th>target</th><th>met</th></tr></thead><tbody>{}</tbody></table></div>"
    ).format(Markup("").join(rows))


def _figure(m: Measure, head: Markup) -> Markup:
    met = {None: "", True: Markup('<span class="met">yes</span>'), False: Markup('<span class="missed">no</span>')}
    return Markup(
        '<tr>{}<td>{}</td><td class="number">{}</td><td class="number">{}</td><td class="number">{}</td>'
        '<td class="number">{}</td><td>{}</td></tr>\n'
    ).format(
        head,
        m.name,
        shown(m.value),
        "–" if m.low is None else f"{shown(m.low)}–{shown(m.high)}",
        m.n,
        m.target,
        met[m.met],
    )


def _calibration(calibrations: Mapping[str, Calibration]) -> Markup:
    curve = calibrations["all"]
    plot = Plot((0.0, 1.0), (0.0, 1.0), "probability of the answer", "share that is right", (5, 5), 260)
    plot.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "line ideal")
    if curve.bins:
        stated, right, _ = (np.array(column) for column in zip(*curve.bins, strict=True))
        plot.line(stated, right, "line after")
        plot.dots(stated, right, "dot found")
    rows = Markup("").join(
        Markup(
            '<tr><td>{}</td><td class="number">{}</td><td class="number">{}</td><td class="number">{}</td></tr>'
        ).format(kind.replace("_", " "), sum(n for *_, n in c.bins), shown(c.brier), shown(c.ece))
        for kind, c in calibrations.items()
    )
    return Markup(
        "{}<table><thead><tr><th>kind</th><th>cases</th><th>Brier score</th><th>calibration error</th></tr></thead>"
        "<tbody>{}</tbody></table>"
    ).format(plot.html(f"Calibration curve, expected calibration error {shown(curve.ece)}"), rows)


def _confusion(confusion: Mapping[str, Mapping[str, int]]) -> Markup:
    truths = _ordered(confusion)
    columns = _ordered({answer for row in confusion.values() for answer in row} | set(truths))
    head = Markup("").join(Markup("<th><span>{}</span></th>").format(_words(name)) for name in columns)
    body = []
    for truth in truths:
        row = confusion[truth]
        total = sum(row.values())
        cells = [
            Markup('<td class="{}" style="--share:{:.2f}">{}</td>').format(
                "right" if answer == truth else "wrong", row.get(answer, 0) / total, row.get(answer) or ""
            )
            for answer in columns
        ]
        body.append(Markup('<tr><th scope="row">{}</th>{}</tr>\n').format(_words(truth), Markup("").join(cells)))
    return Markup('<table class="confusion"><thead><tr><th></th>{}</tr></thead><tbody>{}</tbody></table>').format(
        head, Markup("").join(body)
    )


def _ordered(names: Iterable[str]) -> list[str]:
    """By name; several effects after single ones, then what is no effect."""
    return sorted(names, key=lambda name: (LAST.index(name) + 2 if name in LAST else " + " in name, name))


def _words(name: str) -> str:
    return name if name in LAST else " + ".join(effect_words(part) for part in name.split(" + "))
