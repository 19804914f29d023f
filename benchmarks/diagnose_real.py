"""What the diagnosis says of other people's recordings, whose answer is not known.

ibm     passive swings of a toy double pendulum, the last 3 s of each; documented: its lengths, and that it has no
        motor. Masses are those of uniform rods, stated as known to 30 %. Two swings are diagnosed together, and the
        gap is measured again on two others.
human   the paper's human arm on a table, 30 frames/s, in body lengths: torques unknown.

INVDYN_DATA=… python benchmarks/diagnose_real.py [--out FOLDER]
"""

import argparse
import time
from importlib.resources import files
from pathlib import Path

import torch

from invdyn.diagnosis import Diagnosis, diagnose, save
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.inputs import load_recording
from invdyn.models import Body, Link, planar_body
from invdyn.recordings import Recording, load

ROWS, EVERY = 1200, 2  # the last 3 s, 200 rows/s: before, it whirls, and no simulation follows for long
PENDULUM = planar_body(
    "IBM's double pendulum",
    [Link("upper", "shoulder", "elbow", 0.091, 0.1), Link("lower", "elbow", "wrist", 0.070, 0.08)],
    gravity=(0.0, -9.81),
    uncertainty={"length": 0.01, "mass": 0.3, "com": 0.2, "inertia": 0.3},
)


def swing(number: int) -> Recording:
    """The end of a swing."""
    return load(f"ibm-{number}").at(slice(-ROWS, None, EVERY))


def ibm() -> Diagnosis:
    return diagnose([swing(0), swing(3)], PENDULUM, held_out=[swing(5), swing(7)], passive=True)


def human() -> Diagnosis:
    body = Body.from_toml(files("invdyn.models") / "bodies" / "human_arm_on_table.toml")
    recording = load_recording("human-arm", body, scale="body").select(50, 250)
    return diagnose(recording, body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=("ibm", "human"))
    parser.add_argument("--out", type=Path, help="keep the reports there")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for name, run in {"ibm": ibm, "human": human}.items():
        if arguments.only not in (None, name):
            continue
        start = time.perf_counter()
        found = run()
        print(f"\n{name}, {time.perf_counter() - start:.0f} s\n{verdict(found)}")
        print("\n".join(details(found)))
        for cause in found.causes[:5]:
            words = " + ".join(f.key for f in cause.effects) or "no gap"
            print(f"  P {cause.probability:.3f}, in part {cause.in_part:.3f}  {words}")
            for each in cause.effects:
                for key, p in each.parameters.items():
                    print(f"      {each.key}.{key} {p.mean:.4g} ± {p.sd:.2g} {p.unit}")
        gap, closed = found.gap, found.shrinkage
        print(f"  nats a frame {gap.elpd_per_frame}; closed {closed.gap_closed} {closed.interval_90}")
        print(f"  residual N·m {gap.residual_torque_rms} → {closed.residual_torque_rms_after}")
        print(f"  replay m {gap.replay_rms_m}")
        print(f"  could not be seen: {', '.join(found.not_identifiable) or 'nothing'}")
        if arguments.out:
            (arguments.out / name).mkdir(parents=True, exist_ok=True)
            save(found, arguments.out / name)


if __name__ == "__main__":
    main()
