"""The slow suite in shards of ten to twenty minutes, and what each has said last: make slow SHARD=3/16.

A shard is a set of test files. Files whose time is known are dealt out longest first, each to the shard that has
least to do; a file that nobody has timed yet goes where the hash of its name says, so a new file moves no other.

What a shard has said last, with its commit, is kept in slow_suite.json, beside the times. The file is tracked:
whoever clones sees in the last line of `make test` what is green, how old that is, and what was never run. Times
are processor seconds of the tests and of the programs that they end: a busy machine deals out as an idle one.
`make slow-balance` deals out anew from what was measured; then all shards are other sets, and none has run.
"""

import datetime as dt
import hashlib
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KEPT = Path(__file__).with_suffix(".json")
SHARDS = 16  # results of other divisions are not kept


def shard_of(file: str, takes_s: dict[str, float], shards: int) -> int:
    """Shard, counted from 1, that a test file belongs to."""
    if file not in takes_s:
        return int(hashlib.sha256(file.encode()).hexdigest(), 16) % shards + 1
    load = [0.0] * shards
    for name in sorted(takes_s, key=lambda name: (-takes_s[name], name)):
        least = load.index(min(load))
        load[least] += takes_s[name]
        if name == file:
            break
    return least + 1


class Shard:
    """Plug-in of pytest: keeps the tests of one shard, takes their time, and writes down what they said."""

    def __init__(self, number: int, shards: int, kept: Path = KEPT) -> None:
        self.number, self.shards, self.kept = number, shards, kept
        self.takes_s: dict[str, float] = json.loads(kept.read_text("utf-8"))["takes_s"]
        self.said: Counter[str] = Counter()
        self.red: list[str] = []
        self.took_s: Counter[str] = Counter()
        self.commit = commit()

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        """Keep what belongs to the shard."""
        files = {item.nodeid.partition("::")[0] for item in items}
        mine = {file for file in files if shard_of(file, self.takes_s, self.shards) == self.number}
        rest = [item for item in items if item.nodeid.partition("::")[0] not in mine]
        config.hook.pytest_deselected(items=rest)
        items[:] = [item for item in items if item.nodeid.partition("::")[0] in mine]

    def pytest_runtest_logstart(self) -> None:
        """Look at the clock of the processor."""
        self._begun_s = sum(os.times()[:4])

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Count what a test says: one that fails in itself and again after it is one red test."""
        if report.failed and report.nodeid not in self.red:
            self.red.append(report.nodeid)
        elif not report.failed and (report.when == "call" or report.skipped):
            self.said[report.outcome] += 1

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Add the time of a test to its file's."""
        self.took_s[nodeid.partition("::")[0]] += sum(os.times()[:4]) - self._begun_s

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        """Keep the result of a whole shard, green or red; one that was stopped or could not begin says nothing."""
        if exitstatus not in (0, 1) or self.shards != SHARDS:
            return
        kept = json.loads(self.kept.read_text("utf-8"))
        kept["last"][str(self.number)] = {
            "commit": self.commit,
            "date": dt.datetime.now(dt.UTC).isoformat(timespec="minutes"),
            "passed": self.said["passed"],
            "skipped": self.said["skipped"],
            "red": self.red,
            "took_s": {name: round(s) for name, s in sorted(self.took_s.items())},
        }
        write(self.kept, kept)


def write(path: Path, kept: dict[str, Any]) -> None:
    """One line a file and a shard, in order: people and merges read it."""
    times = ",\n".join(f"  {json.dumps(file)}: {s}" for file, s in sorted(kept["takes_s"].items()))
    last = sorted(kept["last"].items(), key=lambda each: int(each[0]))
    lines = ",\n".join(f"  {json.dumps(number)}: {json.dumps(result)}" for number, result in last)
    path.write_text(f'{{"takes_s": {{\n{times}\n}}, "last": {{\n{lines}\n}}}}\n', "utf-8", newline="\n")


def commit() -> str:
    """Commit of the checkout, with a plus where files differ from it; a question mark outside of one."""
    status = ("status", "--porcelain", "-uno", "--", ".", f":!{KEPT.relative_to(ROOT).as_posix()}")
    said = [
        subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
        for words in (("rev-parse", "--short=7", "HEAD"), status)
    ]
    return (said[0] or "?") + "+" * bool(said[1])


def summary(last: dict[str, Any], now: dt.datetime) -> str:
    """Return what the shards have said last, in one line."""
    green = {number: result for number, result in last.items() if not result["red"]}
    words = f"slow suite: {len(green)} of {SHARDS} shards green"
    if green:
        oldest = min(green.values(), key=lambda result: result["date"])
        days = (now - dt.datetime.fromisoformat(oldest["date"])).days
        age = {0: "today", 1: "yesterday"}.get(days, f"{days} days ago")
        several = len({result["commit"] for result in green.values()}) > 1
        words += f" at {oldest['commit']}{' or later' * several}, {age}"
    for number in sorted(last.keys() - green.keys(), key=int):
        first, *more = last[number]["red"]
        words += f"; {number} red at {last[number]['commit']}: {first}"
        words += f" and {len(more)} more" if more else ""
    never = SHARDS - len(last)
    return words + (f"; {never} never run" if never else "")


def balance(kept: dict[str, Any]) -> dict[str, Any]:
    """Return the times as last measured, of files that are still there, and no results."""
    takes_s = dict(kept["takes_s"])
    for result in kept["last"].values():
        takes_s |= result["took_s"]
    return {"takes_s": {file: s for file, s in takes_s.items() if (ROOT / file).exists()}, "last": {}}


def main(words: list[str]) -> int:
    """Say what is known, deal out anew or run a shard: no word, `balance`, or `3/16`."""
    kept = json.loads(KEPT.read_text("utf-8"))
    if not words:
        print(summary(kept["last"], dt.datetime.now(dt.UTC)))
        return 0
    if words == ["balance"]:
        write(KEPT, balance(kept))
        return 0
    number, _, shards = words[0].partition("/")
    if not (number.isdigit() and shards.isdigit() and 1 <= int(number) <= int(shards)):
        raise SystemExit(f"Cannot run shard {words[0]!r}; name one of all, as in SHARD=3/{SHARDS}.")
    import pytest  # dear, and the last line of `make test` needs none of it

    return int(pytest.main(["-m", "slow", "-n0"], plugins=[Shard(int(number), int(shards))]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
