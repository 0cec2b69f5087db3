"""The verbs of the command line and their options; nothing is imported for them: ``--help`` answers at once."""

from rtpiv.options.command import parser as parser
