"""`rtpiv sheet`: locate the light sheet by particles that are visible along two paths."""

from collections.abc import Sequence
from dataclasses import replace

from correction.light_sheet.self_calibration import SheetFound
from daq.atomic_write import copy_whole, write_json, write_text
from ground.plain_words import quantity
from ground.terminal import console
from rtpiv.analysis.fit_beside import FIT_FILE, scene_sigma_beside
from rtpiv.analysis.light_sheet import about_sheet, flow_frames, sheet_of
from rtpiv.verbs.paths import Named, file_of, paths_of
from rtpiv.verbs.results import results_in
from tracer.scene.scene_file import dump_scene, load_priors, load_scene


def sheet(paths: Sequence[Named] | Named, /, scene: Named, out: Named | None = None) -> SheetFound:
    """Find the light sheet in the frames of a flow, and write a scene file that has it.

    Particles that are seen directly and through glass, or through it in two ways, tell how high over the target's
    plane they are.  Where nothing is seen twice, or too little, that is said, and the sheet keeps what was known.

    Parameters
    ----------
    paths : path, or list of path
        The folder of a flow run; external image pairs (a folder, a pattern in quotes, a stack, a video); or
        frames in order: A, B, A, B ...; some 50 pairs.
    scene : path
        Fitted scene.yaml; the search starts from its `sheet`.  With ``fit.npz`` of the fit beside it the
        uncertainty of the sheet includes that of the scene.
    out : path, optional
        Folder, default ``sheet`` (or ``sheet-2`` ... where that has results): ``scene.yaml`` with the sheet, a
        copy of ``fit.npz`` if one lies beside `scene`, ``sheet.json`` and ``sheet.png``.

    Returns
    -------
    SheetFound
        The sheet with its sigmas, and what is to be said of it.

    Raises
    ------
    PairError, SheetError
        The frames show no light sheet, are no pairs, or too few.
    ConfigError, SceneError, FrameError, RunUnsuitable, RunDamaged, DiskError
        What files, frames or run make impossible.
    """
    screen, scene, given = console(), file_of(scene), paths_of(paths)
    fitted = load_scene(scene)
    with results_in(out, "sheet") as folder:
        frames = flow_frames(given, fitted)
        sigma = scene_sigma_beside(scene, fitted, dewarped=False, in_light_sheet=False)
        if isinstance(sigma, str):
            screen.print(f"the scene is taken as exact: {sigma}")
        found = sheet_of(frames, None if isinstance(sigma, str) else sigma)
        write_text(folder / "scene.yaml", dump_scene(replace(fitted, sheet=found.sheet), load_priors(scene)))
        if scene.with_name(FIT_FILE).is_file():
            copy_whole(scene.with_name(FIT_FILE), folder / FIT_FILE)
        write_json(folder / "sheet.json", about_sheet(found, [str(path) for path in given]))
        from rtpiv.analysis.pictures.results import draw_light_sheet

        rows, columns = fitted.camera.shape
        draw_light_sheet(
            folder / "sheet.png", found, (columns * found.views.pitch_mm, rows * found.views.pitch_mm)
        )
        screen.print(found.sheet.summary)
        if found.cells is not None:
            thick = found.sheet.thickness_mm
            screen.print(
                f"{quantity(found.pairs, 'pair')}, {quantity(len(found.cells.kind), 'place')} where particles are"
                " seen twice" + ("" if thick is None else f"; about {thick:.1f} mm thick")
            )
        for verdict in found.verdicts:
            screen.print(verdict, style="bold red")
        screen.print(f"scene.yaml, sheet.json and sheet.png are in {folder}")
        return found
