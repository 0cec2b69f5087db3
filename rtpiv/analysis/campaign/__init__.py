"""A campaign: many runs evaluated on any number of computers, with the same bytes."""
