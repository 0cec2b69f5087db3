"""A file that all jobs of a series share, with what it was made from: its background, what stands still in it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from daq.atomic_write import disk_errors
from ground.errors import MapFileError
from ground.map_file import load_arrays, save_arrays

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class SharedFile:
    """A file of a whole series; `key` says what it was made from."""

    path: Path
    key: str

    def ensure(self, kind: str, make: Callable[[], Arrays]) -> "SharedFile":
        """Make the file unless it is there; DiskError if it cannot be written."""
        try:
            self.arrays(kind)
        except MapFileError:  # none yet, damaged, or of other frames
            arrays = dict(make())
            with disk_errors(self.path):
                save_arrays(self.path, kind, {"key": self.key}, arrays)
        return self

    def arrays(self, kind: str) -> Arrays:
        """Return the arrays of the file; MapFileError if it is missing, damaged, or of other frames."""
        header, arrays = load_arrays(self.path, kind)
        if header.get("key") != self.key:
            raise MapFileError(f"{self.path}: belongs to other frames; evaluate the run again")
        return arrays
