"""A program that is killed between two bytes, in memory, what its watchdog was told, and where that may be."""


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


def places(made, do, number):
    """Places spread over what passes on the line while something is done, and over the time it takes."""
    before, begun_s = dict(made.line.hooks.passed), made.clock.now_s()
    do()
    took_s = made.clock.now_s() - begun_s
    for what, count in made.line.hooks.passed.items():
        passed = count - before[what]
        for place in sorted({1 + passed * k // number for k in range(number)} if passed else ()):
            yield place, what
    for k in range(number):
        yield took_s * (k + 0.5) / number, "seconds"
