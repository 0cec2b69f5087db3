"""Serial motion: axes in mm over controllers that speak bytes."""
