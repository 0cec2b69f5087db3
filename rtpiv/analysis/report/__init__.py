"""The report: one self-contained page from a pair of frames or from a whole run.

page.py, page.css   elements of a page: headings, tables, figures, a slider; no physics
figures.py          matplotlib figures of the page
table.py            a table as a value, for page, terminal and JSON
tables.py           tables of an evaluation
sigma_verdict.py    the verdict on its sigma
pair.py             the chapters of one evaluated pair
series.py, mean.py   the chapters of a flow run: its frames and one pair; its mean
flow.py             plausibility of that mean: rims, lines, divergence, convergence
time_series.py      velocity at a place over time, and its spectrum
calibration.py, focus.py   the pages of a scene fit and of a focus scan
pair_folder.py      the folder that one evaluated pair is written to
run.py              the chapters of a run: displacements, frame account, gauge readings, provenance
"""
