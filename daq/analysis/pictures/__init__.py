"""Pictures for people: drawn from maps and frames, never read back."""

import matplotlib

matplotlib.rcParams["text.parse_math"] = False  # a $ in the name of a file or body begins no formula
