"""Any state-space model: seventeen models × all generic methods, against exact answers (:mod:`gallery_answers`).

A method runs R times on one recording of a model, with seeds of its own. A cell of the table is

    right         the mean over runs of Ẑ is within 3 standard errors, by the runs' scatter or as stated, at most one
                  run is off by more than 3 of its own stated errors, smoothed means agree, and 90 % bands hold 87 to 93 %
    bound         log Ẑ of a variational method is below the truth, within 3 errors; its gap stands in the cell
    near          an approximation that states no error: off by at most ``STRONG`` nats, its means by one posterior sd
    refused       one line of ModelError says why
    not usable    the method itself says so, in "usable" or by an R-hat above ``MIXED``
    wrong         all else

Smoothed means agree if the rms over rows of the error of their mean over runs is at most 3 times its standard error
(with one run, that of its draws' ESS), or below ``SMALL`` posterior sd. Bands are of all runs' draws together; what
they hold is by the exact posterior, not by the one path that was simulated.

    python benchmarks/gallery.py [--models Cox growth] [--methods smc] [--replicates 5] [--results build/gallery.jsonl]
    python benchmarks/gallery.py --growth 20     fresh recordings of the growth model, by the default call

Cells in the file of results are not run again; models without an exact answer need `pip install particles==0.4`.
"""

import argparse
import json
import math
import time
import warnings
from pathlib import Path

import arviz as az
import numpy as np
import torch
from gallery_answers import Answer, answer, grid
from gallery_models import MODELS, recording

from invdyn.inference import infer_states
from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.rao_blackwellised import rao_blackwellised, smooth_inner
from invdyn.inference.posterior.posterior import evidence_note
from invdyn.inference.smoothing.forward_backward import forward_backward
from invdyn.models import ConditionallyLinear, FiniteStateModel
from invdyn.recordings import InputError

METHODS = ("smc", "bootstrap", "particle-gibbs", "laplace", "svi", "svi-markov", "vsmc", "nuts")
OWN = {"forward-backward": FiniteStateModel, "rao-blackwellised": ConditionallyLinear}
"""Methods that are functions, and the models that they take."""

COSTLY = {"nuts": 1, "laplace": 1, "svi": 2, "svi-markov": 2, "vsmc": 3}
"""Runs at most, of methods that cost much or that draw no random number for what is compared."""

APPROXIMATE = ("laplace", "svi", "svi-markov")
STRONG, MIXED, SMALL, ROUNDING = 3.0, 1.05, 0.05, 1e-3
"""A Bayes factor of 20 in nats (Kass & Raftery 1995: strong); R-hat; posterior sd; nats that float32 may lose."""

SIZES = {"num_filters": 32, "num_particles": 100, "num_draws": 4}


def run(model, rows: torch.Tensor, method: str, seed: int) -> dict:
    """One run: evidence, its stated error, whether it is usable, and draws (S, T, D)."""
    if method == "forward-backward":
        exact = forward_backward(model, rows)
        draws = exact.sample(1000, seed=seed)
        mean = exact.smoothed @ model.all_states()
        return {"log_evidence": float(exact.log_evidence), "sd": 1e-6, "draws": draws.numpy(), "mean": mean.numpy()}
    if method == "rao-blackwellised":
        found = rao_blackwellised(model, rows, 100, seed=seed, num_filters=32, proposal="optimal")
        smoothed = smooth_inner(model, found, rows, 8, seed=seed)
        outer = outer_weights(found.filter.log_evidence)
        torch.manual_seed(seed)
        inner = smoothed.means + smoothed.covariances.diagonal(dim1=-2, dim2=-1).sqrt() * torch.randn(
            smoothed.means.shape, dtype=torch.float64
        )
        lines = torch.multinomial(outer.log_weights.exp(), 32, replacement=True)
        draws = torch.cat([smoothed.outer, inner], -1)[lines].flatten(0, 1)
        return {"log_evidence": outer.log_evidence, "sd": outer.log_evidence_sd, "draws": draws.numpy()}
    idata = infer_states(model, rows, method=method, seed=seed, **SIZES)
    states = idata["posterior"]["state"].transpose("chain", "draw", "time", "state_name")
    draws = states.values.reshape(-1, *states.shape[2:])
    statistics = idata["sample_stats"].attrs
    note = evidence_note(idata)
    if not note and statistics.get("r_hat", 1.0) > MIXED:
        note = f"R-hat {statistics['r_hat']:.2f}"
    return {
        "log_evidence": idata.attrs["log_evidence"],
        "sd": idata.attrs["log_evidence_sd"],
        "note": note,
        "guide": statistics.get("guide", ""),
        "draws": draws,
        "size": float(az.ess(az.convert_to_dataset({"x": states.values}))["x"].median()),
    }


