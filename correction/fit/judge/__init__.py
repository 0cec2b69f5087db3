"""Test of the fitted model, and the cause that best explains its residuals."""
