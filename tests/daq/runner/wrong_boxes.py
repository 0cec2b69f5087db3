"""Boxes that are wrong in one way, by name: what is done to the firmware of a right one."""

from daq.timing.pulses import Role
from daq.timing.states import LaserState


def channel_of(d, role):
    return d.emulator._channels[ord(d.box.wiring[role]) - ord("A")]


def counts_otherwise(by, *roles):
    """The channels of some roles give more or fewer pulses than they were asked for."""

    def spoil(d):
        for role in roles:
            channel, tick = channel_of(d, role), type(channel_of(d, role)).tick

            def other(channel, mode, tick=tick):
                words = channel.words
                channel.words = words | {"BCO": str(max(0, int(words["BCO"]) + by))}
                try:
                    return tick(channel, mode)
                finally:
                    channel.words = words

            channel.tick = other.__get__(channel)

    return spoil


def does_not_count(*roles):
    def spoil(d):
        for role in roles:
            channel = channel_of(d, role)
            channel.tick = lambda mode, channel=channel: channel.on

    return spoil


def ticks(role, change):
    """A channel's ticks, changed by a function of (is_active, number of the tick since it was armed)."""

    def spoil(d):
        channel, tick = channel_of(d, role), type(channel_of(d, role)).tick

        def other(channel, mode):
            is_active = tick(channel, mode)
            return change(is_active, channel)

        channel.tick = other.__get__(channel)

    return spoil


def is_dead(role):
    return ticks(role, lambda is_active, channel: False)


def stops_at_sixteen(role):
    return ticks(role, lambda is_active, channel: is_active and channel.done <= 16)


def skips_one_and_gives_it_later(d):
    """One pulse of a burst comes in the next period that has none: the number is right, the spacing is not."""
    channel, tick, owed = channel_of(d, Role.Q_SWITCH_1), type(channel_of(d, Role.Q_SWITCH_1)).tick, []

    def other(channel, mode):
        is_active = tick(channel, mode)
        if is_active and channel.done == 4:
            owed.append(1)
            return False
        if not is_active and channel.on and owed:
            owed.clear()
            return True
        return is_active

    channel.tick = other.__get__(channel)


def hears_off_of(words_lost):
    """Off is heard by the box, and not by some of its channels."""

    def spoil(d):
        switch = d.emulator._switch

        def other(number, on):
            if on or number not in words_lost:
                switch(number, on)

        d.emulator._switch = other

    return spoil


def is_deaf_to_stop(d):
    """Off by the word of the laser alone, without a conversation, is not heard."""
    d.box.drop = lambda: None


def is_said_off_late(d):
    """What is said last before the light ends takes a second to get there."""
    stop = d.laser.stop

    def stop_later(why):
        d.clock.sleep_s(1.0)
        stop(why)

    d.laser.stop = stop_later


def ends_off_late(d):
    """Off takes half a second inside of the box."""
    drop = d.box.drop

    def drop_late():
        if d.laser.state is not LaserState.FIRING:
            drop()
            return
        words = b"".join(d.box.off_bytes())
        d.clock.at(d.clock.now_s() + 0.5, lambda: (d.emulator.advance(), d.emulator.feed(words)))

    d.box.drop = drop_late


def ends_without_a_computer(d):
    """A box that ends by itself as soon as its cable is out has not shown that it counts."""
    d.line.on_cut = d.emulator.person_stops


def goes_on_without_a_computer(d):
    """Without its cable it forgets its count."""

    def forget():
        for channel in d.emulator._channels:
            if channel.words["CMOD"] == "BURS":
                channel.words["BCO"] = "1000"

    d.line.on_cut = forget


def begins_again_without_a_computer(in_s):
    """Some time after its cable was pulled it gives another burst, in the middle of the first one or behind it."""

    def spoil(d):
        def again():
            d.emulator.advance()
            d.emulator._run()

        d.line.on_cut = lambda: d.clock.at(d.clock.now_s() + in_s, again)

    return spoil


def swaps(first, second):
    """Two plugs at its back are labelled the wrong way round."""

    def spoil(d):
        emit, labels = d.emulator.outputs.emit, {first: second, second: first}
        d.emulator.outputs.emit = lambda pulse: emit(pulse._replace(output=labels.get(pulse.output, pulse.output)))

    return spoil


