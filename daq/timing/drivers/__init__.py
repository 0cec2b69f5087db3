"""Drivers of timing units; `daq.timing.drivers_by_name` lists them."""
