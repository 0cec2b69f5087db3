"""The gallery: each example scene as `rtpiv trace` shows it, and the benches and plans beside them."""

import tempfile
from pathlib import Path

import cv2

import rtpiv
from ground.config import load_yaml
from made.command_line import escaped

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
KEPT = Path(__file__).resolve().parents[1] / "_build" / "gallery"  # by the hash of the scene: drawn once
SHOWN = {  # picture of `rtpiv trace` -> what it shows, and how wide
    "camera_view": ("a board as the camera sees it", 480),
    "plane": ("what of the plane is recovered, why the rest is not, and its magnification", 760),
}
QUALITY = 80  # of WebP: 15 to 60 kB a picture


def text() -> str:
    """Write Markdown: a heading, pictures and a sentence a scene; a table of all other files."""
    parts = list[str]()
    for path in scenes():
        parts += [f"## {path.stem.replace('_', ' ').capitalize()}", *_scene(path)]
    parts.append("## Benches, plans and a tour")
    parts += [f"[{_name(path)}]({_link(path)})\n: {caption(path)}" for path in others()]
    return "\n\n".join(parts) + "\n"


def scenes() -> list[Path]:
    """Scene files at the top of the examples, those with fewer bodies first."""
    bodies = {path: load_yaml(path).tree.get("bodies") for path in sorted(EXAMPLES.glob("*.yaml"))}
    return sorted((path for path, found in bodies.items() if found), key=lambda path: len(bodies[path]))


def others() -> list[Path]:
    """All files of the examples that are no scene of the gallery."""
    shown = scenes()
    return sorted(path for path in EXAMPLES.rglob("*") if path.suffix in (".yaml", ".py") and path not in shown)


def caption(path: Path) -> str:
    """The sentences that an example begins with."""
    lines = path.read_text("utf-8").splitlines()
    if path.suffix == ".py":
        return lines[0].strip('"')
    said = lines[: next(number for number, line in enumerate(lines) if not line.startswith("#"))]
    return " ".join(" ".join(line.removeprefix("#").split()) for line in said)


def _scene(path: Path) -> list[str]:
    """What stands below the heading of a scene."""
    stem = f"{path.stem}-{rtpiv.load_scene(path).content_hash()}"
    if not (KEPT / f"{stem}.txt").exists():
        _draw(path, stem)
    pictures = [f"![{shown}](/_build/gallery/{stem}-{name}.webp)" for name, (shown, _) in SHOWN.items()]
    seen = (KEPT / f"{stem}.txt").read_text("utf-8")
    return [*pictures, caption(path), f"{escaped(seen)} [{path.name}]({_link(path)})"]


def _draw(path: Path, stem: str) -> None:
    """Trace a scene and keep its pictures small, and what is seen through glass in a sentence."""
    KEPT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        traced = rtpiv.trace(path, folder)
        for name, (_, widest_px) in SHOWN.items():
            picture = cv2.imread(str(Path(folder) / f"{name}.png"))
            smaller = min(1.0, widest_px / picture.shape[1])
            small = cv2.resize(picture, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(KEPT / f"{stem}-{name}.webp"), small, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    seen = traced.share.through
    said = "" if seen is None else f"{seen.sentence[:1].upper()}{seen.sentence[1:]}."
    (KEPT / f"{stem}.txt").write_text(said, encoding="utf-8")  # last: a drawing that was cut short is begun again


def _name(path: Path) -> str:
    return path.relative_to(EXAMPLES).as_posix()


def _link(path: Path) -> str:
    """From docs/ to a file of the examples."""
    return f"../examples/{_name(path)}"
