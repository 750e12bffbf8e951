"""What notebooks show of our records: pictures that are pictures, and HTML that holds what it says and no code."""

from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
import torch

import gs2ci
from gs2ci.core.notebook import png_of, row_of
from gs2ci.render.gaussians import Gaussians

VOID = {"img", "br"}


class Checked(HTMLParser):
    """Every element is closed in its order; scripts and addresses elsewhere are noted."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.outside = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.outside += [value for name, value in attrs if name == "src" and not value.startswith("data:image/png")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def picture(record):
    """The picture that a notebook would show, [H, W, 3]."""
    image = cv2.imdecode(np.frombuffer(record._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.std() > 5
    return image[..., ::-1]


def page(record):
    checked = Checked(record._repr_html_())
    assert checked.open == []
    assert checked.outside == []
    assert "script" not in checked.seen
    return record._repr_html_()


@pytest.mark.parametrize(
    "parts",
    [
        {"measurement": np.ones((6, 8))},
        {"measurement": np.ones((6, 8, 4))},
        {"masks": np.ones((6, 8))},
        {"masks": np.ones((0, 6, 8))},
        {"weights": []},
        {"intrinsics": [9.0, 9.0, 4.0, 3.0]},
        {"truth": gs2ci.Truth(views=np.ones((2, 3)))},
        {"truth": None},
        {"name": None},
    ],
)
def test_what_is_no_shot_yet_says_why_in_a_notebook(parts):
    shot = gs2ci.Shot(**{"measurement": np.ones((6, 8, 1)), "masks": np.ones((4, 6, 8)), **parts})
    with pytest.raises(gs2ci.InputError) as refused:
        shot.check()
    told = page(shot)
    assert "cannot be used" in told
    assert refused.value.problem.replace("'", "&#x27;") in told
    assert shot._repr_png_() is None


def test_a_shot_shows_what_was_measured_and_by_which_masks(examples):
    shot = gs2ci.load("shot.h5")
    told = page(replace(shot, name="<script>alert(1)</script>"))
    assert "32 × 24, RGB" in told
    assert "views, path" in told
    shown = picture(shot)
    # The mask's tile: its pixels, enlarged.
    tile = shown[:, 299 : 299 + 293, 0] > 128
    centres = tile[np.arange(24) * 220 // 24 + 4][:, np.arange(32) * 293 // 32 + 4]
    assert (centres == (shot.masks[0] > 0.5)).mean() > 0.97
    assert picture(replace(shot, truth=gs2ci.Truth())).shape[1] < shown.shape[1]


def test_a_run_shows_its_figures_and_notes(examples):
    run = gs2ci.open_run("run")
    told = page(run)
    assert f"{run.report.psnr_db.mean:.2f} dB" in told
    assert run.report.notes[0].advice.split("&")[0].split("<")[0][:20] in told
    assert picture(run).shape == (220, 3 * 293 + 12, 3)
    assert picture(replace(run, depth=None)).shape == (220, 2 * 293 + 6, 3)


def test_a_scene_shows_its_opaque_gaussians_and_the_near_before_the_far(scene):
    assert f"{len(scene)}" in page(scene)
    picture(scene)
    grid = torch.stack(torch.meshgrid(torch.linspace(-1, 1, 30), torch.linspace(-1, 1, 30), indexing="xy"), -1)
    flat = grid.reshape(-1, 2)
    red, blue = torch.tensor([[1.0, 0, 0]]), torch.tensor([[0.0, 0, 1]])
    means = torch.cat([torch.cat([flat, torch.full((900, 1), z)], 1) for z in (2.0, 4.0)])
    both = Gaussians(
        means,
        torch.zeros(1800, 3),
        torch.zeros(1800, 4),
        torch.full((1800,), 3.0),
        torch.cat([red, blue]).repeat_interleave(900, 0),
    )
    drawn = picture(both)
    assert (drawn[..., 0] > 200).sum() > 3 * (drawn[..., 2] > 200).sum()
    assert both.map(lambda tensor: tensor[:0])._repr_png_() is None
    assert replace(both, opacity_logits=torch.full((1800,), -9.0))._repr_png_() is None
    page(both.map(lambda tensor: tensor[:0]))


def test_a_calibration_bundle_and_the_plans_show_theirs(examples):
    with gs2ci.open_rig("rig.toml") as rig:
        bundle = rig.calibrate("bench.cal.h5", "dark-flat", progress=gs2ci.Silent())
        prepared = rig.plan(progress=gs2ci.Silent())
    assert "dark-flat" in page(bundle)
    assert "simulated bench" in page(bundle)
    assert bundle._repr_png_() is not None
    assert replace(bundle, sections={})._repr_png_() is None
    assert "stage travel" in page(prepared)
    assert picture(prepared).shape[0] == 160
    decided = gs2ci.plan("rig.toml")
    assert all(decision.name in page(decided) for decision in decided.decisions)
    picture(decided)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 1), (5, 7, 3)])
def test_pictures_come_back_as_they_were(shape):
    given = np.random.default_rng(0).random(shape).astype(np.float32)
    image = cv2.imdecode(np.frombuffer(png_of(given), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    wanted = np.broadcast_to(given.reshape(5, 7, -1), (5, 7, 3))
    assert np.abs(image / 255 - wanted).max() <= 0.5 / 255 + 1e-6
    assert row_of([given, given], height=10).shape == (10, 14 + 6 + 14, 3)
    assert (row_of([np.full(shape, np.nan)], height=5) == 0).all()
