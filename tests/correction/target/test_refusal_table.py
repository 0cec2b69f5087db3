"""The table of refusals names messages that exist, and tests that produce them."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
ROW = re.compile(r"^\| (?!message|-)(.+?) \| (.+?) \| `(.+?)` \|$", re.MULTILINE)


def test_every_row_has_its_message_and_its_test():
    rows = ROW.findall((ROOT / "docs" / "board-refusals.md").read_text())
    files = [*(ROOT / "correction" / "target").glob("*.py"), ROOT / "correction" / "fit" / "camera_stage.py"]
    # Messages go over several lines of source: what stands between two pieces of one is taken out.
    said = re.sub(r'"\s*f?"', "", "".join(path.read_text() for path in files))
    tests = {path.name: path.read_text() for path in (ROOT / "tests" / "correction").rglob("test_*.py")}
    assert len(rows) > 20
    for message, _, name in rows:
        assert message in said, message
        assert name in tests or any(f"def {name}(" in text for text in tests.values()), name
