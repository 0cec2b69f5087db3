"""Grammars of the controllers: messages to bytes and back, for both ends of the wire.

No grammar knows time, ports, units or which end it serves; drivers and emulators may share these files and
nothing else. Each module lists its message classes in ``COMMANDS`` and ``ANSWERS``; each class carries documented
examples.
"""
