"""A program that is killed between two bytes, in memory, and what its watchdog had been told."""


class Killed(BaseException):
    """kill -9: nothing that the program writes from now on reaches the box."""


class ToldWatchdog:
    """Knows what the watchdog of the program was told."""

    def __init__(self):
        self.is_told = False

    def moves(self, name):
        self.is_told = True

    def rests(self, name):
        self.is_told = False
