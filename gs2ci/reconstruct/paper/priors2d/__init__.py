"""Priors on single images, which improve rendered views, for the fine stage."""
