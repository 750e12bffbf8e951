import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.paper.perceptual import StructuralDissimilarity, load_distance


def images(height=24, width=20, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(2, height, width, 3, generator=generator)


def test_equal_images_are_at_no_distance():
    image = images()[0]
    assert float(StructuralDissimilarity()(image, image)) == pytest.approx(0, abs=1e-6)


def test_it_is_the_mean_dissimilarity_over_the_scales(similarity_definition):
    wanted = over_three_scales(similarity_definition, *images())
    assert float(StructuralDissimilarity()(*images())) == pytest.approx(float(wanted), abs=1e-5)


def over_three_scales(similarity, a, b):
    found, a, b = [], a.double(), b.double()
    for _ in range(3):
        found.append(1 - similarity(a, b))
        a, b = (torch.nn.functional.avg_pool2d(x.permute(2, 0, 1), 2).permute(1, 2, 0) for x in (a, b))
    return torch.stack(found).mean()


def test_its_gradient_is_that_of_its_definition(similarity_definition):
    image, target = images()
    given = image.clone().requires_grad_()
    StructuralDissimilarity()(given, target).backward()
    exact = image.double().requires_grad_()
    over_three_scales(similarity_definition, exact, target).backward()
    torch.testing.assert_close(given.grad.double(), exact.grad, atol=1e-6, rtol=1e-3)


def test_the_gradient_reaches_the_image_only():
    image, target = (part.requires_grad_() for part in images().unbind())
    StructuralDissimilarity()(image, target).backward()
    assert image.grad.abs().sum() > 0
    assert target.grad is None


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2)])
def test_small_images_have_fewer_scales(size):
    assert torch.isfinite(StructuralDissimilarity()(*images(*size)))


def test_it_is_never_called_lpips():
    assert "lpips" not in StructuralDissimilarity().name.lower()


def test_distances_are_loaded_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path))
    assert isinstance(load_distance("structure"), StructuralDissimilarity)
    with pytest.raises(InputError, match="no lpips model"):
        load_distance("lpips")
    with pytest.raises(InputError, match="no model file"):
        load_distance("lpips:absent.onnx")
    with pytest.raises(InputError, match="perceptual distance 'vgg'"):
        load_distance("vgg")
