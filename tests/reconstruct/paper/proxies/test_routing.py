import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.reconstruct.paper.proxies.routing import build_proxies, multiplicity, route


def test_multiplicity_counts_weights_and_grey_levels(make_shot):
    masks = np.zeros((2, 4, 4))
    masks[0], masks[1, :2] = 0.5, 1
    assert multiplicity(make_shot(masks, weights=[1, 0.5])) == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("n", "share", "method"),
    [(8, 0.125, "eni"), (8, 0.25, "eni"), (8, 0.5, "amdi"), (8, 0.75, "amdi"), (16, 0.25, "amdi"), (32, 0.25, "amdi")],
)
def test_the_papers_settings_take_the_papers_routes(make_shot, n, share, method):
    masks = np.zeros((n, 16, 16))
    order = np.random.default_rng(0).permuted(np.tile(np.arange(256), (n, 1)), axis=1) < share * 256
    masks[:] = order.reshape(n, 16, 16)
    assert route(make_shot(masks)) == method


def test_four_is_amdi(make_shot):
    masks = np.zeros((5, 8, 8))
    masks[:4] = 1
    assert route(make_shot(masks)) == "amdi"


def test_random_masks_of_sixteen_views_are_routed_by_their_design_and_not_by_their_draw(make_shot):
    """A quarter of 16 is four by design; the draw may leave a hundredth less. The paper says AMDI."""
    draws = [make_shot(np.random.default_rng(seed).random((16, 96, 128)) < 0.25) for seed in range(6)]
    assert min(multiplicity(drawn) for drawn in draws) < 3.995
    assert {route(drawn) for drawn in draws} == {"amdi"}


def test_masks_that_surely_share_less_than_four_are_not(make_shot):
    drawn = make_shot(np.random.default_rng(0).random((16, 96, 128)) < 0.24)
    assert route(drawn) == "eni"
    even = np.zeros((8, 32, 32))
    even[:4] = 0.999  # no draw: every pixel has the same sum
    assert route(make_shot(even)) == "eni"


def test_the_masks_as_they_were_calibrated_route_where_pixels_have_been_closed_since(make_shot):
    masks = (np.random.default_rng(0).random((8, 32, 32)).argsort(axis=0) < 4).astype(float)
    closed = masks * (np.random.default_rng(1).random((32, 32)) > 0.1)
    assert build_proxies(make_shot(closed)).method == "eni"
    proxies = build_proxies(make_shot(closed), masks_of=make_shot(masks))
    assert proxies.method == "amdi"
    assert proxies.multiplicity == pytest.approx(4)


@pytest.mark.parametrize("method", ["auto", "naive", "eni", "amdi"])
def test_proxies_are_in_range_and_say_how_they_were_made(make_shot, random_masks, method):
    shot = make_shot(random_masks(8, (32, 32), 0.75), np.random.default_rng(0).random((8, 32, 32, 1)))
    proxies = build_proxies(shot, method)
    assert proxies.method == ("amdi" if method == "auto" else method)
    assert proxies.multiplicity == pytest.approx(6, abs=0.1)
    assert proxies.views.shape == (8, 32, 32, 1)
    assert proxies.views.min() >= 0
    assert proxies.views.max() <= 1
    assert not proxies.note


def test_auto_stands_back_to_eni_where_masks_do_not_tell_views_apart(make_shot):
    shot = make_shot(np.ones((6, 16, 16)))
    proxies = build_proxies(shot)
    assert proxies.method == "eni"
    assert proxies.note.code is Code.PROXIES_BY_ENERGY
    assert np.allclose(proxies.views, np.linspace(0.2, 0.9, 6).mean(), atol=1e-5)


def test_amdi_by_name_does_not_stand_back(make_shot):
    with pytest.raises(InputError, match="do not distinguish their views"):
        build_proxies(make_shot(np.ones((6, 16, 16))), "amdi")


def test_an_unknown_method_is_refused(make_shot):
    with pytest.raises(InputError, match="'enni'"):
        build_proxies(make_shot(np.ones((2, 4, 4))), "enni")
