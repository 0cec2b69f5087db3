"""What the last frame is worth, figured out now and then beside the pictures (`daq.live.figures`)."""

import time
from typing import Any

from daq.live.figures import Rows, brightness, edge_map, histogram, middle_of, particle_maps, saturated_share
from daq.live.picture import white_of
from daq.live.trend import Trend
from daq.live.watch import Watch
from daq.pipeline.live_slot import Moment, SlotReader

EVERY_S = 0.5


class Worth(Watch):
    """Figures of the last frame, made anew twice a second at most, and which way the focus goes.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    """

    def __init__(self, slot: SlotReader) -> None:
        super().__init__(slot, EVERY_S)
        self.figures: dict[str, Any] = {}
        self._trend, self._of = Trend(), ""

    def see(self, moment: Moment) -> None:
        """Figure out what a frame is worth."""
        raw, white = moment.pictures["raw"], white_of(moment.words)
        is_board = moment.words.get("shows") == "chessboard"
        maps: dict[str, Rows] = {"edge_px": edge_map(raw)} if is_board else particle_maps(raw)
        self._follow(moment.words, middle_of(maps["edge_px" if is_board else "diameter_px"]))
        self.figures = {
            "of": moment.number,
            "saturated": saturated_share(raw, white),
            "bright": brightness(raw, white),
            "histogram": histogram(raw, white),
            "maps": maps,
        }

    def _follow(self, words: dict[str, Any], width_px: float) -> None:
        """Say which way to turn; another step or another target is another view."""
        of = f"{words.get('run')}, {words.get('shows')}"
        if of != self._of:
            self._of = of
            self._trend.forget()
        self._trend.see(time.monotonic(), width_px)
        self.said = {"focus": [self._trend.sentence, False]} if self._trend.sentence else {}
