"""One evaluation of `benchmarks.series`, in a process of its own: RUN OUT WORKERS CHUNK WARM."""

import sys
from pathlib import Path

from benchmarks.series import once

if __name__ == "__main__":
    run, out, workers, chunk, warm = sys.argv[1:]
    once(Path(run), Path(out), int(workers), int(chunk), warm == "1")
