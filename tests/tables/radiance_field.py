"""A small radiance field in front of a camera: a hash grid, two small networks, and volume rendering along rays.

Here: the frustum in which the field lives, its encoding (Müller et al., "Instant neural graphics primitives", 2022),
density and colour, samples along rays, and their compositing (Max 1995; Mildenhall et al. 2020, eq. 3). Not here: the
fit to a coded measurement (`field_fit`). It is slow, as it runs in torch on the processor: it exists for comparison.

Depth along a ray is counted as s, which runs from 0 at the near to 1 at the far plane evenly in inverse depth, so that
the same step is about the same parallax everywhere. Densities are per unit of s.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError

# Share of the image's sides by which the frustum exceeds the reference camera's view, since other cameras see more.
_MARGIN: Final = 0.25
# exp(12) per unit of s stops all light within a thousandth of a sample; more would leave float32.
_MOST_LOG_DENSITY: Final = 12.0
_PRIMES: Final = (1, 2_654_435_761, 805_459_861)
# Levels of the hash grid, entries of each of its tables at most (a power of two), and the width of both networks.
_LEVELS: Final = 8
_ENTRIES: Final = 2**16
_HIDDEN: Final = 48


@dataclass(frozen=True)
class Frustum:
    """The volume of the field: the view of the reference camera, somewhat widened, between two depths.

    Args:
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the image, px.
        nearest: Inverse depth of the near plane.
        farthest: Inverse depth of the far plane, above 0 and below `nearest`.

    Raises:
        InputError: The planes do not enclose anything.
    """

    intrinsics: F64
    size: tuple[int, int]
    nearest: float
    farthest: float

    def __post_init__(self) -> None:
        if not 0 < self.farthest < self.nearest < np.inf:
            raise InputError(
                f"a field between the inverse depths {self.farthest:g} and {self.nearest:g}",
                allowed="0 < farthest < nearest, finite",
            )

    def inverse_depths(self, along: Tensor) -> Tensor:
        """Return the inverse depths at s."""
        return self.nearest + (self.farthest - self.nearest) * along

    def inside(self, points: Tensor) -> Tensor:
        """Return where points of the reference camera's world, [P, 3], lie in the frustum, [P, 3] in [0, 1]."""
        x, y, z = points.unbind(-1)
        z = z.clamp(min=1e-6)
        height, width = self.size
        u = (self.intrinsics[0, 0] * x / z + self.intrinsics[0, 2]) / width
        v = (self.intrinsics[1, 1] * y / z + self.intrinsics[1, 2]) / height
        s = (1 / z - self.nearest) / (self.farthest - self.nearest)
        wide = torch.stack([(u + _MARGIN) / (1 + 2 * _MARGIN), (v + _MARGIN) / (1 + 2 * _MARGIN), s], dim=-1)
        return wide.clamp(0, 1)


