"""Experiments, one file each; `daq.plans.experiments_by_name` lists them."""
