"""Accuracy against time, for one shot on one machine.

trials.py     the trials: the ladder of presets, and one setting at a time
store.py      finished trials on disk
shrinking.py  a shot at a fraction of its resolution, and its views back at full size
exposures.py  trials of several exposures together, and what the next one is worth
front.py      the Pareto front of the trials, and what the next decibel costs, in words
pages.py      CSV, and a section in markdown
record.py     tradeoff.json: the figures for a run's page, kept in the run folder
"""