def cell(name: str, method: str, replicates: int, cache: Path) -> dict:
    """All runs of a method on a model, judged."""
    model, _, rows = recording(name)
    rows = check_model(model, rows)
    exact = answer(model, rows, cache / f"{name.replace(' ', '_')}.npz")
    runs, begun = [], time.process_time()
    for number in range(min(replicates, COSTLY.get(method, replicates))):
        try:
            runs.append(run(model, rows, method, 100 + number))
        except (ModelError, InputError) as error:
            return {"model": name, "method": method, "verdict": "refused", "why": str(error)}
        except Exception as error:  # a fault that the table has to show
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            return {"model": name, "method": method, "verdict": "failed", "why": why}
    seconds = (time.process_time() - begun) / len(runs)
    found = {"model": name, "method": method, "runs": len(runs), "cpu": round(seconds, 2)}
    return found | judged(method, exact, runs)


def judged(method: str, exact: Answer, runs: list[dict]) -> dict:
    """Verdict on the runs that call themselves usable, and its figures."""
    usable = [each for each in runs if not each.get("note")]
    figures: dict = {"usable": len(usable), "why": next((each["note"] for each in runs if each.get("note")), "")}
    figures["guide"] = ", ".join(sorted({each.get("guide", "") for each in runs}))
    if not usable:
        return {"verdict": "not usable", **figures}
    figures |= evidence_figures(exact, usable) | state_figures(exact, usable)
    wrong = []
    off, error = figures.get("off", math.nan), figures.get("error", math.nan)
    if method in APPROXIMATE:
        if method == "laplace" and not abs(off) <= STRONG:
            wrong.append("evidence")
        if method != "laplace" and off > 3 * error:
            wrong.append("above the evidence")
        if figures["mean_off"] > 1:
            wrong.append("means")
    else:
        if off == off and (not abs(off) <= 3 * error or figures["beyond"] > 1):
            wrong.append("evidence")
        if figures["mean_off"] > max(3 * figures["mean_error"], SMALL):
            wrong.append("means")
        if not abs(figures.get("covers", 0.9) - 0.9) <= 0.03:
            wrong.append("coverage")
    right = {"laplace": "near"}.get(method, "bound" if method in APPROXIMATE else "right")
    return {"verdict": "wrong: " + ", ".join(wrong) if wrong else right, **figures}


def evidence_figures(exact: Answer, runs: list[dict]) -> dict:
    """How far log of the mean Ẑ is off, its standard error, and how many runs are beyond 3 errors of their own."""
    values, sds = (np.array([each[key] for each in runs], float) for key in ("log_evidence", "sd"))
    if np.isnan(values).any():
        return {}
    off = float(np.logaddexp.reduce(values) - math.log(len(values))) - exact.log_evidence
    relative = np.exp(values - values.max())
    scatter = float(relative.std(ddof=1) / relative.mean()) if len(values) > 1 else 0.0
    # A few runs may scatter less than they do at large: the larger of what they show and what they state counts.
    error = max(scatter, float(np.sqrt(np.mean(np.nan_to_num(sds) ** 2)))) / math.sqrt(len(values))
    floor = math.hypot(exact.log_evidence_sd, ROUNDING)
    beyond = np.abs(values - exact.log_evidence) / np.hypot(sds, floor)
    return {
        "off": off,
        "error": math.hypot(error, floor),
        "stated": float(sds.mean()),
        "beyond": int((beyond > 3).sum()),
        "furthest": float(beyond.max()),
    }


def state_figures(exact: Answer, runs: list[dict]) -> dict:
    """Rms over rows of the error of smoothed means, in posterior sds, its standard error, and what 90 % bands hold."""
    means = np.stack([each.get("mean", each["draws"].mean(0)) for each in runs])
    draws = np.concatenate([each["draws"] for each in runs])
    sd = np.where(exact.sd > 1e-9, exact.sd, np.inf)
    off = (means.mean(0) - exact.mean) / sd
    if len(runs) > 1:
        variance = (means.var(0, ddof=1) / len(runs)) / sd**2
    else:
        variance = np.where(exact.sd > 1e-9, 1 / runs[0].get("size", len(draws)), 0.0)
    variance = variance + (exact.mean_sd / sd) ** 2
    figures = {"mean_off": float(np.sqrt((off**2).mean())), "mean_error": float(np.sqrt(variance.mean()))}
    numbers = (draws == draws.round()).all((0, 1))  # of regimes no band is had
    if not numbers.all():
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        figures["covers"] = float(exact.covered(low, high)[:, ~numbers].mean())
    return figures


