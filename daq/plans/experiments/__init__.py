"""Experiments, one file each; `daq.plans.plan` lists them."""
