"""Priors on single images: what a rendered view should rather look like, for the fine stage."""
