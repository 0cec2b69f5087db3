"""The bench: what its file says, and the same opened, closed in reverse order whatever happens."""
