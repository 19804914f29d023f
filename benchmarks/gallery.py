"""Any state-space model: seventeen models × all generic methods, against exact answers (:mod:`gallery_answers`).

A method runs R times on one recording of a model, with other seeds; twice if the second run, which imports nothing,
costs more than ``COSTLY`` CPU seconds. :mod:`gallery_table` says when a cell is right.

    python benchmarks/gallery.py [--models Cox growth] [--methods smc] [--replicates 10] [--results build/gallery.jsonl]
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
from gallery_table import METHODS, MIXED, OWN, show

from invdyn.inference import infer_states
from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.rao_blackwellised import rao_blackwellised, smooth_inner
from invdyn.inference.posterior.posterior import evidence_note
from invdyn.inference.smoothing.forward_backward import forward_backward
from invdyn.recordings import InputError

COSTLY = 10.0
"""CPU seconds of a second run after which there is no other."""

ROUNDING = 1e-3
"""Nats that float32 may lose."""

SIZES = {"num_filters": 32, "num_particles": 100}
DRAWS = {"particle-gibbs": 8, "nuts": 16}
"""Of each filter or 32nd part of the draws; 4 of other methods."""


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
    idata = infer_states(model, rows, method=method, seed=seed, num_draws=DRAWS.get(method, 4), **SIZES)
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
    runs: list[dict] = []
    seconds: list[float] = []
    for number in range(replicates):
        if number > 1 and seconds[1] > COSTLY:
            break
        started = time.process_time()
        try:
            runs.append(run(model, rows, method, 100 + number))
        except (ModelError, InputError) as error:
            return {"model": name, "method": method, "failure": "refused", "why": str(error)}
        except Exception as error:  # a fault that the table has to show
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            return {"model": name, "method": method, "failure": "failed", "why": why}
        seconds.append(time.process_time() - started)
    found = {"model": name, "method": method, "runs": len(runs), "cpu": round(float(np.median(seconds)), 2)}
    return found | figures(exact, runs)


def figures(exact: Answer, runs: list[dict]) -> dict:
    """What is compared, of the runs that call themselves usable."""
    usable = [each for each in runs if not each.get("note")]
    found: dict = {"usable": len(usable), "why": next((each["note"] for each in runs if each.get("note")), "")}
    found["guide"] = ", ".join(sorted({each.get("guide", "") for each in runs}))
    return found | (evidence_figures(exact, usable) | state_figures(exact, usable) if usable else {})


def evidence_figures(exact: Answer, runs: list[dict]) -> dict:
    """How far log of the mean Ẑ is off, its standard error, and how many runs are beyond 3 errors of their own."""
    values, sds = (np.array([each[key] for each in runs], float) for key in ("log_evidence", "sd"))
    if np.isnan(values).any():
        return {}
    off = float(np.logaddexp.reduce(values) - math.log(len(values))) - exact.log_evidence
    relative = np.exp(values - values.max())
    scatter = float(relative.std(ddof=1) / relative.mean() / math.sqrt(len(values))) if len(values) > 1 else 0.0
    floor = math.hypot(exact.log_evidence_sd, ROUNDING)
    beyond = np.abs(values - exact.log_evidence) / np.hypot(sds, floor)
    return {
        "off": off,
        "error": math.hypot(scatter, floor),
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


def growth(count: int, first: int) -> None:
    """Fresh recordings of the growth model by the default call, 100 rows each."""
    from gallery_one_state import Growth

    right = wrong = doubted = 0
    seconds = time.process_time()
    for seed in range(first, first + count):
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
    parser.add_argument("--replicates", type=int, default=10)
    parser.add_argument("--results", type=Path, default=Path("build/gallery.jsonl"))
    parser.add_argument("--growth", type=int, default=0, metavar="RECORDINGS")
    parser.add_argument("--first", type=int, default=500, help="seed of the first of these recordings")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    if options.growth:
        return growth(options.growth, options.first)

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
