"""A fitted scene put to use: its file, how unsure its map is, and a correction ready for frames."""
