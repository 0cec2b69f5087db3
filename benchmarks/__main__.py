"""Print the benchmark table and write it as JSON: `make bench`."""

import argparse
import json
import platform
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.maps import measure
from tracer.rows import thread_count


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    rows = measure(options.rounds)
    about = {name: version(name) for name in ("numpy", "numba", "scipy", "opencv-contrib-python-headless")}
    about |= {"python": platform.python_version(), "threads": str(thread_count())}
    table = Table(title="medians, interleaved in one run; " + ", ".join(f"{k} {v}" for k, v in about.items()))
    table.add_column("")
    for row in rows:
        table.add_column(str(row["scene"]), justify="right")
    for name in list(rows[0])[1:]:
        table.add_row(name, *(f"{row[name]:.3g}" for row in rows))
    Console(width=150).print(table)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "maps.json").write_text(json.dumps({"about": about, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
