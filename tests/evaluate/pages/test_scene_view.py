"""The scene in three dimensions: what the page is given, and what a real browser draws of it."""

import base64
import re
import time

import numpy as np
import pytest
import torch

from gs2ci.evaluate.pages import scene_view
from gs2ci.evaluate.pages.frame import PageSection, page
from gs2ci.render.gaussians import Gaussians

SIZE = (30, 40)
LENS = np.array([[40.0, 0, 20], [0, 40, 15], [0, 0, 1]])
RED, GREEN, BLUE = [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]


def discs(places, colours, sigma=0.08, opacity=6.0):
    """Round Gaussians, nearly opaque."""
    count = len(places)
    return Gaussians(
        torch.tensor(places),
        torch.full((count, 3), float(np.log(sigma))),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.full((count,), opacity),
        torch.tensor(colours),
    )


def path(count=3):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.linspace(0.2, -0.2, count)
    return poses


def numbers(markup, name, kind):
    (text,) = re.findall(rf'data-{name}="([^"]*)"', str(markup))
    return np.frombuffer(base64.b64decode(text), kind)


def test_the_page_is_given_places_covariances_and_colours_in_the_middle_cameras_axes():
    scene = discs([[0.5, 0.2, 4.0], [0.0, 0.0, 2.0]], [RED, BLUE])
    scene.log_scales[0] = torch.log(torch.tensor([0.1, 0.2, 0.4]))
    turned = path()
    turned[:, :3, :3] = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about the axis
    shapes = numbers(scene_view.scene_view(scene, turned, LENS, SIZE), "shapes", "<f2").reshape(2, 9).astype(float)
    away = 3.0  # the median depth
    np.testing.assert_allclose(shapes[0, :3], [-0.2 / away, 0.5 / away, 1 / away], atol=1e-3)
    np.testing.assert_allclose(shapes[0, 3:] * 1e-4 * away**2, [0.04, 0, 0, 0.01, 0, 0.16], rtol=1e-3, atol=1e-6)
    shades = numbers(scene_view.scene_view(scene, turned, LENS, SIZE), "colours", "u1").reshape(2, 4)
    assert shades.tolist() == [[191, 64, 64, 254], [64, 64, 191, 254]]  # 1 and 0 of -0.5 to 1.5


def test_colours_that_change_with_the_direction_are_those_that_the_middle_camera_sees():
    scene = discs([[0.5, 0.2, 4.0], [0.0, 0.0, 2.0]], [[0.5, 0.5, 0.5]] * 2)
    scene.harmonics = torch.zeros(2, 3, 3)
    scene.harmonics[1, 1] = torch.tensor([0.5, 0.0, -0.5])  # along z, ahead of every camera
    shades = numbers(scene_view.scene_view(scene, path(), LENS, SIZE), "colours", "u1").reshape(2, 4)
    tilt = round(255 * 0.5 * 0.5 * 0.4886)
    assert shades[0, :3].tolist() == [128, 128, 128]
    np.testing.assert_allclose(shades[1, :3].astype(int), [128 + tilt, 128, 128 - tilt], atol=1)


def test_what_cannot_be_seen_is_left_out_and_the_largest_come_first(monkeypatch):
    monkeypatch.setattr(scene_view, "MOST_SHOWN", 2)
    scene = discs([[0, 0, 2.0], [0, 0, 3.0], [0, 0, -2.0], [0, 0, 2.5]], [RED, GREEN, BLUE, BLUE])
    scene.log_scales[0] -= 2
    shown = scene_view.scene_view(scene, path(), LENS, SIZE)
    assert numbers(shown, "colours", "u1").reshape(-1, 4)[:, :3].tolist() == [[64, 191, 64], [64, 64, 191]]
    assert "The 2 of 4 Gaussians" in shown
    assert scene_view.scene_view(discs([[0, 0, -1.0]], [RED]), path(), LENS, SIZE) == ""
    assert scene_view.scene_view(discs([[0, 0, 1.0]], [RED], opacity=-9.0), path(), LENS, SIZE) == ""


