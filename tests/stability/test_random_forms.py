"""Measurements of random form: a few of those that `python -m tests.stability --random` makes."""

import numpy as np
import pytest

from gs2ci.core.errors import Gs2ciError
from tests.nightly import but
from tests.stability import __main__ as command
from tests.stability import random_forms
from tests.stability.random_forms import DAMAGES, MASKS, WAYS, Form, judge


@pytest.mark.slow
@pytest.mark.parametrize("seed", but(2, range(8)))
def test_a_result_is_finite_or_refused_and_nothing_overflows(seed):
    line, problem = judge(seed)
    assert problem is None, f"{line}\n{problem}"


def test_every_kind_is_drawn_and_can_be_made():
    forms = [Form.draw(seed) for seed in range(120)]
    assert {form.masks for form in forms} == set(MASKS)
    assert {form.way for form in forms} == set(WAYS)
    assert {form.damage for form in forms} == set(DAMAGES)
    made = 0
    for form in forms:
        if max(form.size) < 30:
            try:
                shot = form.shot()
            except Gs2ciError:
                continue
            made += 1
            assert shot.masks.shape == (form.views, *form.size)
            assert np.isfinite(shot.measurement).all()
    assert made > 10
    assert Form.draw(3) == Form.draw(3)


def test_what_is_no_typed_error_is_a_problem(monkeypatch, capsys):
    def overflowing(*_, **__):
        return np.float32(1e30) * np.float32(1e30)

    monkeypatch.setattr(random_forms.gs2ci, "reconstruct", overflowing)
    line, problem = judge(0)
    assert line.startswith("failed")
    assert "overflow" in problem
    monkeypatch.setattr(command, "as_they_end", lambda function, seeds, jobs: map(function, seeds))
    assert command.judge_random(range(2), 1) == 1
    assert "2 measurements of random form, 2 with problems" in capsys.readouterr().out
