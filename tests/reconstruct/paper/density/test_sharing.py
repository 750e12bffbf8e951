import math
from decimal import Decimal, getcontext

import pytest
import torch

from gs2ci.reconstruct.paper.density.sharing import most_copies, share_out

LOGITS = (-80.0, -20.0, -5.0, -1.0, 0.0, 2.0, 8.0, 20.0, 40.0)
COPIES = (2, 3, 7, 51, 400, 2000)


def shared(logits, copies, dtype=torch.float64):
    logits = torch.tensor(logits, dtype=dtype)
    return share_out(logits, torch.zeros(len(logits), 3, dtype=dtype), torch.as_tensor(copies).expand(len(logits)))


def exact_share(logit, copies):
    """α' and σ' / σ by the authors' sum of binomials (Kheradmand et al. 2024, eq. 9), in 400 digits."""
    getcontext().prec = 400
    through = 1 / (1 + Decimal(logit).exp())  # 1 − α
    opacity, part = 1 - through, 1 - (through.ln() / copies).exp()
    # The sum over i = 1 ... N of C(i − 1, k) is C(N, k + 1): one sum is left of the two.
    total, term = Decimal(0), Decimal(1)
    for j in range(1, copies + 1):
        term = term * part * (copies - j + 1) / j
        total += (term if j % 2 else -term) / Decimal(j).sqrt()
    return float(part.ln() - (1 - part).ln()), float((opacity / total).ln())


@pytest.mark.parametrize("copies", COPIES)
def test_opacity_and_size_are_those_of_the_authors_sum_for_any_number_of_copies(copies):
    logits, log_scales = shared(LOGITS, copies)
    expected = torch.tensor([exact_share(logit, copies) for logit in LOGITS], dtype=torch.float64)
    torch.testing.assert_close(logits, expected[:, 0], rtol=1e-9, atol=1e-9)
    for axis in log_scales.T:
        torch.testing.assert_close(axis, expected[:, 1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("copies", [2, 51, 10_000])
def test_float32_parameters_lose_no_more_than_their_own_last_digits(copies):
    logits = torch.linspace(-80, 80, 321).tolist()
    narrow, wide = shared(logits, copies, torch.float32), shared(logits, copies)
    for a, b in zip(narrow, wide, strict=True):
        assert a.dtype == torch.float32
        torch.testing.assert_close(a.double(), b, rtol=2e-7, atol=2e-7)


@pytest.mark.parametrize("copies", [2, 51, 5000, 10**6])
def test_all_copies_together_let_through_what_the_one_did(copies):
    logits = torch.linspace(-60, 60, 121)
    parts, _ = shared(logits.tolist(), copies)
    together = -copies * torch.nn.functional.softplus(parts, threshold=float("inf"))
    before = -torch.nn.functional.softplus(logits.double(), threshold=float("inf"))
    torch.testing.assert_close(together, before, rtol=1e-12, atol=0)


def test_one_copy_changes_nothing():
    scales = torch.randn(9, 3, generator=torch.Generator().manual_seed(0))
    logits, log_scales = share_out(torch.tensor(LOGITS), scales, torch.ones(9, dtype=torch.int64))
    assert torch.equal(logits, torch.tensor(LOGITS))
    assert torch.equal(log_scales, scales)


@pytest.mark.parametrize("logit", [-1e4, -700.0, 700.0, 1e4])
def test_opacities_beyond_all_floats_stay_finite(logit):
    logits, log_scales = shared((logit,), 1000, torch.float32)
    assert torch.isfinite(logits).all()
    assert torch.isfinite(log_scales).all()
    # The faint share their opacity, α / N; the opaque their ln(1 − α).
    expected = logit - math.log(1000) if logit < 0 else math.log(math.expm1(logit / 1000))
    assert float(logits[0]) == pytest.approx(expected, rel=1e-6)


def test_the_opaquer_the_more_copies_shrink():
    _, log_scales = shared((-20.0, -1.0, 2.0, 8.0), 10)
    assert (log_scales[1:, 0] < log_scales[:-1, 0]).all()
    assert float(log_scales[0, 0]) == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize("opacity", [0.005, 0.1, 0.999])
def test_no_more_copies_are_afforded_than_stay_visible(opacity):
    logits = torch.linspace(-8, 30, 400)
    most = most_copies(logits, opacity)
    assert (most >= 1).all()
    parts, _ = share_out(logits, torch.zeros(400, 3), most)
    several = most > 1
    assert (torch.sigmoid(parts[several].double()) >= opacity * (1 - 1e-5)).all()
    fainter, _ = share_out(logits, torch.zeros(400, 3), most + 1)
    assert (torch.sigmoid(fainter.double()) < opacity).all()


def test_the_dividing_line_itself_affords_what_it_is_made_of():
    """An opacity of exactly N layers of the least affords N copies, not N − 1."""
    least = 0.005
    n = torch.tensor([1, 2, 10, 500])
    through = n.double() * math.log1p(-least)
    logits = torch.log(-torch.expm1(through)) - through
    assert most_copies(logits, least).tolist() == n.tolist()
