"""Timing of light and frames: timing units, the pulses they give, and the laser as a state machine.

    pulses       what is wired to which channel, and the one way of placing light in two exposures
    conditions   what must hold before and while light may leave, and what the laboratory asks for
    low_energy   the weak pulses by which a sheet is aligned
    states       Unknown, Safe, Warm, Ready, Armed, Firing, Fault as a table that the code obeys
    laser        the verbs of that table: safe, warm, set, arm, fire; and the way off that nothing postpones
    supervisor   the threads that watch while it fires
    box          what a timing unit can do; `drivers` are such boxes, `protocols` their grammars

Software is no interlock: the door switch belongs into the laser's own chain (docs/laser.md).
"""
