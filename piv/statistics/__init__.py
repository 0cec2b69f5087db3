"""Statistics of a flow from many pairs: moments, effective samples, ensemble correlation, what is derived."""
