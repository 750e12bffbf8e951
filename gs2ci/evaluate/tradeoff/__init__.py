"""What accuracy costs in time, for one shot on one machine.

trials.py     what is tried: the ladder of presets, and one setting at a time
shrinking.py  a shot at a fraction of its resolution, and its views back at full size
front.py      which trials no other beats, and what the next decibel costs, in words
pages.py      CSV, picture, and a section in markdown
record.py     tradeoff.json: what a run's page shows of it, kept in the run folder
"""
