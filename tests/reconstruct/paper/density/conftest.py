"""The Gaussians on a line of the other density rules' tests."""

from tests.reconstruct.fit.density.conftest import evidence, line

__all__ = ["evidence", "line"]
