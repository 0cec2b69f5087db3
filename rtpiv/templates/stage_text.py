"""What the text of a bench file says of its stages, be they motors or hands."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StageText:
    """Parts of the text; each without the end of its last line, but `retract`.

    Parameters
    ----------
    edit : str
        Comment that says what to edit for hardware.
    controllers, axes : str
        Lines of these sections.
    home_order : str
        Names of the axes.
    retract : str
        The line of `glass` that says where it goes first; "" if it leaves at one go.
    simulation : str
        What the workshop built, and how it answers.
    """

    edit: str
    controllers: str
    axes: str
    home_order: str
    retract: str
    simulation: str
