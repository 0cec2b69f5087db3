"""A campaign: many runs evaluated by whatever computers there are, with the same bytes in the end."""
