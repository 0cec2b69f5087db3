"""What is watched of a scene; see `daq.live.watch`."""

from pathlib import Path

import yaml

from correction.target import Chessboard
from daq.live.watch import Watch
from daq.pipeline.live_slot import SlotReader
from ground.config import Document, validate
from ground.errors import GroundError
from tracer.errors import SceneError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import scene_from
from tracer.scene.scene_tables import SceneTable


def scene_told(text: str) -> Scene | None:
    """Scene of a scene file's text; None if it cannot be read here."""
    try:
        document = Document(Path("scene.yaml"), yaml.safe_load(text))
        return scene_from(document, validate(document, SceneTable))
    except (GroundError, SceneError, OSError):
        return None


def begin(slot: SlotReader, scene: Scene, board: Chessboard) -> tuple[Watch, ...]:
    """Begin to watch the balls of a scene; nothing if it has none."""
    from daq.live.moved_watch import MovedWatch
    from daq.live.rim_watch import RimWatch

    if not scene.spheres:
        return ()
    watches = RimWatch(slot, scene, board), MovedWatch(slot, scene)
    for watch in watches:
        watch.start()
    return watches
