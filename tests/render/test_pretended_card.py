"""A pretended card refuses what a card refuses."""

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")

from tests.render.pretended_card import CARD, lies_there, pretended_card


def test_tensors_of_both_places_are_not_mixed():
    host = torch.ones(3)
    with pretended_card():
        there = host.to(CARD)
        assert (there.device, host.device) == (CARD, torch.device("cpu"))
        assert lies_there(2 * there + torch.tensor(1.0) + torch.zeros(3, device=there.device))
        assert not lies_there(there.cpu())
        assert not lies_there(there.to("cpu"))
        with pytest.raises(RuntimeError, match="add of tensors of both places"):
            there + host
        with pytest.raises(RuntimeError, match="indices of the card"):
            host[there.long()]
        with pytest.raises(TypeError, match="numpy of a tensor of the card"):
            there.numpy()
        with pytest.raises(TypeError, match="__array__ of a tensor of the card"):
            np.asarray(there)


def test_gradients_lie_where_their_tensors_do():
    with pretended_card() as card:
        there = torch.ones(3, device=CARD).requires_grad_()
        (there * 2).sum().backward()
        assert lies_there(there.grad)
    assert card.names.total() > 2
