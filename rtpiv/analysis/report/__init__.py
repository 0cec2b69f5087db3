"""The report: one self-contained page from a pair of frames or from a whole run.

page.py, page.css   what a page is made of: headings, tables, figures, a slider; no physics
figures.py          what is drawn for it, as matplotlib figures
tables.py           figures of an evaluation as rows of text
pair.py             the chapters of one evaluated pair
series.py, mean.py   the chapters of a flow run: its frames and one pair; its mean
flow.py, flow_figures.py   whether that mean can be true: rims, lines, mass, convergence
run.py              the chapters of a run: target, books, what moved, provenance
"""
