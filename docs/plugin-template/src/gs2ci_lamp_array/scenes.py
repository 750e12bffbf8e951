"""A scene for simulations: the path of a scene file (`gs2ci_sims.scenes.files`)."""

from pathlib import Path

TWO_BOXES = Path(__file__).parent / "two_boxes.toml"
