"""Grammars of timing units: messages to bytes and back, both directions; no time, no ports, no units."""
