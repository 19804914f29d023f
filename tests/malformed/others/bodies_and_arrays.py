"""Robots' files, networks of a tracker and HDF5 files that declare or include much."""

import json
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

from .kit import BOMB, ODD, READ, hostile

MJCF = '<mujoco>{}<worldbody><body name="a"><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>'


@hostile(BOMB, reader="body")
def many_includes(folder, rng):
    count = rng.randint(20, 190)
    for k in range(count):
        padding = f"<custom>{' ' * 2**20}</custom>" if rng.random() < 0.5 else "<custom/>" * 50_000
        (folder / f"p{k}.xml").write_text(f"<mujocoinclude>{padding}</mujocoinclude>")
    (folder / "arm.xml").write_text(MJCF.format("".join(f'<include file="p{k}.xml"/>' for k in range(count))))
    return folder / "arm.xml"


@hostile(BOMB, reader="body", element=('<geom size=".1"/>', "<site/>", "<body/>"))
def many_elements(folder, rng, element):
    (folder / "arm.xml").write_text(
        f"<mujoco><worldbody>{element * rng.randint(50_001, 2**23 // len(element))}</worldbody></mujoco>"
    )
    return folder / "arm.xml"


@lru_cache
def _network(widths: tuple[int, ...]) -> tuple[dict, dict]:
    import tempfile

    from invdyn.recordings.tracking.heatmap import HeatmapTracker, read_safetensors
    from invdyn.recordings.tracking.unet import UNet

    with tempfile.NamedTemporaryFile() as file:
        HeatmapTracker(UNet(2, widths), ("a", "b"), (20, 20), [9.0] * 3, [9.0] * 3, widths=widths).save(file.name)
        tensors, described = read_safetensors(file.name)
    return tensors, json.loads(described)


def network(folder: Path, widths: tuple[int, ...] = (16, 24, 32, 48, 64), **claims: object) -> Path:
    """A network whose text says something else."""
    from safetensors.torch import save

    tensors, described = _network(widths)
    (folder / "n.safetensors").write_bytes(save(tensors, {"invdyn": json.dumps(described | claims)}))
    return folder / "n.safetensors"


@hostile(BOMB, reader="network")
def large_pictures(folder, rng):
    return network(folder, picture_size=[rng.randint(3000, 4096), rng.randint(3000, 4096)])


@hostile(BOMB, reader="network")
def wide_networks(folder, rng):
    return network(folder, (rng.choice([300, 600]),), picture_size=[rng.randint(1500, 4096)] * 2)


@hostile(ODD, reader="network", key=("calibration", "mean", "deviation", "tolerance"))
def a_network_of_no_numbers(folder, rng, key):
    wrong = rng.choice([float("nan"), float("inf"), -float("inf")])
    return network(folder, (8,), **{key: {"calibration": [1.0, wrong], "tolerance": wrong}.get(key, [9.0, wrong, 9.0])})


def pose(folder: Path) -> Path:
    """DeepLabCut's table in HDF5."""
    with h5py.File(folder / "rec.h5", "w") as store:
        group = store.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["nblocks"] = np.bytes_("frame"), 1
        for axis in ("axis0", "block0_items"):
            group.attrs[f"{axis}_variety"], group.attrs[f"{axis}_nlevels"] = np.bytes_("multi"), 3
            for level, names in enumerate(([b"net"], [b"wrist"], [b"x", b"y", b"likelihood"])):
                group[f"{axis}_level{level}"] = np.array(names)
                group[f"{axis}_label{level}"] = np.arange(3) if level == 2 else np.zeros(3, int)
        group["axis1"], group["block0_values"] = np.arange(6), np.ones((3, 6))
    return folder / "rec.h5"


@hostile(BOMB, reader="recording", must=READ)
def a_pose_table(folder, rng):
    return pose(folder)


@hostile(BOMB, reader="recording", how=("declared", "chunk", "external", "link", "virtual"))
def a_pose_table_beyond_its_file(folder, rng, how):
    path, rows = pose(folder), 2 ** rng.randint(27, 40)
    (folder / "secret").write_bytes(np.ones(18).tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["values"] = np.ones((3, 6))
    with h5py.File(path, "a") as store:
        group = store["df_with_missing"]
        del group["block0_values"]
        if how == "declared":
            group.create_dataset("block0_values", (3, rows), "f8", chunks=(3, 1000))
        elif how == "chunk":
            size = 2 ** rng.randint(25, 28)
            group.create_dataset("block0_values", (3, 6), "f8", chunks=(3, size), maxshape=(3, None))
        elif how == "external":
            group.create_dataset("block0_values", (3, 6), "f8", external=[(str(folder / "secret"), 0, 144)])
        elif how == "link":
            group["block0_values"] = h5py.ExternalLink(str(folder / "other.h5"), "/values")
        else:
            layout = h5py.VirtualLayout((3, 6), "f8")
            layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "values", (3, 6))
            group.create_virtual_dataset("block0_values", layout)
    return path


@hostile(BOMB, reader="posterior")
def a_posterior_that_declares_much(folder, rng):
    with h5py.File(folder / "p.nc", "w") as store:
        rows = 2 ** rng.randint(27, 40)
        store.create_dataset("posterior/torque", (rows,), "f8", chunks=(1000,), compression="gzip")
    return folder / "p.nc"
