"""Stages that a third-party library moves: no bytes of ours, no promise of theirs.

`calls` keeps such a library in a thread of its own, `foreign_controller` says what is believed of it; each further
file is one kind of library.
"""
