"""A page in the browser that shows frames as they come; no measurement waits for it."""
