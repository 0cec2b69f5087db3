"""Names of bodies and files, as pictures and tables have room for them."""

LONGEST_NAME = 18


def short(name: str, longest: int = LONGEST_NAME) -> str:
    """Return a name that fits a picture; the middle of a long one is left out."""
    half = (longest - 1) // 2
    return name if len(name) <= longest else f"{name[:half]}\N{HORIZONTAL ELLIPSIS}{name[-half:]}"
