import json
import socket
import sys
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.door import PORTS_TRIED
from gs2ci.core.errors import InputError, StorageError
from gs2ci.evaluate import run_folder, viewer
from gs2ci.evaluate.viewer import SHOWN_DEPTH, free_port, load_scene, serve
from gs2ci.render.harmonics import colours_seen
from gs2ci.render.ply import read_ply
from tests.patience import HANG_S


@pytest.fixture
def write(tmp_path, make_run, scene, monkeypatch):
    monkeypatch.setattr(run_folder, "write_overview", lambda path, *_: path.touch())

    def written(gaussians=None, poses=None):
        shot, result = make_run(count=3, size=(12, 16))
        if poses is not None:
            result = replace(result, world_to_camera=poses)
        return run_folder.write_run(tmp_path / "run", shot, result, scene if gaussians is None else gaussians)

    return written


def ahead(scene, depth):
    """The same Gaussians, all at one depth before cameras that look along z."""
    means = scene.means.clone()
    means[:, 2] = depth
    return replace(scene, means=means)


@pytest.mark.parametrize("depth", [0.003, 1.0, 5000.0])
def test_scenes_of_any_unit_are_shown_at_one_scale(write, scene, depth):
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, -depth, -2 * depth]
    shown = load_scene(write(ahead(scene, depth), poses))
    np.testing.assert_allclose(shown.means[:, 2], SHOWN_DEPTH, rtol=1e-5)
    np.testing.assert_allclose(shown.camera_to_world[:, 0, 3], [0, SHOWN_DEPTH, 2 * SHOWN_DEPTH], rtol=1e-6)


def test_covariances_are_those_of_the_gaussians(write, scene):
    gaussians = replace(ahead(scene, SHOWN_DEPTH), log_scales=scene.log_scales - 3)
    shown = load_scene(write(gaussians, np.tile(np.eye(4), (3, 1, 1))))
    # Wider by what the fit added in pixels of its views, whose focal length is 1.1 times their width of 16 px.
    wanted = torch.sort((2 * gaussians.log_scales).exp(), dim=1).values + 0.3 * (SHOWN_DEPTH / (1.1 * 16)) ** 2
    np.testing.assert_allclose(np.linalg.eigvalsh(shown.covariances), wanted, rtol=1e-3, atol=1e-7)
    assert shown.opacities.shape == (50, 1)
    assert 0 <= shown.colours.min() <= shown.colours.max() <= 1


def test_no_covariance_is_beyond_half_precision(write, scene):
    gaussians = replace(ahead(scene, SHOWN_DEPTH), log_scales=scene.log_scales + 9)
    shown = load_scene(write(gaussians, np.tile(np.eye(4), (3, 1, 1))))
    assert np.isfinite(shown.covariances.astype(np.float16)).all()
    assert np.linalg.eigvalsh(shown.covariances).max() > 25_000


def test_harmonics_come_back_from_a_run_and_are_shown_as_the_middle_camera_sees_them(write, scene):
    shiny = replace(ahead(scene, 1.0), harmonics=torch.zeros(50, 3, 3))
    shiny.harmonics[:, 2, 0] = -4.0  # red grows to the right
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 0.5, 1.0]
    folder = write(shiny, poses)
    assert torch.equal(read_ply(folder / "scene.ply").harmonics, shiny.harmonics)
    expected = colours_seen(shiny, torch.from_numpy(poses[1:2]).float())[0].clamp(0, 1)
    assert float((expected - shiny.colours.clamp(0, 1)).abs().max()) > 0.1
    np.testing.assert_allclose(load_scene(folder).colours, expected, atol=1e-5)


def test_pictures_and_field_of_view_are_the_runs(write, make_run):
    folder = write()
    shown = load_scene(folder)
    assert [picture.shape for picture in shown.pictures] == [(12, 16, 3)] * 3
    focal = json.loads((folder / "cameras.json").read_text())["fl_y"]
    assert np.tan(shown.fov / 2) == pytest.approx(6 / focal)


def test_cameras_of_pixels_that_are_not_square_see_as_far_to_the_side_as_they_did(write):
    folder = write()
    told = json.loads((folder / "cameras.json").read_text())
    (folder / "cameras.json").write_text(json.dumps({**told, "fl_x": 30.0, "fl_y": 20.0}))
    shown = load_scene(folder)
    assert shown.aspect * np.tan(shown.fov / 2) == pytest.approx(8 / 30)
    assert np.tan(shown.fov / 2) == pytest.approx(6 / 20)


def test_symbols_are_as_large_as_the_cameras_are_apart_within_limits(write):
    shown = load_scene(write())
    for step, size in ((0.0, 0.025), (0.5, 0.3), (100.0, 0.5)):
        poses = np.tile(np.eye(4), (3, 1, 1))
        poses[:, 0, 3] = step * np.arange(3)
        assert replace(shown, camera_to_world=poses).symbol == pytest.approx(size)
        assert replace(shown, camera_to_world=poses[:1]).symbol == 0.5


