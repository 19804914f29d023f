"""Muscles from markers: which of six a motion tells, and whether ranks of two muscles' activations are even.

MuJoCo moves an arm (`tests/muscled_arms.py`) by known excitations: shoulder and elbow, six muscles in the places of
OpenSim's arm26, two of which cross both joints. Markers at elbow and wrist at 100 Hz have 1 mm of noise. From them
`infer_engine` infers excitations and activations with fitted noise. The first table has, of each muscle, the mean width
of its activation's 90 % band, as a share of the prior's, and the share of rows in which it holds the truth.

The second is simulation-based calibration (S. Talts and others, "Validating Bayesian inference algorithms with
simulation-based calibration", arXiv:1804.06788, 2018) of one joint with two muscles: drawn from the model, inferred by
the look-ahead's filters, ranks of the truth among draws, and the Kolmogorov–Smirnov test of their evenness.

    python benchmarks/muscles.py [--rows 60] [--filters 16] [--simulations 100]
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import muscled_arms
from leg import PATHS, held, rms
from scipy.stats import kstest

from invdyn.inference.infer_engine import infer_engine
from invdyn.inference.infer_states import infer_states
from invdyn.models import EngineModel, Keypoints, Observation, Scene
from invdyn.models.engine.drives import Controls


def six(rows: int, filters: int) -> None:
    """Print the table of six muscles."""
    recording, truth = muscled_arms.recording(muscled_arms.SIX, rows, seed=0)
    scene = Scene.of(muscled_arms.SIX, dimensions=2)
    begin = time.process_time()
    idata = infer_engine(recording, scene, seed=0, num_filters=filters, num_draws=-(-PATHS // filters))
    seconds = time.process_time() - begin
    posterior = idata["posterior"].stack(sample=("chain", "draw"), create_index=False)
    activation = posterior["activation"].transpose("sample", "time", "activation_of").values
    torque = posterior["torque"].transpose("sample", "time", "joint").values
    prior, _ = EngineModel(scene, recording.time, drive=Controls()).simulate((PATHS,), seed=1)
    width = np.diff(np.quantile(activation, [0.05, 0.95], axis=0), axis=0)[0].mean(0)
    usual = np.diff(np.quantile(prior[..., -activation.shape[-1] :].clamp(0, 1), [0.05, 0.95], axis=0), axis=0)
    holds = held(activation, truth["activation"]).mean(0)
    own, true = torque[:, :-1], truth["torque"][:-1]
    spread = idata["sample_stats"]["log_evidence"].values.std(ddof=1)
    off, inside = rms(np.median(own, 0) - true), held(own, true).mean()
    print(
        f"Six muscles over {rows} rows: {seconds:.0f} CPU s, sd of log Ẑ over {filters} filters {spread:.2f}, "
        f"muscles' torque off by {off:.2g} of {rms(true):.2g} N·m, in band {inside:.2f}"
    )
    print("\n| muscle | band, of the prior's | in band |\n|---|---|---|")
    for a, name in enumerate(posterior["activation_of"].values):
        print(f"| {name} | {width[a] / usual[0].mean(0)[a]:.2f} | {holds[a]:.2f} |")


def two(simulations: int, rows: int = 12) -> None:
    """Print the table of ranks."""
    known = {"emission.keypoint_scale": 0.002, "initial.angle": 0.8, "initial.angle_scale": 0.2}
    known |= {"initial.velocity_scale": 0.5, "initial.activation_scale": 0.1}
    wrist, scene = Observation(Keypoints(["wrist"])), Scene.of(muscled_arms.TWO, dimensions=2)
    model = EngineModel(scene, np.arange(rows) * 0.01, wrist, drive=Controls(), parameters=known)
    ranks, begin = [], time.process_time()
    for seed in range(simulations):
        path, seen = model.simulate(seed=seed)
        found = infer_states(model, seen, num_filters=6, num_particles=50, num_draws=10, seed=seed)
        draws = found["posterior"]["state"].values.reshape(-1, *path.shape)
        ranks.append((draws[:, rows // 2] < path[rows // 2].numpy()).mean(0))
    seconds = time.process_time() - begin
    print(f"\n{simulations} simulations of two muscles: {seconds:.0f} CPU s\n")
    print("| state | mean rank | in band | p of evenness |\n|---|---|---|---|")
    for name, own in zip(model.state_names, np.transpose(ranks), strict=True):
        inside = ((own > 0.05) & (own < 0.95)).mean()
        print(f"| {name} | {own.mean():.2f} | {inside:.2f} | {kstest(own, 'uniform').pvalue:.2f} |")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=60)
    parser.add_argument("--filters", type=int, default=16)
    parser.add_argument("--simulations", type=int, default=100)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    six(arguments.rows, arguments.filters)
    two(arguments.simulations)


if __name__ == "__main__":
    main()
