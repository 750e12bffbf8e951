"""A camera path from above as SVG: the recovered one, and the true one and the stage's if they are known.

Here: bringing the paths together and onto the page. Not here: the alignment (`gs2ci.evaluate.trajectory`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from gs2ci.core.arrays import F64
from gs2ci.evaluate.pages.charts import Colour
from gs2ci.evaluate.pages.frame import environment
from gs2ci.evaluate.trajectory import align
from gs2ci.evaluate.wording import describe_number

# With more symbols than this, they overlap.
MOST_WEDGES: Final = 12
# A camera's wedge, as a share of the larger side of the paths' extent.
WEDGE: Final = 0.09
LEAST_HEIGHT, MOST_HEIGHT = 190, 420
EDGE: Final = 26
FOOT: Final = 40
# If the lateral motion is less than this share of the path's length, the camera moves forward; the page's sideways
# direction is then the camera's own x axis.
LATERAL_SHARE: Final = 0.2


@dataclass(frozen=True)
class Paths:
    """World-to-camera poses, [N, 4, 4] each, in frames and units of their own; None if not known."""

    recovered: F64
    true: F64 | None = None
    stage: F64 | None = None

    def together(self) -> dict[str, F64]:
        """Align the paths in one frame, the true one's or the stage's; return camera-to-world, [N, 4, 4], by name."""
        name, reference = next(
            (name, poses)
            for name, poses in (("true", self.true), ("stage", self.stage), ("recovered", self.recovered))
            if poses is not None
        )
        found = {}
        for other in ("true", "stage", "recovered"):
            poses = getattr(self, other)
            if poses is not None:
                aligned = poses if other == name else align(poses, reference).apply(poses)
                found[other] = np.asarray(np.linalg.inv(aligned), np.float64)
        return found


def path_svg(paths: Paths, width: int, *, unit: str, shown: Sequence[int] = ()) -> Markup:
    """Draw paths from above, the cameras looking up the page.

    Args:
        paths: The paths.
        width: Width of the drawing, CSS pixels.
        unit: Unit of lengths in the common frame.
        shown: Indices of the views that the page shows, in its order: their cameras are marked as these are stepped
            through.
    """
    together = paths.together()
    reference = next(iter(together.values()))
    axes = seen_from_above(reference)
    origin = reference[:, :3, 3].mean(0)
    spots = {name: (poses[:, :3, 3] - origin) @ axes for name, poses in together.items()}
    every = np.concatenate(list(spots.values()))
    extent = max(float(np.ptp(every, axis=0).max()), 1e-12)
    size = WEDGE * extent
    low, high = every.min(0) - np.array([size, 0.4 * size]), every.max(0) + np.array([size, 1.3 * size])
    scale = (width - 2 * EDGE) / (high[0] - low[0])
    height = int(np.clip(scale * (high[1] - low[1]) + EDGE + FOOT, LEAST_HEIGHT, MOST_HEIGHT))
    scale = min(scale, (height - EDGE - FOOT) / (high[1] - low[1]))
    middle, place = (low + high) / 2, np.array([width / 2, (EDGE + height - FOOT) / 2])

    def on_page(points: F64) -> F64:
        return np.asarray(np.round(place + (points - middle) * (scale, -scale), 2), np.float64)

    drawn = [
        _drawn(name, on_page(spots[name]), shown, _wedges(poses, spots[name], axes, size, on_page))
        for name, poses in together.items()
    ]
    bar = _ruler(extent)
    return (
        environment()
        .get_template("charts.html")
        .module.path(  # type: ignore[attr-defined]
            alt=f"Camera path from above: {', '.join(together)}",
            width=width,
            height=height,
            paths=drawn,
            scale=(round(scale * bar, 2), f"{describe_number(bar)} {unit}"),
        )
    )


def path_colour(name: str) -> Colour:
    """Get the colour of a path by its name."""
    colours: dict[str, Colour] = {"recovered": "accent", "true": "truth", "stage": "third"}
    return colours[name]


def _drawn(name: str, spots: F64, shown: Sequence[int], wedges: list[str]) -> dict[str, Any]:
    recovered = name == "recovered"
    places = {index: place for place, index in enumerate(shown)} if recovered else {}
    ends = sorted({0, len(spots) - 1}) if recovered else []
    return {
        "colour": path_colour(name),
        "broad": name == "true",
        "dashed": name == "stage",
        "line": "M" + "L".join(f"{x:g},{y:g}" for x, y in spots) if len(spots) > 1 else "",
        "dots": [
            (float(x), float(y), places.get(index), f"{name}, view {index + 1}") for index, (x, y) in enumerate(spots)
        ],
        "radius": 4 if recovered else 6,
        "wedges": wedges if name != "stage" else [],
        "names": [(float(spots[i, 0]), float(spots[i, 1]) + 18, str(i + 1)) for i in ends],
    }


def _wedges(poses: F64, spots: F64, axes: F64, size: float, on_page: Any) -> list[str]:
    """Draw some cameras' views, spread along their own x axes."""
    shown = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), MOST_WEDGES)).round().astype(int))
    drawn = []
    for index in shown:
        right, forward = poses[index, :3, 0] @ axes, poses[index, :3, 2] @ axes
        corners = [spots[index], *(spots[index] + size * (forward + side * right) for side in (-0.5, 0.5))]
        drawn.append("M" + "L".join(f"{x:g},{y:g}" for x, y in on_page(np.array(corners))))
    return drawn


def _ruler(extent: float) -> float:
    """Choose a round length of about a quarter of the extent."""
    power = 10 ** float(np.floor(np.log10(extent / 4)))
    return max(m * power for m in (1.0, 2.0, 5.0) if m * power <= extent / 4)


def seen_from_above(camera_to_world: F64) -> F64:
    """Choose the page for a path [N, 4, 4]: [3, 2], along the sideways move and along the mean viewing direction."""
    centers = camera_to_world[:, :3, 3] - camera_to_world[:, :3, 3].mean(0)
    forward = _unit(camera_to_world[:, :3, 2].mean(0), fallback=camera_to_world[0, :3, 2])
    across = camera_to_world[:, :3, 0].mean(0)
    right = _unit(across - forward * (across @ forward), fallback=camera_to_world[0, :3, 0])
    sideways = centers - np.outer(centers @ forward, forward)
    _, spread, axes = np.linalg.svd(sideways, full_matrices=False)
    if spread[0] > LATERAL_SHARE * np.linalg.norm(centers):
        # The direction of the motion, oriented towards the camera's right.
        right = axes[0] if axes[0] @ right >= 0 else -axes[0]
    return np.stack([right, forward], axis=1)


def _unit(vector: F64, fallback: F64) -> F64:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else fallback / np.linalg.norm(fallback)
