"""How sure a reconstruction is of its views, depths and poses, as plain arrays.

Here: the record and its check. Not here: how it is found (`gs2ci.reconstruct.uncertainty`), files.
"""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, NumericsError


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard errors: about 68 % of the errors lie within one, about 95 % within two.

    Args:
        views: Of each value of the views, full scale 1, [N, H, W] float32.
        depth: Of each depth, in the unit of the path, [N, H, W] float32, 0 where there is no depth; None without a
            path, or if things move. If the unit is the scene's own, its scale counts as known.
        positions: Of each camera's place, in the unit of the path, beyond what no image determines, [N]; None likewise.
        rotations: Of each camera's orientation against the others, rad, [N]; None likewise.
    """

    views: F32
    depth: F32 | None = None
    positions: F64 | None = None
    rotations: F64 | None = None

    def check(self, shape: tuple[int, int, int]) -> "Uncertainty":
        """Return self if all parts are of a result of this shape, [N, H, W], and neither negative nor not finite.

        Raises:
            InputError: A shape differs.
            NumericsError: An array holds NaN, infinity or a negative number.
        """
        for name, array in vars(self).items():
            wanted = shape[:1] if name in ("positions", "rotations") else shape
            if array is None:
                continue
            if array.shape != wanted:
                raise InputError(f"standard errors of {name} have shape {list(array.shape)}", allowed=str(list(wanted)))
            if not all((np.isfinite(part) & (part >= 0)).all() for part in array):
                raise NumericsError(
                    f"standard errors of {name} hold NaN, infinity or a negative number",
                    allowed="finite numbers from 0 on",
                    remedy="report this run with its shot file",
                )
        return self