class HashGrid(nn.Module):
    """Features on grids from coarse to fine, interpolated; if a grid is larger than its table, positions share entries.

    Args:
        coarsest: Cells of the coarsest grid along each axis.
        finest: Cells of the finest.
        levels: How many grids, their sides in a geometric progression.
        entries: Of each table at most, a power of two.
        features: At each place.
        generator: Of the first features.
    """

    cells: Tensor
    corners: Tensor

    def __init__(
        self,
        coarsest: tuple[int, int, int],
        finest: tuple[int, int, int],
        levels: int,
        entries: int,
        features: int,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.cells: Tensor
        self.corners: Tensor
        steps = np.linspace(0, 1, levels)[:, None]
        cells = np.round(np.array(coarsest) ** (1 - steps) * np.array(finest) ** steps).astype(np.int64)
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        self.register_buffer("cells", torch.from_numpy(cells))
        self.register_buffer("corners", torch.from_numpy(corners))
        self._dense = [bool(np.prod(sides + 1) <= entries) for sides in cells]
        self._entries = entries
        self.tables = nn.ParameterList(
            nn.Parameter(
                1e-4
                * (2 * torch.rand(int(np.prod(sides + 1)) if dense else entries, features, generator=generator) - 1)
            )
            for sides, dense in zip(cells, self._dense, strict=True)
        )

    @property
    def width(self) -> int:
        """Get how many features a place has over all grids."""
        return sum(int(table.shape[1]) for table in self.tables)

    def forward(self, places: Tensor) -> Tensor:
        """Interpolate the features at places in the unit cube, [P, 3] -> [P, levels · features]."""
        found = []
        for level, table in enumerate(self.tables):
            sides = self.cells[level]
            scaled = places * sides
            lowest = scaled.detach().floor().long().clamp(max=sides - 1)
            within = scaled - lowest
            sides_of = torch.stack([1 - within, within], dim=-1)  # [P, 3, 2]
            x, y, z = sides_of.unbind(1)
            share = (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).flatten(1)
            # Not embedding_bag: its gradient took 250 ms where this takes 2 (65,536 places, one thread).
            entries = table.index_select(0, self._index(lowest, level).flatten()).view(*share.shape, -1)
            found.append(torch.bmm(share[:, None], entries)[:, 0])
        return torch.cat(found, dim=1)

    def _index(self, lowest: Tensor, level: int) -> Tensor:
        """Return the table indices of the eight corners' features, [P, 8], of cells with lowest corners [P, 3]."""
        if self._dense[level]:
            _, rows, columns = (int(side) + 1 for side in self.cells[level])
            strides = (rows * columns, columns, 1)
            first = sum(lowest[:, axis] * stride for axis, stride in enumerate(strides))
            return torch.as_tensor(first)[:, None] + (self.corners * torch.tensor(strides)).sum(dim=1)
        parts = [torch.stack([lowest[:, axis], lowest[:, axis] + 1], dim=1) * _PRIMES[axis] for axis in range(3)]
        mixed = parts[0][:, :, None, None] ^ parts[1][:, None, :, None] ^ parts[2][:, None, None, :]
        return (mixed & (self._entries - 1)).flatten(1)


class RadianceField(nn.Module):
    """Density and colour at every point of a frustum; the colour also depends on direction.

    Args:
        frustum: Where.
        generator: Of all first numbers.
    """

    def __init__(self, frustum: Frustum, generator: torch.Generator) -> None:
        super().__init__()
        self.frustum = frustum
        height, width = frustum.size
        wide = 1 + 2 * _MARGIN
        finest = (max(8, round(wide * width / 1.5)), max(8, round(wide * height / 1.5)), 64)
        self.grid = HashGrid((8, 8, 8), finest, _LEVELS, _ENTRIES, 2, generator)
        self._kept = 15
        shapes = (
            ((self.grid.width, _HIDDEN), (_HIDDEN, 1 + self._kept)),
            ((self._kept + 3, _HIDDEN), (_HIDDEN, 3)),
        )
        self.body, self.shade = (
            nn.ParameterList(
                nn.Parameter(torch.randn(rows, columns, generator=generator) * (2 / rows) ** 0.5)
                for rows, columns in layers
            )
            for layers in shapes
        )

    def forward(self, points: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Return densities [P] per unit of s, and colours [P, 3] in 0 to 1.

        Args:
            points: In the reference camera's world, [P, 3].
            directions: In which they are seen, of length 1, [P, 3].
        """
        found = functional.relu(self.grid(self.frustum.inside(points)) @ self.body[0]) @ self.body[1]
        density = found[:, 0].clamp(max=_MOST_LOG_DENSITY).exp()
        shaded = functional.relu(torch.cat([found[:, 1:], directions], dim=1) @ self.shade[0]) @ self.shade[1]
        return density, torch.sigmoid(shaded)


def composite(density: Tensor, colour: Tensor, edges: Tensor) -> tuple[Tensor, Tensor]:
    """Sum the light along rays: each interval emits and absorbs uniformly, and the last one stops all light.

    Args:
        density: Of each interval, [R, S], at least 0.
        colour: Of each, [R, S, C].
        edges: Where the intervals begin and end, [R, S + 1], rising.

    Returns:
        The rays' colours, [R, C], and the share of the light that each interval sends, [R, S]; they sum to 1.
    """
    thickness = density * (edges[:, 1:] - edges[:, :-1])
    before = torch.cumsum(thickness[:, :-1], dim=1)
    reaching = torch.exp(-torch.cat([torch.zeros_like(thickness[:, :1]), before], dim=1))
    stopped = -torch.expm1(-thickness[:, :-1])
    # What passes all others is stopped by the last one: a ray ends at the far plane.
    shares = reaching * torch.cat([stopped, torch.ones_like(thickness[:, :1])], dim=1)
    return (shares[..., None] * colour).sum(dim=1), shares


def edges_along(rays: int, samples: int, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
    """Cut s into even intervals, [rays, samples + 1], and choose a place in each, [rays, samples].

    Args:
        rays: How many.
        samples: Intervals of each.
        generator: Of the places; None takes the middles.
    """
    edges = torch.linspace(0, 1, samples + 1).expand(rays, -1)
    offset = torch.full((rays, samples), 0.5) if generator is None else torch.rand(rays, samples, generator=generator)
    return edges, edges[:, :-1] + offset / samples


def cast(
    field: RadianceField,
    world_to_camera: Tensor,
    pixels: Tensor,
    samples: int,
    generator: torch.Generator | None = None,
) -> tuple[Tensor, Tensor]:
    """Render pixels.

    Args:
        field: What is seen; its world is the reference camera's.
        world_to_camera: The pose of each ray's camera, [R, 4, 4].
        pixels: Where each ray meets its image, [R, 2], x and y in px, pixel centres at +0.5.
        samples: Along each ray.
        generator: Of the samples' places, drawn within their intervals; None takes the middles.

    Returns:
        Colours [R, 3], and the inverse depth from the camera at which half of the light is stopped, [R].
    """
    frustum = field.frustum
    matrix = torch.as_tensor(frustum.intrinsics, dtype=pixels.dtype)
    across = (pixels - matrix[:2, 2]) / torch.stack([matrix[0, 0], matrix[1, 1]])
    ray = torch.cat([across, torch.ones_like(across[:, :1])], dim=1)  # advances by 1 along the optical axis
    turn, shift = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]
    ray_world = torch.einsum("rji,rj->ri", turn, ray)
    origin = -torch.einsum("rji,rj->ri", turn, shift)
    edges, along = edges_along(len(pixels), samples, generator)
    depth = 1 / frustum.inverse_depths(along)
    points = origin[:, None] + depth[..., None] * ray_world[:, None]
    directions = functional.normalize(ray_world, dim=1)[:, None].expand_as(points)
    density, colour = field(points.reshape(-1, 3), directions.reshape(-1, 3))
    seen, shares = composite(density.reshape(depth.shape), colour.reshape(*depth.shape, 3), edges)
    half = (shares.detach().cumsum(dim=1) < 0.5).sum(dim=1, keepdim=True).clamp(max=samples - 1)
    return seen, frustum.inverse_depths(along.gather(1, half))[:, 0]
