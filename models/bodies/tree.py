"""Bodies in space: trees of rigid links, each scalar of them a number, a prior or a learned parameter.

A link hangs on its parent, or on the world, by a joint (`joints.py`). The joint's frame lies at `origin` m, turned by
`rotation`, in the parent's frame; the link's own frame is the joint's, moved. In it lie the centre of mass `com` m, the
`inertia` kg·m² about that (xx, yy, zz, xy, xz, yz) and `sites`, named points, m, that keypoints show.

A link may have a `length` m instead: it is a stick along its x axis, whose `tip` is a site. Unless they say otherwise,
links on it are placed at its tip, its com is in its middle and its inertia that of a thin rod.

The base is what the first joint makes of it: fixed where the link's joint is any on the world, free by a joint of type
free, moved by one that is `driven`. Files: `tree_toml.py`, `body_mjcf.py`, `body_urdf.py`; tables of Denavit and
Hartenberg: `dh.py`.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pyro
import pyro.distributions as dist
import torch
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.bodies import body_tree, joint_parts_toml, tree_toml
from invdyn.models.bodies.from_files import FromFiles
from invdyn.models.bodies.inertia import NAMES, check_inertia, tensor
from invdyn.models.bodies.joint_parts import JointParts, relative
from invdyn.models.bodies.joints import WORLD, Joint, Motion
from invdyn.models.bodies.placeholders import Moment
from invdyn.models.bodies.protocol import BodyBase, Numbers, kept_as
from invdyn.models.bodies.rotations import about, numbers
from invdyn.models.bodies.scalars import BodyError, Learned, Scalar, check_name, nominal, prior
from invdyn.models.bodies.spatial_link import SpatialLink, ordered
from invdyn.models.bodies.sticks import Sticks
from invdyn.models.bodies.tree_parameters import TreeParameters, assembled, moments


@dataclass(frozen=True)
class Tree(FromFiles, BodyBase):
    """A tree of links; `gravity` m/s² in the world's frame, z up unless it says otherwise.

    `uncertainty` has relative sds of all masses, and of joints' parts by quantity or of one joint: "mass", "damping",
    "damping.elbow".

    Links are kept with parents before children, else in the order given; `joint_names` are its coordinates, K of them
    not driven. Raises `BodyError` for no links or no coordinates, unknown parents, a cycle, names used twice, and
    inertia tensors that break the triangle inequality where that plays a part.
    """

    name: str
    links: Sequence[SpatialLink]
    gravity: Sequence[float] = (0.0, 0.0, -9.81)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    space: ClassVar[int] = 3
    signed: ClassVar[frozenset[str]] = frozenset({"com", "inertia", "position", "rotation", "sites", "gravity"})

    def __post_init__(self) -> None:
        check_name(self.name, "name of a body")
        where = f"body '{self.name}'"
        gravity = numbers(self.gravity, 3, f"{where}: gravity in m/s² (in space)")
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        if not self.links:
            raise BodyError(f"{where}: expected at least one link, got none")
        kinds = {
            "link": [link.name for link in self.links],
            "joint": [link.joint.name for link in self.links],
            "site": [site for link in self.links for site in (*link.sites, *([link.tip] if link.tip else []))],
        }
        for kind, names in kinds.items():
            for name in names:
                if names.count(name) > 1:
                    raise BodyError(f"{where}: expected names of their own for all {kind}s, got '{name}' twice")
        object.__setattr__(self, "links", ordered(self.links, where))
        object.__setattr__(self, "uncertainty", relative(self.uncertainty, ("mass",), self.joint_names, where))
        if not self.num_joints:
            raise BodyError(f"{where}: expected a joint that moves, got only fixed or driven ones")
        for link, turning in zip(self.links, self.turning(), strict=True):
            own = moments(link, nominal(link.mass), None if link.length is None else nominal(link.length))
            check_inertia(tensor(np.array([nominal(x) for x in own])), turning, f"{where}: link '{link.name}'")

    @property
    def num_joints(self) -> int:
        """Number K of coordinates that torques move."""
        return len(self.joint_names)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links, parents before children."""
        return tuple(link.name for link in self.links)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the K coordinates: the joint's, with _yaw, _pitch, _roll, _x, _y or _z where it has several."""
        return tuple(motion.name for link, motion in self.motions() if not link.joint.driven)

    @cached_property
    def joint_parts(self) -> tuple[JointParts | None, ...]:
        """What each of the K coordinates has besides."""
        return tuple(link.parts for link, _ in self.motions() if not link.joint.driven)

    @cached_property
    def driven_names(self) -> tuple[str, ...]:
        """Names of the coordinates of driven joints, whose motion is given."""
        return tuple(motion.name for link, motion in self.motions() if link.joint.driven)

    @cached_property
    def keypoint_names(self) -> tuple[str, ...]:
        """Names of the S sites, a link's tip first, from the first link on."""
        return tuple(site for link in self.links for site in link.points)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The place of each link's parent among the links, −1 for the world."""
        places = {WORLD: -1} | {link.name: place for place, link in enumerate(self.links)}
        return tuple(places[link.parent] for link in self.links)

    def motions(self) -> list[tuple[SpatialLink, Motion]]:
        """All coordinates, driven ones too, with the link that each belongs to."""
        return [(link, motion) for link in self.links for motion in link.joint.motions()]

    def parameters(
        self, dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> TreeParameters:
        """Return the `TreeParameters` at the nominal values: priors at their means, learned ones at their starts."""

        def draw(value: Scalar, site: str) -> Tensor:
            return torch.tensor(nominal(value), dtype=dtype, device=device)

        return assembled(self.links, self.parents, self.gravity, draw)

    def sample(
        self, prefix: str = "", dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> TreeParameters:
        """Return `TreeParameters`: priors by `pyro.sample`, learned scalars by `pyro.param`.

        Pyro's sites are called prefix + "upper_arm.mass", "upper_arm.com_x", "upper_arm.inertia_xx",
        "upper_arm.origin_x", "upper_arm.length", and "upper_arm.wrist_x" for a site called wrist. In a plate, what is
        sampled gains its dimensions.
        """

        def draw(value: Scalar, site: str) -> Tensor:
            if isinstance(value, dist.Distribution):
                return pyro.sample(prefix + site, value).to(dtype=dtype, device=device)
            number = torch.tensor(nominal(value), dtype=dtype, device=device)
            if not isinstance(value, Learned):
                return number
            positive = site.rpartition(".")[2] in ("mass", "length", *(f"inertia_{name}" for name in NAMES[:3]))
            return pyro.param(prefix + site, number, constraint=constraints.positive if positive else constraints.real)

        return assembled(self.links, self.parents, self.gravity, draw)

    @property
    def hand(self) -> tuple[int, int] | None:
        """The last link, or of several that end the tree what they hang on, and the site farthest from its joint.

        None where that is the world, or has no site.
        """
        ends = [k for k in range(len(self.links)) if k not in self.parents]
        inwards = [[end] for end in ends]
        for way in inwards:
            while self.parents[way[-1]] >= 0:
                way.append(self.parents[way[-1]])
        common = [k for k in inwards[0] if all(k in way for way in inwards)]
        own = [self.keypoint_names.index(name) for name in self.links[common[0]].points] if common else []
        if not own:
            return None
        far = self.parameters().sites[own].norm(dim=-1)
        return common[0], own[int(far.argmax())]

    def moved_by(self, link: int) -> tuple[int, ...]:
        """Coordinates of its joint, or, where that is fixed or driven, of the next one inwards."""
        owners = [self.links.index(each) for each, _ in self.motions() if not each.joint.driven]
        while link >= 0:
            if found := tuple(k for k, owner in enumerate(owners) if owner == link):
                return found
            link = self.parents[link]
        return ()

    @property
    def has_priors(self) -> bool:
        """Whether any scalar is a prior rather than a number."""
        return any(isinstance(scalar, dist.Distribution) for _, _, scalar in self.scalars())

    def with_uncertainty(self) -> Self:
        """The tree with masses that are numbers made priors, of the relative sd that it states; joints' parts stay.

        A link without a mass stays so, and moments of inertia that are numbers stay as they are.
        """
        sd = self.uncertainty.get("mass", 0.0)
        rest = {key: value for key, value in self.uncertainty.items() if key != "mass"}

        def freed(link: SpatialLink) -> SpatialLink:
            if isinstance(link.mass, float) and sd * link.mass > 0:
                return replace(link, mass=prior(link.mass, sd * link.mass))
            return link

        return replace(self, links=tuple(map(freed, self.links)), uncertainty=rest)

    @property
    def learned(self) -> dict[str, tuple[int, ...]]:
        """Entries to be learned, as flat indices by number; a stick's length is its tip's x among the sites."""
        return self._entries(Learned)

    def completed(self, numbers: TreeParameters) -> TreeParameters:
        """The numbers with what sticks leave out following their lengths, which their tips show, and masses."""
        return self._sticks.completed(numbers)

    def described(self, numbers: Numbers) -> dict[str, tuple[list[str], Tensor]]:
        """By link, site and axis; joints' positions as "origin". And `base`, where that stands still; `skeleton`."""
        dims = {
            "mass": ["link"],
            "com": ["link", "space"],
            "inertia": ["link", "moment"],
            "origin": ["link", "space"],
            "rotation": ["link", "space", "space_2"],
            "sites": ["keypoint", "space"],
            "gravity": ["space"],
        }
        own = {kept_as(name): value.detach() for name, value in numbers._asdict().items()}
        found = {name: (dims[name], value) for name, value in own.items()}
        turns = [motion.turns for link, motion in self.motions() if not link.joint.driven]
        found["turns"] = ["joint"], torch.tensor(turns).int()
        if self._stands:
            found["base"] = ["space"], own["origin"][..., 0, :]
        edges = self.skeleton
        return found | ({"skeleton": (["edge", "end"], torch.tensor(edges))} if edges else {})

    def drawn(self, numbers: TreeParameters) -> dict[str, Tensor]:
        """Entries that are priors or learned, by `sample`; plain ones of the same number stand as in ``numbers``."""
        like: dict[str, Any] = {"dtype": numbers.mass.dtype, "device": numbers.mass.device}
        sampled, found = self.sample(**like)._asdict(), {}
        for key, entries in self._entries(dist.Distribution | Learned).items():
            given, shape = getattr(numbers, key), self._shapes[key]
            which = torch.zeros(shape, dtype=torch.bool).reshape(-1)
            which[list(entries)] = True
            found[key] = torch.where(which.reshape(shape).to(given.device), sampled[key], given)
        return found

    @property
    def _stands(self) -> bool:
        """Whether the first joint is at a place that does not move."""
        root = self.links[0].joint
        return not root.driven and all(motion.turns for motion in root.motions())

    @property
    def skeleton(self) -> list[tuple[int, int]]:
        """Pairs of sites that a line joins in a picture, −1 the base: each with that, further in, next to its joint."""
        p, names = self.parameters(), self.keypoint_names
        hubs: list[int | None] = []
        edges = []
        for place, (link, parent) in enumerate(zip(self.links, self.parents, strict=True)):
            hub = (-1 if self._stands else None) if parent < 0 else hubs[parent]
            if parent >= 0 and (near := [names.index(name) for name in self.links[parent].points]):
                hub = near[int((p.sites[near] - p.position[place]).norm(dim=-1).argmin())]
            hubs.append(hub)
            edges += [(hub, names.index(name)) for name in link.points if hub is not None]
        return edges

    def scalars(self) -> Iterator[tuple[str, int, Scalar]]:
        """What links say: its number, its flat index there, and itself; a length is its tip's x among the sites."""
        for place, link in enumerate(self.links):
            yield "mass", place, link.mass
            for key, given in (("position", link.origin), ("com", link.com), ("inertia", link.inertia)):
                values = given or ()
                yield from ((key, place * len(values) + i, value) for i, value in enumerate(values))
            for site, at in link.points.items():
                first = 3 * self.keypoint_names.index(site)
                yield from (("sites", first + i, value) for i, value in enumerate(at or [link.length]))

    def _entries(self, kind: Any) -> dict[str, tuple[int, ...]]:
        """Flat indices of the scalars of a kind, by number."""
        found: dict[str, list[int]] = {}
        for key, index, scalar in self.scalars():
            if isinstance(scalar, kind):
                found.setdefault(key, []).append(index)
        return {key: tuple(indices) for key, indices in found.items()}

    @cached_property
    def _sticks(self) -> Sticks:
        return Sticks(self.links, self.parents, self.keypoint_names)

    @cached_property
    def _shapes(self) -> dict[str, torch.Size]:
        return {key: value.shape for key, value in self.parameters()._asdict().items()}

    def turning(self) -> list[np.ndarray]:
        """For each link, directions in its own frame that its angular velocity may have, (n, 3).

        Each turn further out is set to an angle that is nothing special, so that no two axes are parallel by chance.
        """
        found: list[np.ndarray] = []
        for link, parent in zip(self.links, self.parents, strict=True):
            inner = found[parent] if parent >= 0 else np.zeros((0, 3))
            directions = inner @ np.array(link.rotation)
            for place, motion in enumerate(link.joint.motions()):
                if motion.turns:
                    directions = directions @ about(motion.axis, 0.7 + place)
                    directions = np.concatenate([directions, motion.axis[None]])
            found.append(directions @ np.array(link.joint.reference))
        return found

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a body file in space. Raises `BodyError`, which names the file, or `OSError` if it cannot be read."""
        return cls.from_tables(tree_toml.read(path), path)

    @classmethod
    def from_tables(cls, tables: dict, path: str | Path) -> Self:
        """The tree of a TOML file's tables; see `from_toml`."""
        return cls._of({"name": Path(path).stem, **tree_toml.of(tables, path)}, path)

    @staticmethod
    def link_of(table: dict) -> SpatialLink:
        """A link and its joint, of a table."""
        return SpatialLink(**table | {"joint": Joint(**table["joint"])})

    tables_of = staticmethod(body_tree.tables)

    def largest_moments(self) -> Iterator[Moment]:
        """Of each link that states them, the largest about an axis through its centre of mass."""
        for link in self.links:
            if link.inertia is not None:
                ends = [link.com, *link.sites.values(), *(o.origin for o in self.links if o.parent == link.name)]
                far = [math.hypot(*map(nominal, end)) for end in ends if end is not None]
                length = 0.0 if link.length is None else nominal(link.length)
                yield Moment(link.name, max(map(nominal, link.inertia[:3])), nominal(link.mass), max([length, *far]))

    def to_toml(self, path: str | Path) -> None:
        """Write a body file that `from_toml` reads back.

        Raises `BodyError` for priors that no file can express (all but log-normal), `OSError` for no place.
        """
        links = [
            {key.name: getattr(link, key.name) for key in fields(link) if key.name != "parts"}
            | joint_parts_toml.told(link.parts)
            | {"joint": {key.name: getattr(link.joint, key.name) for key in fields(link.joint)}}
            for link in self.links
        ]
        tree_toml.write(path, self.name, self.gravity, links, self.uncertainty)