class Drawn:
    """Takes what the viewer shows; every other call does nothing."""

    def __init__(self):
        self.shown, self.value, self.turned = [], 100, []

    def add_gaussian_splats(self, name, **arrays):
        self.shown.append((name, {len(array) for array in arrays.values()}))

    def add_slider(self, label, **limits):
        self.limits = (label, limits)
        return self

    def on_update(self, turned):
        self.turned.append(turned)

    def __getattr__(self, name):
        return self

    def __call__(self, *_, **__):
        return self


def test_the_slider_hides_what_is_less_sure(write):
    shown, server = load_scene(write()), Drawn()
    assert shown.errors.shape == (50,)
    viewer._show(server, shown)
    limit = float(np.median(100 * shown.errors))
    for server.value in (limit, 0, 100):
        server.turned[0](None)
    kept = int((100 * shown.errors <= limit).sum())
    assert 0 < kept < 50
    assert server.shown == [("/scene", {count}) for count in (50, kept, 1, 50)]
    assert server.limits[1]["initial_value"] == 100


def test_a_scene_without_standard_errors_has_no_slider(write):
    server = Drawn()
    viewer._show(server, replace(load_scene(write()), errors=None))
    assert server.turned == []
    assert server.shown == [("/scene", {50})]


def test_a_scene_behind_the_cameras_is_still_shown(write, scene):
    assert np.isfinite(load_scene(write(ahead(scene, -3), np.tile(np.eye(4), (3, 1, 1)))).means).all()


def test_a_scene_without_gaussians_is_refused(write, scene):
    with pytest.raises(InputError, match="holds no Gaussian"):
        load_scene(write(scene.map(lambda tensor: tensor[:0])))


def test_a_run_without_its_scene_is_refused(write):
    folder = write()
    (folder / "scene.ply").unlink()
    with pytest.raises(InputError, match=r"scene\.ply"):
        load_scene(folder)


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        load_scene(tmp_path)


def test_a_free_port_is_taken_as_it_is_and_a_taken_one_gives_way_to_the_next():
    port = free_port("127.0.0.1", 0)
    assert free_port("127.0.0.1", port) == port
    with socket.create_server(("127.0.0.1", port)):
        assert port < free_port("127.0.0.1", port) < port + PORTS_TRIED


@pytest.mark.parametrize("port", [-1, 65_536])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(InputError, match=f"port {port}"):
        free_port("127.0.0.1", port)


def test_where_nothing_can_be_served_it_says_so(monkeypatch):
    with pytest.raises(InputError, match=r"nothing can be served at 192\.0\.2\.1"):
        free_port("192.0.2.1", 8080)


def test_without_viser_it_says_what_to_install(write, monkeypatch):
    shown = load_scene(write())
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match="needs the package viser") as caught:
        serve(shown, host="127.0.0.1", port=0)
    assert caught.value.remedy == "pip install 'gs2ci[view]'"


def test_viser_serves_the_scene_and_its_cameras(write, capsys):
    pytest.importorskip("viser", reason="the extra `view` is not installed")
    scene = load_scene(write())
    server = serve(scene, host="127.0.0.1", port=0)
    assert capsys.readouterr().out == ""  # not viser's own address, which has no secret
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    try:
        with browser.open(server.address, timeout=HANG_S) as answer:
            assert "viser" in answer.read().decode().lower()
        names = set(server.server.scene._handle_from_node_name)
        assert {"/scene", "/cameras/1", "/cameras/2", "/cameras/3"} <= names
        ahead_of_us = np.subtract(server.server.initial_camera.look_at, server.server.initial_camera.position)
        middle = scene.camera_to_world[1]
        place = np.subtract(server.server.initial_camera.position, middle[:3, 3])
        # The picture of a symbol lies `scale` ahead, divided by the third root of a third of its half sides' product.
        symbol = server.server.scene._handle_from_node_name["/cameras/2"]
        half = np.tan(symbol.fov / 2)
        assert symbol.scale / np.cbrt(half * half * symbol.aspect / 3) == pytest.approx(scene.symbol)
        # On the middle camera's axis, between all symbols of cameras and what is looked at.
        np.testing.assert_allclose(np.cross(place, middle[:3, 2]), 0, atol=1e-6)
        tips = scene.camera_to_world[:, :3, 3] + scene.symbol * scene.camera_to_world[:, :3, 2]
        assert ((tips - server.server.initial_camera.position) @ middle[:3, 2]).max() < 0.1
        assert np.dot(ahead_of_us, middle[:3, 2]) >= 0.5 * SHOWN_DEPTH - 1e-6
    finally:
        server.stop()
