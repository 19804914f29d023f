"""A tracker trained on a user's own labels: U-Net, its normalisation, and the calibration of its confidence.

The file is safetensors: arrays and one text, from which nothing can be run.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import torch

from ..atomic import atomic_path
from ..errors import InputError, first_line
from ..limits import LIMITS
from ..paths import check_readable
from .confidence import platt
from .unet import UNet, activations, peaks

SCHEMA = 1  # of the file
MAX_SIDE = 4096  # px of the pictures


class HeatmapTracker:
    """See `tracker.Tracker`; pictures do not depend on one another.

    Args:
        network: in evaluation mode.
        keypoint_names: of its P maps.
        picture_size: (height, width) that it was trained in.
        mean, deviation: (3,) of the training pictures' colours, from 0 to 255.
        calibration: a and b of `confidence.platt`.
        tolerance: px of the film, within which a point lies with the confidence's probability; for people to read.
        widths: channels of the network.
    """

    def __init__(
        self,
        network: UNet,
        keypoint_names: Sequence[str],
        picture_size: tuple[int, int],
        mean: Sequence[float],
        deviation: Sequence[float],
        calibration: tuple[float, float] = (1.0, 0.0),
        tolerance: float = 0.0,
        widths: Sequence[int] = (),
    ):
        self.network = network.eval()
        self.keypoint_names: tuple[str, ...] = tuple(keypoint_names)
        self.picture_size = picture_size
        self.mean, self.deviation = tuple(mean), tuple(deviation)
        self.calibration, self.tolerance, self.widths = calibration, tolerance, tuple(widths)
        self.memory = np.empty(0)

    def track(self, picture: np.ndarray) -> np.ndarray:
        """RGB (H, W, 3) uint8 to (P, 3)."""
        return self.track_all(picture[None])[0]

    @torch.no_grad()
    def track_all(self, pictures: np.ndarray) -> np.ndarray:
        """RGB (N, H, W, 3) uint8 to (N, P, 3)."""
        places, mass = peaks(self.network(normalised(torch.from_numpy(pictures), self.mean, self.deviation)))
        confidence = platt(mass.double().numpy(), *self.calibration)
        return np.concatenate([places.double().numpy(), confidence[..., None]], -1)

    def save(self, path: str | Path) -> None:
        """Write the network, whole or not at all. Raises OSError when `path` cannot be written."""
        described = {
            "schema": SCHEMA,
            "keypoint_names": self.keypoint_names,
            "picture_size": self.picture_size,
            "mean": self.mean,
            "deviation": self.deviation,
            "calibration": self.calibration,
            "tolerance": self.tolerance,
            "widths": self.widths,
        }
        tensors = {name: value.contiguous() for name, value in self.network.state_dict().items()}
        content = import_safetensors().save(tensors, {"invdyn": json.dumps(described)})
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)

    @staticmethod
    def load(path: str | Path) -> "HeatmapTracker":
        """Read what `save` wrote.

        Raises:
            InputError: another file, or safetensors is missing.
            OSError: a file that cannot be opened.
        """
        tensors, text = read_safetensors(path)
        try:
            described = json.loads(text)
            if described["schema"] != SCHEMA:
                raise InputError(f"this network has schema {described['schema']}, expected {SCHEMA}")
            names, widths = described["keypoint_names"], described["widths"]
            if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
                raise ValueError("names of keypoints are texts, each once")
            if min(widths) < 1:
                raise ValueError(f"{min(widths)} channels")
            with torch.device("meta"):  # the file's own tensors alone take memory
                network = UNet(len(names), widths)
            network.load_state_dict(tensors, assign=True)
            network.float()
            (*mean,), (*deviation,), (a, b) = (map(float, described[k]) for k in ("mean", "deviation", "calibration"))
            height, width = map(int, described["picture_size"])
            if len(mean) != 3 or len(deviation) != 3 or not 1 <= min(height, width) <= max(height, width) <= MAX_SIDE:
                raise ValueError(f"pictures of {height} × {width} px in {len(mean)} colours")
            tolerance = float(described["tolerance"])
            if not np.isfinite([*mean, *deviation, a, b, tolerance]).all() or min(deviation) <= 0 or a < 0:
                raise ValueError("colours, calibration and tolerance are finite, deviations positive")
            if not all(torch.isfinite(each).all() for each in network.state_dict().values()):
                raise ValueError("weights are finite")
            check_pictures((height, width), widths, len(names))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except (ValueError, KeyError, TypeError, RuntimeError, IndexError, OverflowError) as error:
            raise InputError(f"{path}: not a network of `invdyn train` ({first_line(error)})") from None
        return HeatmapTracker(network, names, (height, width), mean, deviation, (a, b), tolerance, widths)


def check_pictures(size: Sequence[int], widths: Sequence[int], keypoints: int) -> None:
    """Raise InputError for pictures of (height, width) px for which the network needs more memory than it may."""
    if (needed := activations(size, widths, keypoints)) > LIMITS.memory:
        raise InputError(
            f"pictures of {size[0]} × {size[1]} px take a network of {len(widths)} levels {needed / 2**30:.3g} GiB, "
            f"expected at most {LIMITS.memory / 2**30:g}: train it on smaller ones"
        )


def normalised(pictures: torch.Tensor, mean: Sequence[float], deviation: Sequence[float]) -> torch.Tensor:
    """(N, H, W, 3) of 0 … 255 to (N, 3, H, W) about zero, channels last in memory as convolutions prefer."""
    scaled = (pictures.float() - torch.tensor(mean)) / torch.tensor(deviation)
    return scaled.permute(0, 3, 1, 2).contiguous(memory_format=torch.channels_last)


def read_safetensors(path: str | Path) -> tuple[dict[str, torch.Tensor], str]:
    """Tensors of a file, and its text `invdyn`. Raises InputError for another file, OSError for none."""
    safetensors = import_safetensors()
    check_readable(path)
    try:
        from safetensors import safe_open

        with safe_open(path, "pt") as file:
            return safetensors.load_file(path), (file.metadata() or {})["invdyn"]
    except OSError:
        raise
    except Exception as error:  # safetensors raises a class of its own
        raise InputError(f"{path}: not a network of `invdyn train` ({first_line(error)})") from None


def import_safetensors() -> ModuleType:
    """Safetensors for torch. Raises InputError when it is not installed."""
    try:
        import safetensors.torch
    except ImportError:
        raise InputError("networks need one more package: pip install 'invdyn[tracking]'") from None
    return safetensors.torch
