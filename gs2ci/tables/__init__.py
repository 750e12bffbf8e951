"""Tables of figures: many small, independent pieces of work, each done once and kept.

cases.py      what is measured: shared measurements, simulated scenes, recoded with other masks if wanted
variants.py   what is compared: named changes to the reconstruction's settings
cells.py      one piece of work, and doing it
works.py      the kinds of work there are; simulation.py and calibration.py hold two more
store.py      finished cells on disk
workers.py    who does the work: this process, others of this machine, or a Dask cluster
names.py      what the tables are called
case_sets.py  the measurements that a table is made over
columns.py    the columns that tables have
catalogue.py  which cells make which table, and how they are laid out
pages.py      means and spreads; markdown, CSV and a picture
html_page.py  the same as one HTML page
truth.py      a simulated bench opened for calibration, and what is true of it
"""
