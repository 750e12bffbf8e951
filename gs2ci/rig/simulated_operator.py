"""The operator of a simulated bench: carries out the manual steps that calibration requests.

Here: the operator. Not here: the one at a terminal (`gs2ci.rig.calibrating`), the world (`simulated`).
"""

from gs2ci.core.errors import InputError
from gs2ci.rig.config import WorldTable
from gs2ci.rig.simulated import SimulatedBench
from gs2ci_calibration.bench import Arrangement
from gs2ci_calibration.options import BoardSpec
from gs2ci_sims.targets import BoardPlane


class SimulatedOperator:
    """Puts things before the camera of a simulated bench.

    Args:
        bench: The bench whose world is arranged.
        table: The rig's [world].
        board: The available calibration board.
    """

    def __init__(self, bench: SimulatedBench, table: WorldTable, board: BoardSpec) -> None:
        light = bench.light
        if light is None:
            raise InputError("this simulated bench has no light to calibrate by", remedy="build it from a rig file")
        self._light = light
        self._table = table
        unit = table.scene_units_per_mm
        self._board = BoardPlane(
            board.columns, board.rows, board.square_mm * unit, board.marker_mm * unit, board.dictionary
        )

    def please(self, setup: Arrangement, index: int) -> None:
        """Set up the requested arrangement, or the one of `always` in [world] instead."""
        match Arrangement(self._table.always or setup):
            case Arrangement.DARK:
                self._light.look_at_nothing()
            case Arrangement.FLAT:
                self._light.look_at_even_light(self._table.flat_radiance)
            case Arrangement.BOARD:
                self._light.look_at_board(self._board, index)
            case Arrangement.FIXED_BOARD:
                self._light.look_at_board(self._board, index, fixed=True)
            case Arrangement.SCENE:
                self._light.look_at_scene()
