"""Texts that are shown as they are: names of files may hold bytes that a terminal takes for commands."""


def printable(text: str) -> str:
    """Text with every character that is none written as its number; line ends and tabs stay."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)
