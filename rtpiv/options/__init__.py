"""The verbs of the command line and their options; nothing is imported for them: ``--help`` answers at once."""

from rtpiv.options.command import call_of as call_of
from rtpiv.options.command import parser as parser
from rtpiv.options.command import parser_of as parser_of
