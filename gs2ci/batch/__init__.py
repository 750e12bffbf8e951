"""Many exposures, reconstructed on many processes or machines.

exposures.py   which exposures there are in the files, and what their run folders are called
rows.py        what is known of each when it has ended: one small file, one line of the CSV
work.py        one exposure, from its file to its run folder, on whatever machine that happens
cluster.py     Dask: a cluster that exists, or workers of this machine
crew.py        handing exposures out, and again where a worker died
index_page.py  the page over all of them
reconstruct.py the order of these
"""
