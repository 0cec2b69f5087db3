"""The report: one self-contained page from a pair of frames or from a whole run.

page.py, page.css   what a page is made of: headings, tables, figures, a slider; no physics
figures.py          what is drawn for it, as matplotlib figures
tables.py           figures of an evaluation as rows of text
pair.py             the chapters of one evaluated pair
series.py, mean.py   the chapters of a flow run: its frames and one pair; its mean
flow.py             whether that mean can be true: rims, lines, mass, convergence
time_series.py      what velocity does at a place over time, and its spectrum
readings.py         what gauges of the lab showed meanwhile
calibration.py, focus.py   the pages of a scene fit and of a focus scan
pair_folder.py      the folder that one evaluated pair is written to
run.py              the chapters of a run: target, frame account, displacements, provenance
"""