# -- tables ------------------------------------------------------------------------------------------
def words(found: dict | None) -> str:
    """A cell of the table."""
    if found is None:
        return ""
    verdict, off = found["verdict"], found.get("off", math.nan)
    if verdict in ("refused", "failed", "not usable"):
        return verdict
    if found["usable"] < found["runs"]:
        verdict += f" ({found['usable']} of {found['runs']} usable)"
    evidence = (
        "" if off != off else f" {off:+.2f}" + ("" if found["method"] == "laplace" else f" ± {found['error']:.2f};")
    )
    covers = f", {100 * found['covers']:.0f} %" if "covers" in found else ""
    return f"{verdict}{evidence} {found['mean_off']:.2f}{covers}"


def show(cells: list[dict]) -> None:
    names = [name for name in MODELS if any(each["model"] == name for each in cells)]
    by = {(each["model"], each["method"]): each for each in cells}
    for methods in (METHODS[:4], METHODS[4:], tuple(OWN)):
        rows = [name for name in names if any((name, method) in by for method in methods)]
        print(f"\nMethods {', '.join(methods)}:\n")
        print("| model | " + " | ".join(methods) + " |\n|" + "---|" * (len(methods) + 1))
        for name in rows:
            print(f"| {name} | " + " | ".join(words(by.get((name, method))) for method in methods) + " |")
    print("\nWhat is refused or not usable, or wrong, and why:\n\n| model | method | what | why |\n|---|---|---|---|")
    for each in sorted(cells, key=lambda each: (list(MODELS).index(each["model"]), each["method"])):
        if each.get("why") or each["verdict"].startswith("wrong"):
            print(f"| {each['model']} | {each['method']} | {each['verdict']} | {each['why']} |")


def growth(count: int) -> None:
    """Fresh recordings of the growth model by the default call, 100 rows each."""
    from gallery_one_state import Growth

    right = wrong = doubted = 0
    seconds = time.process_time()
    for seed in range(500, 500 + count):
        model = Growth()
        model.num_steps = 100
        rows = model.simulate(seed=seed)[1]
        exact = grid(model, rows, smooth=False).log_evidence
        idata = infer_states(model, rows, seed=seed)
        off = (idata.attrs["log_evidence"] - exact) / idata.attrs["log_evidence_sd"]
        note = evidence_note(idata)
        doubted += bool(note)
        right += not note and abs(off) <= 3
        wrong += not note and not abs(off) <= 3
        print(
            f"{seed}: {idata.attrs['log_evidence']:.2f} ± {idata.attrs['log_evidence_sd']:.2f}, exact {exact:.2f}, "
            f"{off:+.1f} errors, {idata['sample_stats'].attrs['guide']} {note}",
            flush=True,
        )
    seconds = (time.process_time() - seconds) / count
    print("\n| recordings | right within 3 errors | not usable | wrong and sure | CPU s each |\n|---|---|---|---|---|")
    print(f"| {count} | {right} | {doubted} | {wrong} | {seconds:.1f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--methods", nargs="+", choices=[*METHODS, *OWN], default=[*METHODS, *OWN])
    parser.add_argument("--replicates", type=int, default=5)
    parser.add_argument("--results", type=Path, default=Path("build/gallery.jsonl"))
    parser.add_argument("--growth", type=int, default=0, metavar="RECORDINGS")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    if options.growth:
        return growth(options.growth)

    options.results.parent.mkdir(parents=True, exist_ok=True)
    options.results.touch()
    done = {(each["model"], each["method"]) for each in kept(options.results)}
    for method in options.methods:
        for name in options.models:
            fits = method not in OWN or issubclass(MODELS[name], OWN[method])
            if fits and (name, method) not in done:
                found = cell(name, method, options.replicates, options.results.parent / "gallery")
                with options.results.open("a") as out:
                    out.write(json.dumps(found) + "\n")
    show(kept(options.results))


def kept(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


if __name__ == "__main__":
    main()
