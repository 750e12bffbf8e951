"""Many exposures, reconstructed on many processes or machines.

exposures.py   the exposures in the files, and the names of their run folders
rows.py        the result of each exposure: one small file, one line of the CSV
work.py        one exposure, from its file to its run folder, on any machine
cluster.py     Dask: an existing cluster, or workers of this machine
crew.py        distributing exposures to workers, and again if a worker died
index_page.py  the page over all of them
reconstruct.py the order of these steps
"""
