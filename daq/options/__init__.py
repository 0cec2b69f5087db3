"""The verbs of the command line and their options; nothing is imported for them: ``--help`` answers at once."""

from daq.options.command import parser as parser
