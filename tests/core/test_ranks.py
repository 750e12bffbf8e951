"""Ranks and their correlation are those of scipy; and no reconstruction waits for scipy's statistics or matplotlib."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from gs2ci.core.ranks import rank_correlation, ranks


@pytest.mark.parametrize("levels", [1000, 5, 2])
def test_ranks_and_their_correlation_are_those_of_scipy(levels):
    draw = np.random.default_rng(levels)
    one, other = draw.integers(0, levels, (2, 200)).astype(float)
    np.testing.assert_array_equal(ranks(one), stats.rankdata(one))
    for second in (other, one + other, -one):
        assert rank_correlation(one, second) == pytest.approx(stats.spearmanr(one, second).statistic, abs=1e-12)


def test_equal_numbers_have_no_order():
    assert np.isnan(rank_correlation(np.ones(4), np.arange(4)))
    np.testing.assert_array_equal(ranks(np.zeros(0)), [])


def test_neither_a_reconstruction_nor_its_report_imports_scipys_statistics_or_matplotlib():
    code = (
        "import sys\n"
        "import gs2ci.reconstruct.pipeline, gs2ci.evaluate.run_folder\n"
        "sys.exit('scipy.stats' in sys.modules or 'matplotlib' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