def test_one_camera_has_a_symbol_and_several_a_path():
    scene = discs([[0, 0, 2.0]], [RED])
    one = numbers(scene_view.scene_view(scene, path(1), LENS, SIZE), "cameras", "<f4").reshape(-1, 3)
    three = numbers(scene_view.scene_view(scene, path(3), LENS, SIZE), "cameras", "<f4").reshape(-1, 3)
    assert len(one) == 16
    assert len(three) == 3 * 16 + 2 * 2
    np.testing.assert_allclose(three[-2:, 2], -1, atol=1e-6)  # cameras stand one distance before what they look at


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A page with red before green on the left of the middle, and blue on the right."""
    scene = discs([[-0.5, 0, 2.0], [-0.75, 0, 3.0], [0.5, 0, 2.0]], [RED, GREEN, BLUE])
    section = PageSection("Scene", scene_view.scene_view(scene, path(), LENS, SIZE))
    file = tmp_path_factory.mktemp("page") / "scene.html"
    file.write_text(page("a scene", [section]))
    return file


class Box:
    """The box of a page in a tab."""

    def __init__(self, tab):
        self.tab = tab
        self.settle()
        if tab.run("document.querySelector('.space').classList.contains('without')"):
            pytest.skip("no Chromium on this machine that draws by WebGL 2")

    def settle(self):
        """Wait until nothing is drawn any more."""
        before, until = None, time.monotonic() + 20
        while (drawn := self.tab.run("document.querySelector('.space').dataset.drawn || 0")) != before or not drawn:
            before = drawn
            assert time.monotonic() < until
            self.tab.run("new Promise(done => setTimeout(() => requestAnimationFrame(() => done(1)), 60))")

    def middle(self):
        box = "document.querySelector('.space canvas').getBoundingClientRect()"
        left, top, width, height = self.tab.run(f"(r => [r.left, r.top, r.width, r.height])({box})")
        return left, top, width, height

    def picture(self):
        self.settle()
        left, top, width, height = (round(value) for value in self.middle())
        return self.tab.shoot()[top : top + height, left : left + width].astype(int)

    def where(self, channel):
        """Where a colour is seen, as shares of the box from its middle; None where it is not."""
        shown = self.picture()
        others = [other for other in range(3) if other != channel]
        rows, columns = np.nonzero((shown[..., channel] > 150) & (shown[..., others] < 60).all(axis=-1))
        if len(rows) < 20:
            return None
        return columns.mean() / shown.shape[1] - 0.5, rows.mean() / shown.shape[0] - 0.5

    def mouse(self, kind, x, y, **more):
        self.tab.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


@pytest.mark.parametrize("width", [400, 1600])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_it_shows_the_view_of_the_middle_camera_the_near_before_the_far(tab, written, width, dark):
    box = Box(tab.open(written, width, dark=dark))
    assert tab.run("document.documentElement.scrollWidth") == width
    assert tab.complaints == []
    shown = box.picture()
    height, across = shown.shape[:2]
    # The focal length over the view's 40 px of width, fitted into the box.
    wanted = 0.25 * min(across, height * 4 / 3) / across
    for channel, place in ((0, -wanted), (2, wanted)):
        at = box.where(channel)
        assert at[0] == pytest.approx(place, abs=0.01)
        assert at[1] == pytest.approx(0, abs=0.01)
    assert box.where(1) is None  # green lies behind red
    assert shown[5, 5].max() < 8  # where there is nothing, no light comes from, whatever the page looks like


def test_it_blends_as_the_fit_did_before_black_by_a_lens_that_looks_aside(tab, tmp_path):
    """Half-open white is grey, and colours beyond 0 to 1 count as they are until all is blended."""
    scene = discs([[0, -0.3, 2.0], [0, 0.3, 2.0], [0, 0.33, 2.2]], [[1.0] * 3, [-0.4] * 3, [1.4] * 3], sigma=0.12)
    scene.opacity_logits[:2] = 0.0
    aside = LENS + np.array([[0, 0, 6.0], [0, 0, -2.0], [0, 0, 0]])
    section = PageSection("Scene", scene_view.scene_view(scene, np.eye(4)[None], aside, SIZE))
    file = tmp_path / "scene.html"
    file.write_text(page("a scene", [section]))
    shown = Box(tab.open(file, 1000)).picture()
    assert tab.complaints == []
    height, across = shown.shape[:2]
    px = min(across / 40, height / 30)
    for y, wanted in ((-0.3, 0.5), (0.3, 0.5 * 1.4 - 0.5 * 0.4)):
        row, column = round(height / 2 + px * (40 * y / 2 - 2)), round(across / 2 + px * 6)
        np.testing.assert_allclose(shown[row, column], 255 * wanted, atol=6)


def test_dragging_turns_it_the_button_turns_it_back_and_the_wheel_comes_closer(tab, written):
    box = Box(tab.open(written, 1000))
    before = box.picture()
    left, top, width, height = box.middle()
    x, y = left + width / 2, top + height / 2
    box.mouse("mousePressed", x, y, button="left", clickCount=1)
    box.mouse("mouseMoved", x + 120, y, button="left", buttons=1)
    box.mouse("mouseReleased", x + 120, y, button="left", clickCount=1)
    assert box.where(1) is not None  # green comes out from behind red
    assert np.abs(box.picture() - before).mean() > 1
    tab.run("document.querySelector('.space button').click()")
    assert np.abs(box.picture() - before).max() < 8
    apart = box.where(2)[0] - box.where(0)[0]
    box.mouse("mouseWheel", x, y, deltaX=0, deltaY=-200)
    assert box.where(2)[0] - box.where(0)[0] > 1.05 * apart


def test_fingers_turn_and_pinch_it_and_keys_as_well(tab, written):
    box = Box(tab.open(written, 400))
    left, top, width, height = box.middle()
    x, y = left + width / 2, top + height / 2

    def touch(kind, *places):
        points = [{"x": px, "y": py, "id": k} for k, (px, py) in enumerate(places)]
        tab.ask("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    apart = box.where(2)[0] - box.where(0)[0]
    touch("touchStart", (x - 20, y), (x + 20, y))
    touch("touchMove", (x - 30, y), (x + 30, y))
    touch("touchEnd")
    assert box.where(2)[0] - box.where(0)[0] > 1.05 * apart
    tab.run("document.querySelector('.space button').click()")
    touch("touchStart", (x, y))
    touch("touchMove", (x + 100, y))
    touch("touchEnd")
    assert box.where(1) is not None
    tab.run("document.querySelector('.space button').click(); document.querySelector('.space canvas').focus()")
    for _ in range(5):
        tab.ask("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft")
    turned = box.where(0)
    assert turned is None or abs(turned[0] - -0.25) > 0.005
