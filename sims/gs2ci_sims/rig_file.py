"""Rig files: what is simulated, and how exactly, as TOML.

    seed = 0                      # of masks and all draws
    [scene]     name = "corridor" # what is seen, and how many pixels see it
    [path]      parallax_px = 6.0 # how the camera moves
    [light] [optics] [modulator] [timing] [sensor]   # figures of the parts: `gs2ci_sims.rig`, `gs2ci_sims.sensor`
    [effects.defocus]             # imperfections that the rig has; a table that is not there does not exist
    [plan]      tolerance_dn = 0.25, on = ["prnu"], off = ["blooming"]

Keys are the fields of the records of the same name, so that the records' docstrings are the manual. Not here: the
records themselves, the planner.
"""

import dataclasses
import types
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, NonNegativeInt, PositiveInt, Strict, create_model

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative, settings_from
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import LIGHT_PATH, generator, light_path, sensor_effects, with_well_of
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import CameraPath, ReversingMove, StageMove, stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, Optics, RigFigures, Timing
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.simulation_plan import PlanChoice

Record = TypeVar("Record")


@dataclass(frozen=True)
class SceneChoice(BoundedRecord):
    """What is seen.

    Args:
        name: One that comes with the simulator (`gs2ci_sims.scenes.files.scene_names`), or a scene file (.toml).
        height: Pixels.
        width: Pixels.
        seed: Of other planes than the scene "planes" has; only for that one.
    """

    name: str = "planes"
    height: PositiveInt = 96
    width: PositiveInt = 128
    seed: NonNegativeInt | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seed is not None and self.name != "planes":
            raise InputError(f"scene {self.name!r} with a seed", allowed="a seed for the scene 'planes' alone")

    def build(self) -> Scene:
        """Draw the scene.

        Raises:
            InputError: There is no such scene.
        """
        size = (self.height, self.width)
        if self.seed is not None:
            return planes(np.random.default_rng(self.seed), size)
        return load_scene(self.name, size=size).scene


@dataclass(frozen=True)
class PathChoice(BoundedRecord):
    """How the camera moves during the exposure.

    Args:
        parallax_px: How far near and far of the scene shift against each other over the exposure, at least 0.
        direction: Of the move, along the camera's axes (right, down, ahead).
        wobble_deg: Amplitude of the stage's angular errors; of a stage that does not turn back.
        turns: How often the stage turns back during the exposure, at least 0; it then covers its way several times.
    """

    parallax_px: NotNegative = 6.0
    direction: tuple[float, float, float] = (1.0, 0.3, 0.1)
    wobble_deg: FiniteFloat = 0.0
    turns: NonNegativeInt = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.turns and self.wobble_deg:
            raise InputError(
                f"a path with {self.turns} turns and a wobble of {self.wobble_deg} deg",
                allowed="one of the two",
                remedy="give vibrations as [effects.stage_vibration]",
            )

    def build(self, scene: Scene, exposure_s: float) -> CameraPath:
        """Lay the path for a scene and the length of an exposure."""
        if self.parallax_px == 0 and self.wobble_deg == 0:
            return StageMove((0.0, 0.0, 0.0), reference_world_to_camera=scene.world_to_camera)
        move = stage_move_for_parallax(
            scene, self.parallax_px, exposure_s, direction=self.direction, wobble_deg=self.wobble_deg
        )
        if not self.turns:
            return move
        return ReversingMove(move.velocity, 2 * exposure_s / self.turns, scene.world_to_camera)


@dataclass(frozen=True)
class Setup:
    """All that a rig file says.

    Args:
        rig: Figures of the parts.
        scene: What is seen.
        path: How the camera moves.
        plan: How exactly to simulate.
        effects: All that the rig has, motion blur and what every sensor does included.
        seed: Of masks and all draws.
    """

    rig: RigFigures
    scene: SceneChoice = field(default_factory=SceneChoice)
    path: PathChoice = field(default_factory=PathChoice)
    plan: PlanChoice = field(default_factory=PlanChoice)
    effects: tuple[Effect, ...] = ()
    seed: int = 0

    def masks(self) -> F32:
        """Draw the masks, [N, H, W]."""
        modulator = self.rig.modulator
        return random_masks(
            modulator.masks,
            (self.scene.height, self.scene.width),
            modulator.open_share,
            generator(self.seed, "masks"),
            feature_px=modulator.feature_px,
        )


