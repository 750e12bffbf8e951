"""A plug-in of gs2ci: one driver worked out, and the smallest of every other part.

plugin.py    what the rig needs to open the driver; settings.py, its table in a rig file
driver.py    the modulator; twin.py, the same device simulated; ../../firmware, what the Arduino runs
density.py, decoder.py, prior.py, geometry.py, effect.py, scenes.py  one plug-in each
"""
