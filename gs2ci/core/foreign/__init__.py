"""Coded measurements from elsewhere: .npz, .npy, .mat (v5 and v7.3), pictures, turned into shots.

    container.py   a file as a set of named arrays that are loaded one by one, and its errors
    npy.py npz.py mat5.py mat73.py pictures.py   one format each
    opening.py     which format a file is, from its first bytes
    roles.py       which key is the measurement, which the masks, ...
    axes.py        which axis is which
    pixels.py      unreadable and clipped pixels
    scale.py       what reading stands for full scale
    agreement.py   whether masks, measurement and truth belong together
    camera.py      intrinsics and poses
    assemble.py    all of this in order: a file in, shots and the list of guesses out

Every guess is a sentence for the user; what contradicts itself is one InputError that names file, key and remedy.
Python objects (pickles) are never loaded. Not here: our own files (`gs2ci.core.storage`), printing.
"""