PARTS: Final[dict[str, type]] = {
    "light": Light,
    "optics": Optics,
    "modulator": ModulatorFigures,
    "timing": Timing,
    "sensor": SensorFigures,
}
UNNAMED: Final = Path("the rig file")
CHOICES: Final[dict[str, type]] = {"scene": SceneChoice, "path": PathChoice, "plan": PlanChoice}


def setup_from_tables(tables: Mapping[str, Any], path: Path = UNNAMED) -> Setup:
    """Turn the tables of a rig file into records.

    Args:
        tables: The tables.
        path: The file that they are of, for errors.

    Raises:
        InputError: A key is unknown (the nearest known one is named) or a value cannot be used.
    """
    kinds = _effect_kinds(tables.get("effects"))
    records = {name: (_model(kind), None) for name, kind in (PARTS | CHOICES).items()}
    seeds = {name: (_strict_hint(int), 0) for name in ("seed", "device_seed")}
    file: Any = settings_from(
        tables, _tables("RigFile", **seeds, **records, effects=(_effects_model(kinds), None)), path
    )
    parts: dict[str, Any] = {name: _record(kind, getattr(file, name)) for name, kind in PARTS.items()}
    choices: dict[str, Any] = {name: _record(kind, getattr(file, name)) for name, kind in CHOICES.items()}
    effects = _effects(kinds, file.effects)
    parts["sensor"] = with_well_of(effects, parts["sensor"])
    rig = RigFigures(**parts, device_seed=file.device_seed)
    given = {effect.name for effect in effects}
    implied = [effect for effect in (MotionBlur(), *sensor_effects(rig.sensor)) if effect.name not in given]
    return Setup(rig, effects=(*implied, *effects), seed=file.seed, **choices)


def effects_from_tables(tables: Mapping[str, Any]) -> list[Effect]:
    """Turn tables named as effects into effects.

    Args:
        tables: The tables.

    Raises:
        InputError: There is no such effect, or a key or value cannot be used.
    """
    kinds = _effect_kinds(tables)
    file: Any = settings_from({"effects": tables}, _tables("RigFile", effects=(_effects_model(kinds), None)), UNNAMED)
    return _effects(kinds, file.effects)


def _effect_kinds(tables: Any) -> dict[str, type[Effect]]:
    """Return the effects that tables may name; plug-ins are looked for where a name is none of ours."""
    kinds = {kind.name: kind for kind in LIGHT_PATH}
    plugged = isinstance(tables, Mapping) and not set(tables) <= set(kinds)
    return {kind.name: kind for kind in light_path(tables)} if plugged else kinds


def _effects(kinds: Mapping[str, type[Effect]], tables: BaseModel | None) -> list[Effect]:
    """Build the effects that have a table, in their physical order."""
    named = [] if tables is None else [name for name in tables.model_fields_set if getattr(tables, name) is not None]
    return [_record(kinds[name], getattr(tables, name)) for name in kinds if name in named]


def _effects_model(kinds: Mapping[str, type[Effect]]) -> type[BaseModel]:
    return _tables("Effects", **{name: (_model(kind), None) for name, kind in kinds.items()})


def _record(kind: type[Record], table: BaseModel | None) -> Record:
    """Build a frozen record from what its table says; the rest are the record's defaults."""
    return kind(**({} if table is None else {name: getattr(table, name) for name in table.model_fields_set}))


@cache
def _model(kind: type) -> type[BaseModel]:
    """Return the model of a record's table: its fields. What the file does not give, the record knows itself."""
    hints, missing = get_type_hints(kind), dataclasses.MISSING
    fields = {}
    for entry in dataclasses.fields(kind):
        required = entry.default is missing and entry.default_factory is missing
        fields[entry.name] = (_strict_hint(hints[entry.name]), ... if required else None)
    return _tables(kind.__name__, **fields)


def _tables(name: str, /, **fields: Any) -> type[BaseModel]:
    # Records say themselves where they bear no infinite numbers.
    return create_model(name, __config__=ConfigDict(extra="forbid", frozen=True), **fields)


def _strict_hint(hint: Any) -> Any:
    """Return the hint of a field as a file may give it: a flag is no number, and a fraction no whole one."""
    if isinstance(hint, types.UnionType):
        # An image cannot stand in a file; of a field that takes one or a number, the number is meant.
        hint = next(option for option in get_args(hint) if option in (int, float, str, bool))
    if get_origin(hint) is tuple:
        return tuple[tuple(part if part is Ellipsis else _strict_hint(part) for part in get_args(hint))]  # type: ignore[misc]
    return Annotated[hint, Strict()] if hint in (int, float, str, bool) else hint
