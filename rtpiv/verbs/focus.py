"""`rtpiv focus`: evaluate a focus scan: best focus and the f-number for a sharp view."""

import json
from collections.abc import Sequence

from daq.atomic_write import write_text
from ground.printable import readable_name
from ground.terminal import console
from rtpiv.analysis.focus import FocusScan, focus_scan
from rtpiv.analysis.report.focus import focus_sentence, focus_table, write_focus_page
from rtpiv.verbs.paths import Named, one_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_focus


def focus(run: Sequence[Named] | Named, /, out: Named | None = None) -> FocusScan:
    """Evaluate a focus scan.

    Parameters
    ----------
    run : path
        Run of a plan of ``experiment: focus``; of several, the newest finished one.
    out : path, optional
        Folder for ``focus.html`` and ``focus.json``, default the run's.

    Returns
    -------
    FocusScan
        Best places, depth needed and had.

    Raises
    ------
    RunUnsuitable
        The run is no focus scan, or is not far enough.
    RunDamaged, FrameError
        A record or frame is not what was written.
    """
    run = one_of(run)
    with results_in(out if out is not None else run) as folder:
        scan = focus_scan(run)
        write_focus_page(folder / "focus.html", readable_name(run), scan)
        found = {
            each.part: {"z_mm": each.z_mm, "sigma_mm": each.sigma_mm, "diameter_px": each.diameter_px}
            for each in scan.best
            if not each.why
        }
        tree = {
            "moves": scan.moves,
            "best": found,
            "not_found": {each.part: each.why for each in scan.best if each.why},
            "needed_mm": scan.needed_mm if len(found) > 1 else None,
            "needed_f_number": scan.needed_f_number if scan.needed_mm > 0.0 else None,
            "f_number": scan.f_number,
            "depth_mm": scan.depth_mm,
        }
        write_text(folder / "focus.json", json.dumps(tree, indent=1) + "\n")
        show_focus(console(), focus_table(scan), focus_sentence(scan), folder / "focus.html")
        return scan
