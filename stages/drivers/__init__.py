"""Drivers of serial controllers; `stages.drivers_by_name` lists them."""
