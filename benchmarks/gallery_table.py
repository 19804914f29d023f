"""When a cell of :mod:`gallery` is right, and its tables.

    right         the mean over runs of Ẑ is within 3 standard errors, by the runs' scatter or as stated; at most one
                  run is off by more than 3 of its own stated errors; smoothed means and 90 % bands are right
    bound         log Ẑ of a variational method is below the truth, within 3 errors
    near          an approximation that states no error: off by at most ``STRONG`` nats, its means by one posterior sd
    refused       one line of an error says why
    not usable    the method itself says so, in "usable" or by an R-hat above ``MIXED``
    wrong         all else

Smoothed means are right if the rms over rows of the error of their mean over runs is at most 3 times its standard error
(with one run, that of its draws' ESS), or below ``SMALL`` posterior sd. Bands of all runs' draws together are right if
they hold 87 to 93 % of the exact posterior, for any simulated path. A variational method's means may be off by one
posterior sd; what its bands hold is stated, and not judged.
"""

import math

from gallery_models import MODELS

from invdyn.models import ConditionallyLinear, FiniteStateModel

METHODS = ("smc", "bootstrap", "particle-gibbs", "laplace", "svi", "svi-markov", "vsmc", "nuts")
OWN = {"forward-backward": FiniteStateModel, "rao-blackwellised": ConditionallyLinear}
"""Methods that are functions, and the models that they take."""

APPROXIMATE = ("laplace", "svi", "svi-markov")
STRONG, MIXED, SMALL = 3.0, 1.1, 0.05
"""A Bayes factor of 20 in nats (Kass & Raftery 1995: strong); R-hat (Gelman & Rubin 1992); posterior sd."""


def error(found: dict) -> float:
    """Standard error of the mean over runs: a few may scatter less than they state, or state less than they scatter."""
    stated = found["stated"] / math.sqrt(found["usable"])
    return max(found["error"], stated) if stated == stated else found["error"]


def verdict(found: dict) -> str:
    """What a cell is, in a word or two."""
    if "failure" in found:
        return found["failure"]
    if not found["usable"]:
        return "not usable"
    method, off, wrong = found["method"], found.get("off", math.nan), []
    if method == "laplace" and not abs(off) <= STRONG:
        wrong.append("evidence")
    elif method in APPROXIMATE and method != "laplace" and not off <= 3 * error(found):
        wrong.append("above the evidence")
    elif method not in APPROXIMATE and off == off and (abs(off) > 3 * error(found) or found["beyond"] > 1):
        wrong.append("evidence")

    room = 1.0 if method in APPROXIMATE else max(3 * found["mean_error"], SMALL)
    if not found["mean_off"] <= room:
        wrong.append("means")
    if method not in APPROXIMATE and not abs(found.get("covers", 0.9) - 0.9) <= 0.03:
        wrong.append("coverage")
    if wrong:
        return "**wrong**: " + ", ".join(wrong)
    return "near" if method == "laplace" else "bound" if method in APPROXIMATE else "right"


def words(found: dict | None) -> str:
    """A cell of the table: verdict; evidence off by, nats; smoothed means off by, posterior sds; 90 % bands hold."""
    if found is None:
        return ""
    said = verdict(found)
    if "failure" in found or not found["usable"]:
        return said
    if found["usable"] < found["runs"]:
        said += f" ({found['usable']} of {found['runs']} usable)"
    parts = []
    if "off" in found:
        parts.append(f"{found['off']:+.2f}" + ("" if found["method"] == "laplace" else f" ± {error(found):.2f}"))
    parts.append(f"{found['mean_off']:.2f}")
    if "covers" in found:
        parts.append(f"{100 * found['covers']:.0f} %")
    return f"{said}; {', '.join(parts)}"


def show(cells: list[dict]) -> None:
    """Print the tables."""
    by = {(each["model"], each["method"]): each for each in cells}
    for methods in (METHODS[:4], METHODS[4:], tuple(OWN)):
        names = [name for name in MODELS if any((name, method) in by for method in methods)]
        print(f"\n{', '.join(methods)}:\n\n| model | " + " | ".join(methods) + " |\n|" + "---|" * (len(methods) + 1))
        for name in names:
            print(f"| {name} | " + " | ".join(words(by.get((name, method))) for method in methods) + " |")

    print("\nCells by verdict, and CPU seconds of a run, median and most:\n")
    kinds = {
        "right": ("right", "bound", "near"),
        **{kind: (kind,) for kind in ("refused", "not usable", "wrong", "failed")},
    }
    print(f"| method | {' | '.join(kinds)} | CPU s |\n|" + "---|" * (len(kinds) + 2))
    for method in (*METHODS, *OWN):
        mine = [each for each in cells if each["method"] == method]
        said = [verdict(each).split(":")[0].strip("*") for each in mine]
        counts = " | ".join(str(sum(each in group for each in said)) for group in kinds.values())
        cpu = sorted(each["cpu"] for each in mine if "cpu" in each) or [math.nan]
        print(f"| {method} | {counts} | {cpu[len(cpu) // 2]:.1f}, {cpu[-1]:.1f} |")

    print("\nWhat is refused, not usable or wrong, and why (the first run that says so):\n")
    print("| model | methods | what | why |\n|---|---|---|---|")
    reasons: dict[tuple[str, str, str], list[str]] = {}
    for name in MODELS:
        for method in (*METHODS, *OWN):
            each = by.get((name, method))
            if each is None or not (each.get("why") or "wrong" in verdict(each)):
                continue
            said = verdict(each).replace("*", "")
            some = said if said in ("refused", "failed", "not usable") or "wrong" in said else "some runs not usable"
            why = each["why"].removeprefix("not usable: ").replace("|", "/")
            reasons.setdefault((name, some, why), []).append(method)
    for (name, some, why), methods in reasons.items():
        print(f"| {name} | {', '.join(methods)} | {some} | {why} |")
