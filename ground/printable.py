"""Texts that are shown and written as they are: names of files may hold any bytes, also commands to a terminal."""

from contextlib import suppress
from pathlib import Path


def printable(text: str) -> str:
    """Text with every character that is none written as its number; line ends and tabs stay."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


def utf8(text: str) -> bytes:
    """Encode a text for a file, in any locale.

    Python keeps a byte of a file's name that the locale cannot decode as a lone surrogate, which no text file
    allows: what is UTF-8 after all is written as that, and U+FFFD in place of any other byte.
    """
    with suppress(UnicodeEncodeError):  # a lone surrogate that stands for no byte
        text = text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return text.encode("utf-8", "replace")


def readable_name(path: Path) -> str:
    """Return the name of a file or folder, also of ``.``, as a text that any file can hold."""
    return utf8(path.resolve().name).decode()
