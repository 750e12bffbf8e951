"""The plane and the scattered Gaussians of the fit's tests."""

from tests.reconstruct.fit.conftest import moving_plane, scattered, similarity_definition, threads

__all__ = ["moving_plane", "scattered", "similarity_definition", "threads"]
