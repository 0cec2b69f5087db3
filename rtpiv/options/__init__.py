"""Verbs of the command line and their options, read without importing the verbs."""

from rtpiv.options.command import call_of as call_of
from rtpiv.options.command import parser as parser
from rtpiv.options.command import parser_of as parser_of
