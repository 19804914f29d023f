"""Training of the heat-map network on labelled pictures: cross-entropy against Gaussian maps, AdamW, cosine decay.

    loss = − mean over labelled keypoints of Σ_cells target · log softmax(map)

Every eighth label is left for validation: errors there are reported, and confidence is calibrated on them. Step n draws
its
pictures from a generator seeded by (seed, n) alone: a run that was killed continues to the same network.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError, about
from .augment import augment
from .confidence import fit_platt, platt
from .film import Film, read_pictures
from .heatmap import MAX_SIDE, HeatmapTracker, check_pictures, normalised
from .labels import Labels
from .tracker import Keeper, Progress
from .unet import UNet, peaks, targets

VALIDATION = 8  # one label of so many
MIN_LABELS = 4  # pictures, fewer cannot be split
TARGET_SD = 0.01  # of a target's Gaussian, in the picture's longer side; at least 1.5 px
TOLERANCE = 0.02  # distance within which a point is right, in the film's longer side
SAVE_EVERY = 20  # steps
EVALUATED_AT_ONCE = 16  # pictures


@dataclass(frozen=True, eq=False)
class Examples:
    """Pictures (N, h, w, 3) uint8 of one size, points (N, P, 2) in their px, names of the keypoints.

    `factor` (N, 2) turns px of a picture into px of its film; `tolerance` is in px of the (first) film.
    """

    pictures: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]
    factor: np.ndarray
    tolerance: float


@dataclass(frozen=True)
class Trained:
    """A tracker, and its errors on n labelled keypoints left for validation; n is 0 where labels are too few.

    `errors` (n,) are in px of the film, `confidence` (n,) is a probability.
    """

    tracker: HeatmapTracker
    errors: np.ndarray
    confidence: np.ndarray


def examples(films: Sequence[Film], labels: Sequence[Labels], size: int = 288) -> Examples:
    """Labelled pictures of one film or several, their longer side `size` px.

    Raises InputError for labels that are not all of the same keypoints, not of pictures that are there, or too few.
    """
    if not 16 <= size <= MAX_SIDE:
        raise InputError(f"a network's pictures are from 16 to {MAX_SIDE} px, got {size}")
    first = films[0]
    longest = max(first.width, first.height)
    shape = max(2, round(size * first.height / longest)), max(2, round(size * first.width / longest))
    names = labels[0].names
    pictures: list[np.ndarray] = []
    points, factors = [], []
    for film, own in zip(films, labels, strict=True):
        own = own.only(names)
        own = own.chosen(np.flatnonzero(own.seen.any(-1)))
        factor = np.array([film.width / shape[1], film.height / shape[0]])
        with about(film.path):
            own.check_within(film.width, film.height)
        pictures += read_pictures(film, own.frames.tolist(), shape)
        points.append((own.points + 0.5) / factor - 0.5)
        factors.append(np.broadcast_to(factor, (len(own), 2)))
    if len(pictures) < MIN_LABELS:
        raise InputError(f"{len(pictures)} labelled pictures are too few: expected {MIN_LABELS}, and better 100")
    together = np.concatenate(points)
    if (never := ~np.isfinite(together).all(-1).any(0)).any():
        raise InputError(f"keypoint {names[int(never.argmax())]!r} is not labelled in any picture")
    return Examples(np.stack(pictures), together, names, np.concatenate(factors), TOLERANCE * longest)


def train(
    given: Examples,
    *,
    steps: int = 500,
    seed: int = 0,
    widths: Sequence[int] = (16, 24, 32, 48, 64),
    batch_size: int = 8,
    learning_rate: float = 3e-3,
    weight_decay: float = 1e-4,
    warm_up: int = 50,
    progress: Progress | None = None,
    keeper: Keeper | None = None,
) -> Trained:
    """Train a network; the same arguments give the same network, even if the run was killed and continued.

    Args:
        given: labelled pictures.
        steps: of `batch_size` pictures each.
        seed: of all that is random.
        widths: channels of the network, from the finest level to the coarsest.
        batch_size, learning_rate, weight_decay: of AdamW.
        warm_up: steps in which the learning rate rises to its value.
        progress: called as progress(done, total, what).
        keeper: where the run is saved.
    """

    def generator(step: int) -> torch.Generator:
        return torch.Generator().manual_seed(int(np.random.SeedSequence([seed, step]).generate_state(1)[0]))

    check_pictures(given.pictures.shape[1:3], widths, len(given.names))
    validation, own = _split(len(given.pictures), generator(0))
    pictures = torch.from_numpy(given.pictures)
    points = torch.from_numpy(given.points).float()
    mean = pictures[own].float().mean((0, 1, 2))
    deviation = pictures[own].float().std((0, 1, 2)).clamp(min=1.0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(np.random.SeedSequence([seed, 1 << 31]).generate_state(1)[0]))
        network = UNet(len(given.names), widths).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(network.parameters(), lr=learning_rate, weight_decay=weight_decay)
    begin = 0
    if keeper is not None and (kept := keeper.load()) is not None:
        _restore(network, optimizer, kept[0])
        begin = kept[1]["step"]
    target_sd = max(TARGET_SD * max(pictures.shape[1:3]), 1.5)
    network.train()
    for step in range(begin, steps):
        rng = generator(step + 1)
        which = own[torch.randint(len(own), (batch_size,), generator=rng)]
        batch, places = augment(pictures[which].permute(0, 3, 1, 2).float(), points[which], rng)
        maps = network(normalised(batch.permute(0, 2, 3, 1), mean.tolist(), deviation.tolist()))
        target = targets(places, (maps.shape[-2], maps.shape[-1]), target_sd)
        seen = target.flatten(2).sum(-1)
        losses = -(target * maps.flatten(2).log_softmax(-1).reshape(maps.shape)).sum((-1, -2))
        loss = losses.sum() / seen.sum().clamp(min=1.0)
        for group in optimizer.param_groups:
            group["lr"] = (
                learning_rate * min(1.0, (step + 1) / warm_up) * 0.5 * (1.02 + 0.98 * np.cos(np.pi * step / steps))
            )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if keeper is not None and (step + 1) % SAVE_EVERY == 0:
            keeper.save(_kept(network, optimizer), step=step + 1)
        if progress is not None:
            progress(step + 1, steps, f"train; loss {loss.item():.2f}")
    network.eval()
    colours = mean.tolist(), deviation.tolist()
    errors, mass = _validated(network, given, validation, colours)
    calibration = fit_platt(mass, errors < given.tolerance)
    size = (given.pictures.shape[1], given.pictures.shape[2])
    tracker = HeatmapTracker(network, given.names, size, *colours, calibration, given.tolerance, widths)
    return Trained(tracker, errors, platt(mass, *calibration))


def _split(count: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Indices for validation, and the others."""
    order = torch.randperm(count, generator=rng)
    return order[: count // VALIDATION].sort().values, order[count // VALIDATION :].sort().values


@torch.no_grad()
def _validated(
    network: UNet, given: Examples, which: Tensor, colours: tuple[list[float], list[float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n,) px of the film, and masses (n,), of all keypoints that are labelled there."""
    errors, masses = [np.empty(0)], [np.empty(0)]
    for part in which.split(EVALUATED_AT_ONCE):
        places, mass = peaks(network(normalised(torch.from_numpy(given.pictures[part.numpy()]), *colours)))
        truth, factor = given.points[part.numpy()], given.factor[part.numpy(), None]
        error = np.linalg.norm((places.double().numpy() - truth) * factor, axis=-1)
        known = np.isfinite(error)
        errors.append(error[known])
        masses.append(mass.double().numpy()[known])
    return np.concatenate(errors), np.concatenate(masses)


def _kept(network: UNet, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    for number, state in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": value for name, value in state.items()}
    return tensors


def _restore(network: UNet, optimizer: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    network.load_state_dict({k.removeprefix("network."): v for k, v in tensors.items() if k.startswith("network.")})
    states: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith("optimizer."):
            _, number, name = key.split(".")
            states.setdefault(int(number), {})[name] = value
    optimizer.load_state_dict({"state": states, "param_groups": optimizer.state_dict()["param_groups"]})
