"""Metrics, figures and reports: how good a result is, and what it cost."""