def gives_twice(output):
    """Every pulse of a plug is followed by another one."""

    def spoil(d):
        emit = d.emulator.outputs.emit

        def twice(pulse):
            emit(pulse)
            if pulse.output == output:
                emit(pulse._replace(rises_s=pulse.rises_s + 0.05, falls_s=pulse.falls_s + 0.05))

        d.emulator.outputs.emit = twice

    return spoil


def leaks(into, of):
    """A plug gives what belongs to another one as well."""

    def spoil(d):
        emit = d.emulator.outputs.emit

        def leak(pulse):
            emit(pulse)
            if pulse.output == of:
                emit(pulse._replace(output=into))

        d.emulator.outputs.emit = leak

    return spoil


def runs_at(share):
    """Its crystal is another one: periods are shorter or longer than what reads back."""

    def spoil(d):
        class Words(dict):
            def __getitem__(self, key):
                return (
                    str(float(super().__getitem__(key)) * share)
                    if key == "PER" and d.ticking
                    else super().__getitem__(key)
                )

        d.ticking, begin = False, d.emulator._begin_period
        d.emulator._t0.words = Words(d.emulator._t0.words)

        def begin_period(time_s):
            d.ticking = True
            begin(time_s)
            d.ticking = False

        d.emulator._begin_period = begin_period

    return spoil


def fires_with_the_lamps(d):
    """A Q-switch opens as soon as lamps run, before anybody fires."""
    leaks("B", "A")(d)


def lamps_run_on(d):
    """Off leaves T0 and the lamps as they are, and reads back as off."""
    switch = d.emulator._switch

    def other(number, on):
        if on or number not in (0, 1, 3):
            switch(number, on)

    ask = d.emulator._setting
    d.emulator._switch = other
    d.emulator._setting = lambda number, word, command: (
        "0"
        if command.asks and word == "STAT" and number in (0, 1, 3) and d.laser.state is not LaserState.FIRING
        else ask(number, word, command)
    )


Q1, Q2 = Role.Q_SWITCH_1, Role.Q_SWITCH_2
ALL = (Q1, Q2, Role.CAMERA, Role.MARKER)
WRONG = {
    "one more at every plug": counts_otherwise(1, *ALL), "one fewer at every plug": counts_otherwise(-1, *ALL),
    "Q-switch 1 one more": counts_otherwise(1, Q1), "Q-switch 2 one more": counts_otherwise(1, Q2),
    "Q-switch 2 one fewer": counts_otherwise(-1, Q2), "camera one more": counts_otherwise(1, Role.CAMERA),
    "marker one fewer": counts_otherwise(-1, Role.MARKER), "nothing is counted": does_not_count(*ALL),
    "Q-switch 1 never counts": does_not_count(Q1), "Q-switch 2 never counts": does_not_count(Q2),
    "Q-switches never count": does_not_count(Q1, Q2), "Q-switch 2 is dead": is_dead(Q2),
    "the marker is dead": is_dead(Role.MARKER), "lamp 2 is dead": is_dead(Role.LAMP_2),
    "lamp 1 at half its rate": ticks(Role.LAMP_1, lambda is_active, channel: is_active and channel.done % 2),
    "counts to sixteen": stops_at_sixteen(Q2), "a pulse is late": skips_one_and_gives_it_later,
    "off is not heard by a Q-switch": hears_off_of({0, 2}), "deaf to the first off": is_deaf_to_stop,
    "off is said late": is_said_off_late, "off takes half a second": ends_off_late,
    "ends when the cable is out": ends_without_a_computer, "forgets its count then": goes_on_without_a_computer,
    "begins again then": begins_again_without_a_computer(5.3),
    "begins again behind the end": begins_again_without_a_computer(10.4), "Q-switches swapped": swaps("B", "D"),
    "Q-switch and camera swapped": swaps("B", "E"), "lamp and Q-switch swapped": swaps("A", "B"),
    "every pulse twice": gives_twice("D"), "the camera's pulses at a Q-switch": leaks("D", "E"),
    "lamps at a Q-switch": fires_with_the_lamps, "a Q-switch at a lamp": leaks("A", "B"),
    "twice as fast": runs_at(0.5), "a tenth too slow": runs_at(1.1), "lamps run on": lamps_run_on,
}  # fmt: skip
