"""A flow run as a series: chunks of pairs, each a file that can be made anew, and what all of them say."""
