"""What the command line asks of the libraries' threads, and that a user's own wish stands."""

import os
import subprocess
import sys

import pytest

_ASKED = {"OMP_WAIT_POLICY": "PASSIVE", "OPENBLAS_NUM_THREADS": "1"}


@pytest.mark.parametrize("set_before", [{}, {"OMP_WAIT_POLICY": "ACTIVE", "OPENBLAS_NUM_THREADS": "3"}])
def test_thread_pools_are_set_before_numpy_is_loaded_unless_the_user_set_them(set_before):
    others = {name: value for name, value in os.environ.items() if name not in _ASKED}
    asked = f"import os, sys, gs2ci.cli; print('numpy' in sys.modules, *(os.environ[name] for name in {tuple(_ASKED)}))"
    found = subprocess.run(
        [sys.executable, "-c", asked], env=others | set_before, capture_output=True, text=True, check=True
    ).stdout.split()
    assert found == ["False", *(_ASKED | set_before).values()]
