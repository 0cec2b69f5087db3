"""A page in the browser that shows frames as they come; nobody who measures waits for it."""
