"""Masks moved and blurred by scipy, with nothing of the solver's own: what a bench did to them."""

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter


def warped(masks, *, down_px=0.0, right_px=0.0, turn_deg=0.0, scale=1.0, mode="nearest"):
    """Move masks about their middle, by scipy: elements and pixels of one pitch overlap bilinearly."""
    turn = np.deg2rad(turn_deg)
    back = np.linalg.inv(scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    middle = (np.array(masks.shape[1:]) - 1) / 2
    offset = middle - back @ (middle + np.array([down_px, right_px]))
    return np.stack([affine_transform(mask.astype(float), back, offset, order=1, mode=mode) for mask in masks])


def blurred(masks, sigma_px):
    return gaussian_filter(masks.astype(float), (0, sigma_px, sigma_px))
